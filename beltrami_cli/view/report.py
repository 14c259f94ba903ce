"""A page on what changed between two files: models to turn and compare, figures and drawings."""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from beltrami_cli.arrays import Int64s
from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.formats.access import REPORT, Access, parse_json, read_source, text_in
from beltrami_cli.formats.document import Document, Written
from beltrami_cli.jobs.compare.figures import ComparedColours, figures
from beltrami_cli.jobs.compare.files import Compared, compare_documents, open_both
from beltrami_cli.jobs.compare.models import EVERYTHING
from beltrami_cli.jobs.job import PLAIN_JOB, Job, Progress, tracked
from beltrami_cli.jobs.output import Output
from beltrami_cli.layers.settings import SmoothSettings
from beltrami_cli.surface.records import Slot, as_bytes, colour_by_value
from beltrami_cli.view import pages
from beltrami_cli.view.drawing import distinct_labels
from beltrami_cli.view.models import ModelWriter
from beltrami_cli.view.parameters import used_parameters

_NEARLY_ALL = 99.5  # per cent of changes that are not shown brightest
_LARGEST = 8_000_000  # bytes of a page, unless its meshes alone are larger
_SCALED = "Pictures have {:.0f} % of their width on the page; --full-size keeps all of it."
_LONGEST = 768  # pixels, of a seam map
_WIDTH, _HEIGHT = 720, 220
# Colours and dashes of the lines of channels: the dashes are for those who cannot distinguish the colours.
_NAMES = {3: ("red", "green", "blue")}
_DASHES = ("none", "8 4", "2 3")
_STEPS = 64
_FEW = 4.0  # 255ths; larger changes are counted in bins of whole numbers
_FINE = 64  # parts of 1/255 that changes are counted in: half the width of the narrowest bin, 2 / _STEPS
_MOST = 2 * 255 * _FINE  # of these, twice full scale; larger changes, of light, count as such
_CHANGES = np.arange(-_MOST, _MOST + 1)
_WHITE = 1.0


def report_file(
    before: str,
    after: str,
    target: str,
    settings: SmoothSettings = EVERYTHING,
    *,
    parameters: str | None = None,
    full_size: bool = False,
    job: Job = PLAIN_JOB,
) -> dict[str, Any]:
    """Write a page on what changed between two models or images that differ in colours only; return all figures.

    Pictures are scaled down so that the page stays below 8 MB, unless `full_size`.
    """
    names = [before, after]
    if "-" in names:
        raise UsageError("BEFORE and AFTER must be files and not pipes")
    known = names if parameters is None else [*names, parameters]
    output = Output(target, overwrite=job.overwrite, is_text=True, what="page", reads=known)
    if target != "-" and Path(target).suffix.lower() not in pages.PAGES:
        raise UsageError(f"{target}: the report is a page; end its name in {' or '.join(pages.PAGES)}")
    access = output.files.watching(job.access)
    job = dataclasses.replace(job, access=access)
    used = None if parameters is None else _parameters(parameters, access)
    documents = open_both((before, after), settings, job)
    compared = compare_documents(
        documents, settings, "uniform", job, ["counting changes", "drawing seams", "packing models"]
    )
    page, notices = _page(names, compared, documents, used, full_size=full_size, progress=job.progress)
    output.write(Written(main=[page]))
    return {**compared.overall(), "notices": notices}


def _page(
    names: Sequence[str], compared: Compared, documents: tuple[Document, Document], used: dict[str, Any] | None, *,
    full_size: bool, progress: Progress | None,
) -> tuple[bytes, list[str]]:  # fmt: skip
    """Return the page and its notices."""
    short = distinct_labels(names)
    changes = [changes_of(each.part) for each in tracked(compared.differing(), "counting changes", progress)]
    values: dict[str, Any] = {
        "title": f"{short[0]} and {short[1]}", "names": names, "figures": _figures(compared, changes),
        "identical": [pair.name for pair in compared.parts if pair.is_identical],
        "change": histogram(changes), "used": used,
        "seams": [drawn for part in tracked(compared.parts, "drawing seams", progress) if (drawn := seam_map(part))],
    }  # fmt: skip
    writer, notices = ModelWriter(), compared.all_notices()
    slots: list[Slot | None] = [*compared.slots]
    if not slots or any(part.kind == "vertices" for part in compared.parts):
        slots.append(None)
    for slot in tracked(slots, "packing models", progress):
        writer.add(documents, slot)

    def page_with(data: dict[str, Any], notices: Sequence[str]) -> bytes:
        return pages.page_with_models("report.html", "report.js", data, notices=notices, **values)

    limit = np.inf if full_size else _LARGEST - len(page_with({}, [*notices, _SCALED]))
    models, share = writer.packed(_percentile(changes), limit)
    notices += [_SCALED.format(100 * share)] if share < 1 else []
    return page_with({"models": models}, notices), notices


