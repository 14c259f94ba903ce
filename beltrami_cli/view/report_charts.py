"""The charts of a report: histograms of changes, and maps of changes near seams."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from beltrami_cli.jobs.compare.figures import Measured
from beltrami_cli.surface.colour_map import as_bytes, colour_by_value

_MAX_MAP_SIDE = 768  # pixels
_WIDTH, _HEIGHT = 720, 220  # of a histogram, in pixels
# Colours and dashes of the lines of channels: the dashes are for those who cannot distinguish the colours.
_NAMES = {3: ("red", "green", "blue")}
_DASHES = ("none", "8 4", "2 3")
_MAX_BINS = 64  # of a histogram
_MAX_FINE_CHANGE = 4.0  # 255ths; larger changes are counted in bins of whole numbers


def histogram(measured: Iterable[Measured], reach: float) -> dict[str, Any]:
    """Return the lines of a histogram of changes by channel, in steps of 1/255, and its axis.

    Of parts with different channels, the ones with most are drawn; nearly all changes are within `reach`, in 255ths.
    """
    reach = max(1.0, reach)
    step = -(-2 * reach // _MAX_BINS) // 2 * 2 + 1 if reach > _MAX_FINE_CHANGE else 2 * reach / _MAX_BINS
    bins = 2 * int(reach // step) + 1
    counts = np.zeros((1, bins), np.int64)
    for each in measured:
        for _, reference, test in each.part.blocks():
            # Larger changes are counted in the first and last bin.
            places = 255 / step * (test.astype(np.float64) - reference) + bins / 2
            channels = places.clip(0, bins - 1).astype(np.int64).T
            if len(channels) > len(counts):
                counts = np.zeros((len(channels), bins), np.int64)
            if len(channels) == len(counts):
                counts += [np.bincount(channel, minlength=bins) for channel in channels]
    most, names = max(1, int(counts.max())), _NAMES.get(len(counts), ("",) * len(counts))
    lines = []
    for number, (count, name) in enumerate(zip(counts, names, strict=True)):
        corners = zip(_WIDTH * (np.arange(bins) + 0.5) / bins, _HEIGHT * (1 - count / most), strict=True)
        points = " ".join(f"{x:.1f},{y:.1f}" for x, y in corners)
        ink = f"var(--{name})" if name else "currentColor"
        lines.append({"name": name, "ink": ink, "dash": _DASHES[number % 3], "points": points})
    return {"size": (_WIDTH, _HEIGHT), "lines": lines, "reach": step * bins / 2}


def seam_map(measured: Measured) -> dict[str, Any] | None:
    """Return a picture of the changes of a texture near its seams, `size` = (rows, columns); None without seams."""
    pair = measured.part
    if pair.size is None or pair.near_seams is None or not pair.near_seams.any():
        return None
    stride = max(1, -(-max(pair.size) // _MAX_MAP_SIDE))
    errors, values = measured.errors[pair.near_seams], np.full(pair.size, -1.0, np.float32)
    largest = max(float(errors.max()), 1 / 255)
    values.reshape(-1)[pair.index[pair.near_seams]] = errors / largest
    down, across = (np.arange(0, side, stride) for side in pair.size)
    values, covered = (
        np.maximum.reduceat(np.maximum.reduceat(each, down, axis=0), across, axis=1)
        for each in (values, pair.covered())
    )
    shades = np.repeat(np.where(covered[..., None], np.float32(0.6), np.float32(1)), 3, axis=2)
    drawn = colour_by_value(np.maximum(values, 0), shades, values >= 0)
    return {"name": pair.name, "picture": as_bytes(drawn), "largest": 255 * largest}
