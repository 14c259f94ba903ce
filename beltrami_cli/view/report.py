"""A page on what changed between two files: models to turn and compare, figures and drawings."""

from __future__ import annotations

import dataclasses
import html
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from beltrami_cli.arrays import Float64s
from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.formats.access import Access, read_source
from beltrami_cli.formats.data_text import REPORT, parse_json, text_in
from beltrami_cli.formats.document import Document, Written
from beltrami_cli.jobs.compare.figures import ComparedColours, figures
from beltrami_cli.jobs.compare.files import Compared, compare_documents, open_both
from beltrami_cli.jobs.compare.models import EVERYTHING
from beltrami_cli.jobs.job import PLAIN_JOB, Job, Progress, tracked
from beltrami_cli.jobs.output import Output
from beltrami_cli.layers.settings import SmoothSettings
from beltrami_cli.surface.colour_values import as_bytes, colour_by_value
from beltrami_cli.surface.records import Slot
from beltrami_cli.view import pages
from beltrami_cli.view.models import ModelPacker
from beltrami_cli.view.parameters import used_parameters
from beltrami_cli.view.sheet import distinct_labels

_NEARLY_ALL = 99.5  # per cent of changes that are not shown brightest
_COLUMNS = [
    "part", "samples", "PSNR, dB", "SSIM", "Delta E 2000, mean", "worst", "mean change, /255", "seam steps, /255",
]  # fmt: skip
_LONGEST = 768  # pixels, of a seam map
_WIDTH, _HEIGHT = 720, 220
# Colours and dashes of the lines of channels: the dashes are for those who cannot distinguish the colours.
_NAMES = {3: ("red", "green", "blue")}
_DASHES = ("none", "8 4", "2 3")
_STEPS = 64
_FEW = 4.0  # 255ths; larger changes are counted in bins of whole numbers
_WHITE = 1.0


def report_file(
    before: str,
    after: str,
    target: str,
    settings: SmoothSettings = EVERYTHING,
    *,
    parameters: str | None = None,
    job: Job = PLAIN_JOB,
) -> dict[str, Any]:
    """Write a page on what changed between two models or images that differ in colours only; return all figures."""
    names = [before, after]
    if "-" in names:
        raise UsageError("BEFORE and AFTER must be files and not pipes")
    known = names if parameters is None else [*names, parameters]
    output = Output(target, overwrite=job.overwrite, is_text=True, what="page", reads=known)
    if target != "-" and Path(target).suffix.lower() not in pages.PAGES:
        raise UsageError(f"{target}: the report is a page; end its name in {' or '.join(pages.PAGES)}")
    access = output.files.watching(job.access)
    job = dataclasses.replace(job, access=access)
    shown = "" if parameters is None else _parameters(parameters, access)
    documents = open_both((before, after), settings, job)
    compared = compare_documents(documents, settings, "uniform", job)
    parts = tracked(compared.parts, "drawing seams", job.progress)
    seams = [drawn for part in parts if (drawn := seam_map(part))]
    models = _models(compared, documents, job.progress)
    output.write(Written(main=[_page(names, compared, models, seams, shown)]))
    return {**figures(compared.measured()), "notices": compared.all_notices()}


def _models(
    compared: Compared, documents: tuple[Document, Document], progress: Progress | None
) -> dict[str, Any]:
    packer, (one, other) = ModelPacker(), documents
    if one.kind == "image":
        packer.add_image((one, other))
    else:
        slots: list[Slot | None] = [*compared.slots]
        if not slots or any(part.kind == "vertices" for part in compared.parts):
            slots.append(None)
        for slot in tracked(slots, "packing models", progress):
            packer.add(documents, slot)
    changes = [255 * np.abs(part.test - part.reference).ravel() for part in compared.measured()]
    changed = np.concatenate([*changes, np.zeros(1)])
    return packer.packed(float(np.percentile(changed, _NEARLY_ALL)))


def _parameters(path: str, access: Access) -> str:
    """Return what a report of `smooth` says was used, as tables."""
    try:
        return used_parameters(parse_json(text_in(io.BytesIO(read_source(path, access)), REPORT)))
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        remedy = "give the file that `beltrami smooth --report` wrote"
        raise InputError(path, "it is no report of beltrami smooth", remedy) from error


def _page(
    names: list[str], compared: Compared, models: dict[str, Any], seams: list[str], parameters: str
) -> bytes:
    short, notices = distinct_labels(names), compared.all_notices()
    listed = "".join(f"<li>{html.escape(sentence)}</li>" for sentence in notices)
    maps = "\n".join(seams)
    return pages.page_from(
        "report.html",
        [*pages.VIEWER_SCRIPTS, "report.js"],
        {"models": models, "three": pages.packed_text(pages.LIBRARY)},
        library=pages.LIBRARY,
        licence=pages.asset("three.LICENSE"),
        title=html.escape(f"{short[0]} and {short[1]}"),
        summary=html.escape(f"Before: {names[0]}. After: {names[1]}."),
        viewer=pages.asset("viewer.html"),
        figures=pages.table(_rows(compared), "figures") + (f"\n<ul>{listed}</ul>" if listed else ""),
        histogram=histogram(compared.measured()),
        seams=f"<h2>Seams, by how much they changed</h2>\n{maps}" if maps else "",
        parameters=parameters,
    )


