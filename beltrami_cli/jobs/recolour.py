"""Recolour a file: open it, select layers, filter them, write, report.

A filter gives a layer new colours: by the kernel, by adding noise, and the like. No code here asks which layers they
are.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from typing import ClassVar, Generic, TypeVar

from beltrami_cli.flow.chunks import Resources
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.output_format import OutputFormat
from beltrami_cli.jobs.file_job import FileReport, open_file_job
from beltrami_cli.jobs.job import Job
from beltrami_cli.jobs.progress import phases_of
from beltrami_cli.jobs.result_files import files_with_new_colours, sidecar_names, with_new_colours
from beltrami_cli.layers.layer import Layer
from beltrami_cli.layers.selection import Selection, select
from beltrami_cli.layers.settings import SmoothSettings
from beltrami_cli.layers.storing import StoredColours, all_images


@dataclass(frozen=True, kw_only=True)
class FilterResult:
    """New colours of a layer; subclasses add figures for the report."""

    stored: StoredColours
    warnings: Sequence[str] = ()


AnyResult = TypeVar("AnyResult", bound=FilterResult)


class ColourFilter(ABC, Generic[AnyResult]):
    """Recolours layers. It is immutable: what it did is in its results."""

    # Whether image channels other than colours stay unchanged unless they are selected by name.
    colours_only: ClassVar[bool] = True
    # Whether large arrays may be stored in files if memory is short.
    works_in_files: ClassVar[bool] = True

    @property
    def phases(self) -> Sequence[str]:
        """Phases of `apply`, see `jobs/progress.py`."""
        return ("recolouring",)

    @property
    def changes(self) -> bool:
        """Whether it changes any colour; otherwise the output equals the input."""
        return True

    @property
    def works_in_groups(self) -> bool:
        """Whether textures without common edges are filtered separately."""
        return False

    def check(self, selection: Selection, target: OutputFormat) -> Sequence[str]:
        """Raise an error if the selection cannot be recoloured, before the computation; return notices."""
        return ()

    @abstractmethod
    def apply(self, layer: Layer, job: Job) -> AnyResult:
        """Return new colours of a layer."""

    def check_results(self, source: str, results: Sequence[AnyResult]) -> None:
        """Raise an error if the results must not be written."""


def recolour(
    source: str, target: str, settings: SmoothSettings, colour_filter: ColourFilter[AnyResult], job: Job,
    parameters: dict[str, object],
) -> tuple[FileReport, list[AnyResult]]:  # fmt: skip
    """Recolour the selected parts of a file, and write it with everything else unchanged; `parameters`: to report."""
    file = open_file_job(source, target, settings, job)
    document, kind, watch = file.document, file.format, file.watch
    with watch.stage("read"):
        selection = select(document, settings)
        if not colour_filter.changes and kind.suffix is None:
            selection = Selection(document, settings)
        notices = [*colour_filter.check(selection, kind)]
        job.check_document(document)
        naming = file.naming
        file.reserve(sidecar_names(selection, kind, naming))
    place = None if file.output is None else target
    with selection.within_memory(place, in_files=colour_filter.works_in_files) as chunk_memory:
        with watch.stage("smooth"):
            resources = Resources(job.chunking, chunk_memory)
            results = apply_filter(selection, colour_filter, file.job, resources, kind.suffix)
            colour_filter.check_results(source, results)
        with watch.stage("write"):
            new = [each.stored for each in results]
            images, image_notices = all_images(new)
            written = files_with_new_colours(document, new, images, kind, naming)
        notices += [*(notice for each in new for notice in each.notices), *image_notices]
        warnings = [warning for each in results for warning in each.warnings]
        report = file.write(written, parameters, [*selection.notices, *notices], warnings)
    return report, results


def recolour_in_memory(
    document: Document, settings: SmoothSettings, colour_filter: ColourFilter[AnyResult], job: Job
) -> tuple[Document, list[AnyResult], Sequence[str]]:
    """Recolour the selected parts; return the document that would be written, the results, and notices."""
    selection = Selection(document, settings)
    if colour_filter.changes:
        selection = select(document, settings)
    notices = colour_filter.check(selection, OutputFormat(document.format, is_patched=True))
    with selection.within_memory(in_files=colour_filter.works_in_files) as chunk_memory:
        results = apply_filter(selection, colour_filter, job, Resources(job.chunking, chunk_memory))
    return (
        with_new_colours(document, [each.stored for each in results]),
        results,
        [*selection.notices, *notices],
    )


def apply_filter(
    selection: Selection,
    colour_filter: ColourFilter[AnyResult],
    job: Job,
    resources: Resources,
    suffix: str | None = None,
) -> list[AnyResult]:
    """Recolour the selected parts, layer by layer; `suffix`: of the image format of the output, if it differs."""
    results = []
    counts = selection.work()
    phases = [phases_of(["laying out", *colour_filter.phases], count) for count in counts]
    job.expect([*chain(*phases), *phases_of(["writing"], sum(counts))])
    job.begin("laying out")
    options = {"colours_only": colour_filter.colours_only, "in_groups": colour_filter.works_in_groups}
    with_resources = partial(replace, resources=resources)
    for layer in map(with_resources, selection.layers(suffix, **options)):
        layer.require_writable()
        results.append(colour_filter.apply(layer, job))
        job.begin("laying out" if len(results) < len(counts) else "writing")
        del layer
    return results
