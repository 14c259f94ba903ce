"""A page on the changes between two files: interactive models, figures and charts."""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.formats.access import Access, read_source
from beltrami_cli.formats.bounded_text import REPORT, parse_json, text_in
from beltrami_cli.formats.changes import Written
from beltrami_cli.formats.document import Document
from beltrami_cli.jobs.compare.figures import Measured, figures
from beltrami_cli.jobs.compare.files import ALL_SLOTS, ComparedDocuments, compare_documents, open_both
from beltrami_cli.jobs.job import PLAIN_JOB, Job
from beltrami_cli.jobs.progress import Progress, tracked
from beltrami_cli.jobs.writing.output import Output
from beltrami_cli.layers.settings import SmoothSettings
from beltrami_cli.surface.records import Slot
from beltrami_cli.view import pages
from beltrami_cli.view.models import ModelWriter
from beltrami_cli.view.parameter_tables import used_parameters
from beltrami_cli.view.render import distinct_labels
from beltrami_cli.view.report_charts import histogram, seam_map

_SCALE_QUANTILE = 0.995  # share of the samples with smaller changes than the one shown brightest
_MAX_PAGE_BYTES = 8_000_000  # bytes of a page, unless its meshes alone are larger
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
    if target != "-" and Path(target).suffix.lower() not in pages.PAGES:
        raise UsageError(f"the report is a page; end its name in {' or '.join(pages.PAGES)}", target)
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
    writer, notices = ModelWriter(), compared.all_notices()
    slots: list[Slot | None] = [*compared.slots]
    if not slots or any(part.kind == "vertices" for part in compared.parts):
        slots.append(None)
    for slot in tracked(slots, "packing models", progress):
        writer.add(documents, slot)

    def page_with(data: dict[str, Any], notices: Sequence[str]) -> bytes:
        return pages.page_with_models("report.html", "report.js", data, notices=notices, **values)

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