def _rows(compared: Compared) -> list[list[str]]:
    rows, measured = [_COLUMNS], compared.measured()
    parts = [(pair.name, [pair]) for pair in measured]
    for name, chosen in [*parts, *([("all", measured)] if len(measured) > 1 else [])]:
        found: dict[str, Any] = figures(chosen)
        delta_e, jump = found["delta_e"] or {}, found["seam_jump"] or {}
        change = np.concatenate([np.abs(pair.test - pair.reference).ravel() for pair in chosen])
        psnr = "equal" if found["samples"] and found["psnr"] is None else _number(found["psnr"], 2)
        rows.append(
            [
                name, str(found["samples"]), psnr, _number(found["ssim"], 3),
                _number(delta_e.get("mean"), 2), _number(delta_e.get("worst"), 1),
                _number(255 * float(change.mean()) if change.size else None, 2),
                f"{255 * jump['reference']:.2f} to {255 * jump['test']:.2f}" if jump else "",
            ]
        )  # fmt: skip
    alike = [pair.name for pair in compared.parts if pair.is_identical]
    return rows + [[name, "", "identical", *[""] * (len(_COLUMNS) - 3)] for name in alike]


def _number(value: float | None, digits: int) -> str:
    return "" if value is None else f"{value:.{digits}f}"


def histogram(pairs: Sequence[ComparedColours]) -> str:
    """Return a drawing of how often channels changed by how much, in steps of 1/255."""
    widest = max(pair.test.shape[1] for pair in pairs)
    shown = [pair for pair in pairs if pair.test.shape[1] == widest]
    change = 255 * np.concatenate([pair.test.astype(np.float64) - pair.reference for pair in shown])
    bins, reach = _bins(change)
    inside = np.clip(change, -reach, reach)
    counts = [np.histogram(channel, bins, (-reach, reach))[0] for channel in inside.T]
    most = max(1, max(int(count.max()) for count in counts))
    lines = []
    inks = [f"var(--{name})" for name in _NAMES.get(widest, ())] or ["currentColor"] * widest
    for number, (count, ink) in enumerate(zip(counts, inks, strict=True)):
        corners = zip(_WIDTH * (np.arange(bins) + 0.5) / bins, _HEIGHT * (1 - count / most), strict=True)
        points = " ".join(f"{x:.1f},{y:.1f}" for x, y in corners)
        look = f'fill="none" stroke="{ink}" stroke-width="1.5" stroke-dasharray="{_DASHES[number % 3]}"'
        lines.append(f'<polyline {look} points="{points}"/>')
        if widest in _NAMES:
            y = 14 * (number + 1)
            lines.append(f'<line {look} x1="8" x2="36" y1="{y - 4}" y2="{y - 4}"/>')
            lines.append(f'<text x="42" y="{y}">{_NAMES[widest][number]}</text>')
    marks = []
    for share, anchor in ((-1, "start"), (-0.5, "middle"), (0, "middle"), (0.5, "middle"), (1, "end")):
        at = f'x="{_WIDTH * (0.5 + 0.5 * share):.0f}" y="{_HEIGHT + 14}" text-anchor="{anchor}"'
        marks.append(f"<text {at}>{share * reach:+.1f}</text>")
    axis = f'<line x1="0" x2="{_WIDTH}" y1="{_HEIGHT}" y2="{_HEIGHT}" stroke="currentColor"/>'
    body = "\n".join([*lines, axis, *marks])
    return (
        f'<svg width="{_WIDTH}" height="{_HEIGHT + 20}" viewBox="0 0 {_WIDTH} {_HEIGHT + 20}" role="img" '
        f'aria-label="histogram of the change">\n{body}\n</svg>\n<p>After minus before, in 255ths of full scale.</p>'
    )


def _bins(change: Float64s) -> tuple[int, float]:
    """Return the number of bins of a histogram of changes in 255ths, and its largest change."""
    wanted = max(1.0, float(np.percentile(np.abs(change), 99.5))) if change.size else 1.0
    step = -(-2 * wanted // _STEPS) // 2 * 2 + 1 if wanted > _FEW else 2 * wanted / _STEPS
    bins = 2 * int(wanted // step) + 1
    return bins, step * bins / 2


def seam_map(pair: ComparedColours) -> str:
    """Return a picture of how much a texture, `size` = (rows, columns), changed near its seams; empty without seams."""
    if pair.size is None or pair.near_seams is None or not pair.near_seams.any():
        return ""
    stride = max(1, -(-max(pair.size) // _LONGEST))
    small = tuple(-(-side // stride) for side in pair.size)
    amount = np.abs(pair.test.astype(np.float64) - pair.reference).max(axis=1)
    largest = max(float(amount[pair.near_seams].max()), 1 / 255)
    columns, rows = pair.index.T // stride
    values, covered = np.full(small, -1.0, np.float32), np.zeros(small, bool)
    covered[rows, columns] = True
    near = pair.near_seams
    np.maximum.at(values, (rows[near], columns[near]), (amount[near] / largest).astype(np.float32))
    shades = np.where(covered[..., None], 0.6, _WHITE) * np.ones((*small, 3))
    drawn = colour_by_value(np.maximum(values, 0), shades.astype(np.float32), values >= 0)
    tag = pages.picture_tag(as_bytes(drawn), f"seams of {pair.name}")
    caption = f"{html.escape(pair.name)}: brightest {255 * largest:.1f}/255"
    return f"<figure>{tag}<figcaption>{caption}</figcaption></figure>"
