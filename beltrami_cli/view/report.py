"""A page on what changed between two files: models to turn, crops to swipe over, figures and drawings."""

from __future__ import annotations

import dataclasses
import html
import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.formats.access import Access, read_source
from beltrami_cli.formats.data_text import REPORT, parse_json, text_in
from beltrami_cli.formats.document import Written
from beltrami_cli.formats.image.document import ImageDocument
from beltrami_cli.jobs.compare.figures import figures
from beltrami_cli.jobs.compare.files import Compared, compare_documents, open_both
from beltrami_cli.jobs.compare.models import EVERYTHING
from beltrami_cli.jobs.job import PLAIN_JOB, Job, tracked
from beltrami_cli.jobs.writing.output import Output
from beltrami_cli.view.charts import histogram, seam_map, swipe
from beltrami_cli.view.models import ModelPacker, bounding_box
from beltrami_cli.view.pages import PAGES, asset, page_from, table
from beltrami_cli.view.sheet import distinct_labels
from beltrami_cli.view.used_parameters import used_parameters
from beltrami_cli.view.views import sheet_of, texture_sheet

if TYPE_CHECKING:
    from beltrami_cli.formats.document import Document
    from beltrami_cli.jobs.compare.figures import ComparedColours
    from beltrami_cli.jobs.job import Progress
    from beltrami_cli.samples.settings import SmoothSettings
    from beltrami_cli.surface.records import Slot

_MOST_CROPS = 8
_COLUMNS = [
    "part", "samples", "PSNR, dB", "SSIM", "Delta E 2000, mean", "worst", "mean change, /255", "seam steps, /255",
]  # fmt: skip
_VIEWER = """<h2>The model</h2>
<div id="viewer"><span class="name">before</span><span class="name right">after</span><span class="line"></span></div>
<input type="range" id="swipe" min="0" max="100" value="50" step="0.1" aria-label="swipe between before and after">
<p>Drag to turn, scroll to come nearer, drag with the right button to move. Colours are unlit.</p>"""


@dataclasses.dataclass
class _Found:
    """What two files have in common, and the parts of the page that show it."""

    compared: Compared
    crops: list[str] = dataclasses.field(default_factory=list)
    seams: list[str] = dataclasses.field(default_factory=list)
    models: str = ""


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
    if target != "-" and Path(target).suffix.lower() not in PAGES:
        raise UsageError(f"{target}: the report is a page; end its name in {' or '.join(PAGES)}")
    access = output.files.watching(job.access)
    job = dataclasses.replace(job, access=access)
    shown = "" if parameters is None else _parameters(parameters, access)
    data = read_source(before, access), read_source(after, access)
    documents = open_both((before, after), data, settings, job)
    found = _Found(compare_documents(documents, settings, "uniform", job))
    if isinstance(documents[0], ImageDocument) and isinstance(documents[1], ImageDocument):
        sheets = [
            sheet_of(document.picture()) for document in documents if isinstance(document, ImageDocument)
        ]
        found.crops.append(swipe(sheets[0], sheets[1], Path(after).name))
    else:
        _add_models(found, documents, job.progress)
    output.write(Written(main=[_page(names, found, shown)]))
    return {**figures(found.compared.measured()), "notices": found.compared.all_notices()}


def _add_models(found: _Found, documents: tuple[Document, Document], progress: Progress | None) -> None:
    """Add what shows two models: the models themselves, textures, and seams."""
    slots = found.compared.slots
    parts = tracked(found.compared.parts, "drawing seams", progress)
    found.seams += [drawn for part in parts if (drawn := seam_map(part))]
    for slot in tracked(slots, "drawing textures", progress):
        found.crops += _crops(*documents, slot, _MOST_CROPS - len(found.crops))
    shown = slots[0] if slots else None
    packer = ModelPacker(bounding_box(documents[0], shown))
    for document in tracked(documents, "packing models", progress):
        packer.add(document, shown)
    found.models = packer.as_json()


def _crops(one: Document, other: Document, slot: Slot, most: int) -> list[str]:
    """Return swipes over the textures that differ."""
    made: list[str] = []
    for old, new in zip(one.textured(slot).textures, other.textured(slot).textures, strict=True):
        if len(made) < most and old.data != new.data:
            made.append(swipe(texture_sheet(old, slot), texture_sheet(new, slot), new.name or slot))
    return made


def _parameters(path: str, access: Access) -> str:
    """Return what a report of `smooth` says was used, as tables."""
    try:
        return used_parameters(parse_json(text_in(io.BytesIO(read_source(path, access)), REPORT)))
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        remedy = "give the file that `beltrami smooth --report` wrote"
        raise InputError(path, "it is no report of beltrami smooth", remedy) from error


def _page(names: list[str], found: _Found, parameters: str) -> bytes:
    model, scripts = "", ""
    if found.models:
        model = _VIEWER
        scripts = (
            f'<script type="application/json" id="models">{found.models}</script>\n'
            f"<script>{asset('three.js')}</script>\n<script>{asset('viewer.js')}</script>"
        )
    short = distinct_labels(names)
    return page_from(
        "report.html",
        title=html.escape(f"{short[0]} and {short[1]}"),
        style=asset("style.css"),
        summary=html.escape(f"Before: {names[0]}. After: {names[1]}."),
        model=model,
        crops=_section(f"{'Textures' if found.models else 'The image'} at full size", found.crops),
        figures=table(_rows(found.compared.parts)) + _listed(found.compared.all_notices()),
        histogram=histogram(found.compared.measured()),
        seams=_section("Seams, by how much they changed", found.seams),
        parameters=parameters,
        scripts=scripts,
    )


def _listed(sentences: list[str]) -> str:
    """Return a list of what is to be known, or nothing."""
    items = "".join(f"<li>{html.escape(sentence)}</li>" for sentence in sentences)
    return f"\n<ul>{items}</ul>" if items else ""


def _section(title: str, parts: list[str]) -> str:
    """Return parts of a page under a heading, or nothing without parts."""
    body = "\n".join(parts)
    return f"<h2>{title}</h2>\n{body}" if body else ""


def _rows(pairs: list[ComparedColours]) -> list[list[str]]:
    """Return the figures of each part, and of all together."""
    rows = [_COLUMNS]
    measured = [pair for pair in pairs if not pair.is_identical]
    parts = [(pair.name, [pair]) for pair in measured]
    for name, chosen in [*parts, *([("all", measured)] if len(measured) > 1 else [])]:
        found: dict[str, Any] = figures(chosen)
        delta_e, jump = found["delta_e"] or {}, found["seam_jump"] or {}
        change = np.concatenate([np.abs(pair.test - pair.reference).ravel() for pair in chosen])
        rows.append(
            [
                name, str(found["samples"]), _psnr(found), _number(found["ssim"], 3),
                _number(delta_e.get("mean"), 2), _number(delta_e.get("worst"), 1),
                _number(255 * float(change.mean()) if change.size else None, 2),
                f"{255 * jump['reference']:.2f} to {255 * jump['test']:.2f}" if jump else "",
            ]
        )  # fmt: skip
    alike = [pair.name for pair in pairs if pair.is_identical]
    return rows + [[name, "", "identical", *[""] * (len(_COLUMNS) - 3)] for name in alike]


def _psnr(found: dict[str, Any]) -> str:
    return "equal" if found["samples"] and found["psnr"] is None else _number(found["psnr"], 2)


def _number(value: float | None, digits: int) -> str:
    return "" if value is None else f"{value:.{digits}f}"