def changes_of(part: ComparedColours) -> Int64s:
    """Count how often the channels of samples changed by how much, in 64ths of 1/255, shape (N, 2 * _MOST + 1)."""
    counts = np.zeros((1, len(_CHANGES)), np.int64)
    for _, reference, test in part.blocks():
        change = np.rint(255 * _FINE * (test.astype(np.float64) - reference))
        bins = np.clip(change, -_MOST, _MOST).astype(np.int64) + _MOST
        counts = counts + np.array([np.bincount(channel, minlength=len(_CHANGES)) for channel in bins.T])
    return counts


def _percentile(changes: Sequence[Int64s]) -> float:
    """Return the change in 255ths that nearly all channels of all samples stay within."""
    counts = np.sum([each.sum(axis=0) for each in changes], axis=0)
    sizes = np.cumsum(np.bincount(np.abs(_CHANGES), counts))
    return float(np.searchsorted(sizes, _NEARLY_ALL / 100 * sizes[-1])) / _FINE


def _mean(changes: Sequence[Int64s]) -> float | None:
    """Return the mean absolute change in 255ths; None without any samples."""
    counts = np.sum([each.sum(axis=0) for each in changes], axis=0)
    return float(counts @ np.abs(_CHANGES)) / counts.sum() / _FINE if counts.any() else None


def _parameters(path: str, access: Access) -> dict[str, Any]:
    """Return tables of the parameters in a report of `smooth`."""
    try:
        return used_parameters(parse_json(text_in(io.BytesIO(read_source(path, access)), REPORT)))
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        remedy = "give the file that `beltrami smooth --report` wrote"
        raise InputError(path, "it is no report of beltrami smooth", remedy) from error


def _figures(compared: Compared, changes: Sequence[Int64s]) -> list[dict[str, Any]]:
    """Return the figures of each part that differs, and of all together."""
    measured = list(zip(compared.differing(), changes, strict=True))
    parts = [(pair[0].part.name, [pair]) for pair in measured]
    parts += [("all", measured)] if len(measured) > 1 else []
    return [
        {"name": name, "change": _mean([each for _, each in chosen]), **figures([each for each, _ in chosen])}
        for name, chosen in parts
    ]


def histogram(changes: Sequence[Int64s]) -> dict[str, Any]:
    """Return the lines of a drawing of how often channels changed by how much, in steps of 1/255, and its axis."""
    widest = max(map(len, changes))
    fine = np.sum([each for each in changes if len(each) == widest], axis=0)
    bins, step = _bins(_percentile([fine]))
    # What changed by more is counted in the bins at both ends.
    places = np.clip(_CHANGES / (step * _FINE) + bins / 2, 0, bins - 1).astype(np.int64)
    counts = [np.bincount(places, channel, bins) for channel in fine]
    most = max(1, max(int(count.max()) for count in counts))
    names = _NAMES.get(widest, ("",) * widest)
    lines = []
    for number, (count, name) in enumerate(zip(counts, names, strict=True)):
        corners = zip(_WIDTH * (np.arange(bins) + 0.5) / bins, _HEIGHT * (1 - count / most), strict=True)
        points = " ".join(f"{x:.1f},{y:.1f}" for x, y in corners)
        ink = f"var(--{name})" if name else "currentColor"
        lines.append({"name": name, "ink": ink, "dash": _DASHES[number % 3], "points": points})
    return {"size": (_WIDTH, _HEIGHT), "lines": lines, "reach": step * bins / 2}


def _bins(largest: float) -> tuple[int, float]:
    """Return the number of bins of a histogram of changes in 255ths, and their width."""
    largest = max(1.0, largest)
    step = -(-2 * largest // _STEPS) // 2 * 2 + 1 if largest > _FEW else 2 * largest / _STEPS
    return 2 * int(largest // step) + 1, step


def seam_map(pair: ComparedColours) -> dict[str, Any] | None:
    """Return a picture of how much a texture, `size` = (rows, columns), changed near its seams; None without seams."""
    if pair.size is None or pair.near_seams is None or not pair.near_seams.any():
        return None
    stride = max(1, -(-max(pair.size) // _LONGEST))
    small = tuple(-(-side // stride) for side in pair.size)
    near = dataclasses.replace(pair, index=pair.index[pair.near_seams])
    amount = near.errors()
    largest = max(float(amount.max()), 1 / 255)
    values = np.full(small, -1.0, np.float32)
    rows, columns = np.divmod(near.index, pair.size[1])
    np.maximum.at(values, (rows // stride, columns // stride), (amount / largest).astype(np.float32))
    ends = [np.arange(0, side, stride) for side in pair.size]
    covered = np.logical_or.reduceat(np.logical_or.reduceat(pair.covered(), ends[0], axis=0), ends[1], axis=1)
    shades = np.where(covered[..., None], 0.6, _WHITE) * np.ones((*small, 3))
    drawn = colour_by_value(np.maximum(values, 0), shades.astype(np.float32), values >= 0)
    return {"name": pair.name, "picture": as_bytes(drawn), "largest": 255 * largest}
