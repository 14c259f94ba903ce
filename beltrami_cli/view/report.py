"""A page on the changes between two files: interactive models, figures and charts."""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.formats.changes import Written
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.files.access import Access, read_source
from beltrami_cli.formats.files.bounded_text import REPORT, parse_json, text_in
from beltrami_cli.jobs.compare.documents import ALL_SLOTS, ComparedDocuments, compare_documents, open_both
from beltrami_cli.jobs.compare.figures import figures
from beltrami_cli.jobs.compare.measured import Measured
from beltrami_cli.jobs.job import PLAIN_JOB, Job
from beltrami_cli.jobs.progress import Progress, tracked
from beltrami_cli.jobs.writing.output import Output
from beltrami_cli.layers.settings import SmoothSettings
from beltrami_cli.surface.colour_map import as_bytes, colour_by_value
from beltrami_cli.surface.records import Slot
from beltrami_cli.view.pages.models import ModelWriter
from beltrami_cli.view.pages.rendering import PAGES, page_with_models
from beltrami_cli.view.parameter_tables import used_parameters
from beltrami_cli.view.render import distinct_labels

_SCALE_QUANTILE = 0.995  # share of the samples with smaller changes than the one shown brightest
_MAX_PAGE_BYTES = 8_000_000  # bytes of a page, unless its meshes alone are larger
_MAX_MAP_SIDE = 768  # pixels
_WIDTH, _HEIGHT = 720, 220  # of a histogram, in pixels
# Colours and dashes of the lines of channels: the dashes are for those who cannot distinguish the colours.
_NAMES = {3: ("red", "green", "blue")}
_DASHES = ("none", "8 4", "2 3")
_MAX_BINS = 64  # of a histogram
_MAX_FINE_CHANGE = 4.0  # 255ths; larger changes are counted in bins of whole numbers
_SCALED = "Pictures have {:.0f} % of their width on the page; --full-size keeps all of it."


def report_file(
    before: str,
    after: str,
    target: str,
    settings: SmoothSettings = ALL_SLOTS,
    *,
    parameters: str | None = None,
    full_size: bool = False,
    job: Job = PLAIN_JOB,
) -> dict[str, Any]:
    """Write a page on the changes between two models or images that differ in colours only; return all figures.

    Pictures are scaled down so that the page stays below 8 MB, unless `full_size`.
    """
    names = [before, after]
    if "-" in names:
        raise UsageError("BEFORE and AFTER must be files and not pipes")
    known = names if parameters is None else [*names, parameters]
    output = Output(target, overwrite=job.overwrite, is_text=True, what="page", reads=known)
    if target != "-" and Path(target).suffix.lower() not in PAGES:
        raise UsageError(f"the report is a page; end its name in {' or '.join(PAGES)}", target)
    access = output.files.watching(job.access)
    job = dataclasses.replace(job, access=access)
    used = None if parameters is None else read_parameters(parameters, access)
    documents = open_both((before, after), settings, job)
    compared = compare_documents(
        documents, settings, "uniform", job, ["counting changes", "drawing seams", "packing models"]
    )
    page, notices = _page(names, compared, documents, used, full_size=full_size, progress=job.progress)
    output.write(Written(main=[page]))
    return {**compared.overall(), "notices": notices}


def _page(
    names: Sequence[str], compared: ComparedDocuments, documents: tuple[Document, Document],
    used: dict[str, Any] | None, *, full_size: bool, progress: Progress | None,
) -> tuple[bytes, list[str]]:  # fmt: skip
    short = distinct_labels(names)
    differing = compared.differing()
    errors = np.concatenate([np.zeros(0, np.float32), *(each.errors for each in differing)])
    # The change in 255ths that nearly all samples stay within.
    reach = 255 * float(np.quantile(errors, _SCALE_QUANTILE, method="inverted_cdf")) if len(errors) else 0.0
    values: dict[str, Any] = {
        "title": f"{short[0]} and {short[1]}", "names": names, "figures": _figures(differing),
        "identical": [pair.name for pair in compared.parts if pair.is_identical],
        "change": histogram(tracked(differing, "counting changes", progress), reach), "used": used,
        "seams": [drawn for each in tracked(compared.measured, "drawing seams", progress) if (drawn := seam_map(each))],
    }  # fmt: skip
    writer, notices = ModelWriter(), compared.notices()
    slots: list[Slot | None] = [*compared.slots]
    if not slots or any(part.kind == "vertices" for part in compared.parts):
        slots.append(None)
    for slot in tracked(slots, "packing models", progress):
        writer.add(documents, slot)

    def page_with(data: dict[str, Any], notices: Sequence[str]) -> bytes:
        return page_with_models("report.html", "report.js", data, notices=notices, **values)

    limit = np.inf if full_size else _MAX_PAGE_BYTES - len(page_with({}, [*notices, _SCALED]))
    models, share = writer.packed(reach, limit)
    notices += [_SCALED.format(100 * share)] if share < 1 else []
    return page_with({"models": models}, notices), notices


def read_parameters(path: str, access: Access) -> dict[str, Any]:
    """Return tables of the parameters in a report of `smooth`."""
    try:
        return used_parameters(parse_json(text_in(io.BytesIO(read_source(path, access)), REPORT)))
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        remedy = "give the file that `beltrami smooth --report` wrote"
        raise InputError(path, "it is not a report of beltrami smooth", remedy) from error


def _figures(differing: Sequence[Measured]) -> list[dict[str, Any]]:
    """Return the figures of each part that differs, and of all together."""
    parts = [(each.part.name, [each]) for each in differing]
    parts += [("all", [*differing])] if len(differing) > 1 else []
    rows = []
    for name, chosen in parts:
        found = figures(chosen)
        change = sum(255 * each.change * len(each.errors) for each in chosen)
        rows.append(
            {"name": name, **found, "change": change / found["samples"] if found["samples"] else None}
        )
    return rows


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
