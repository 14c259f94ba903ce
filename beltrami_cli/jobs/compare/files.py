"""Compare the colours of two files, and hold the difference to limits."""

from __future__ import annotations

import dataclasses
import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.formats.access import EVERYTHING_INSIDE, Access, read_source
from beltrami_cli.formats.image.document import ImageDocument
from beltrami_cli.formats.registry import kind_of
from beltrami_cli.jobs.compare.figures import Verdict, check_limits, figures
from beltrami_cli.jobs.compare.map import draw_map, is_map, require_map
from beltrami_cli.jobs.compare.parts import compare_images, compare_textures, compare_vertices
from beltrami_cli.jobs.documents import document_from
from beltrami_cli.jobs.settings import Limits
from beltrami_cli.jobs.writing.output import Output, Overwrite
from beltrami_cli.samples.memory_check import require_memory_for_textures
from beltrami_cli.samples.selection import select
from beltrami_cli.samples.settings import DEFAULTS, LevelSetSettings

if TYPE_CHECKING:
    from beltrami_cli.flow.parameters import Weights
    from beltrami_cli.formats.document import Document
    from beltrami_cli.jobs.compare.figures import ComparedColours
    from beltrami_cli.samples.settings import SmoothSettings

_UNLIMITED = Limits()


@dataclass(frozen=True)
class Comparison:
    """How two files differ; `dataclasses.asdict` gives JSON types."""

    reference: str
    test: str
    weights: str  # what a sample counts
    space: str  # what colours were taken as
    parts: list[dict[str, Any]]  # "name", "kind" and figures of each texture, the image, or the vertices
    overall: dict[str, Any]  # those of all parts together
    limits: list[Verdict]
    passed: bool  # whether each part keeps to each limit
    map_scale: float | None  # the Delta E that the brightest colour of the map stands for
    notices: list[str]


def compare_files(
    reference: str | os.PathLike[str],
    test: str | os.PathLike[str],
    limits: Limits = _UNLIMITED,
    settings: SmoothSettings = DEFAULTS,
    *,
    weights: Weights = "uniform",
    map_to: str | os.PathLike[str] | None = None,
    overwrite: Overwrite = False,
    access: Access = EVERYTHING_INSIDE,
) -> Comparison:
    """Compare the colours of two files of one model, or of two images."""
    names = os.fspath(reference), os.fspath(test)
    if names == ("-", "-"):
        raise UsageError("only one of REFERENCE and TEST can be standard input")
    target = None if map_to is None else os.fspath(map_to)
    output = None
    if target is not None:
        require_map(target)
        output = Output(target, overwrite=overwrite, what="map", is_own=is_map, reads=names)
        output.files.guard(settings.files_besides())
        access = output.files.watching(access)
    data = read_source(names[0], access), read_source(names[1], access)
    documents = _open(names, data, settings, access)
    parts, model, notices = _compare(documents, settings, weights, access)
    _require_samples(parts, documents[0].name)
    described = [{"name": part.name, "kind": part.kind, **figures([part])} for part in parts]
    verdicts, untested = check_limits(described, limits, documents[1].name)
    scale = None
    if output is not None and target is not None:
        written, scale = draw_map(parts, model, target)
        output.write(written)
    return Comparison(
        *names,
        weights,
        settings.space,
        described,
        figures(parts),
        verdicts,
        all(verdict.kept for verdict in verdicts),
        scale,
        [*notices, *_left_out(parts), *untested],
    )


def _require_samples(parts: list[ComparedColours], name: str) -> None:
    """Raise InputError if nothing can be compared, or what counts by its area has none."""
    if not sum(len(part.reference) for part in parts):
        raise InputError(
            name,
            "nothing of it can be compared: no texel that the surface covers, or no pixel, can be seen",
            "choose something else with --on, --slots or --mask",
        )
    for part in parts:
        if len(part.weights) and not part.weights.sum() > 0:
            cause = f"{part.name}: the surface has no area that samples could stand for"
            raise InputError(name, cause, "use --weights uniform")


def _left_out(parts: list[ComparedColours]) -> list[str]:
    """Say of which parts nothing is compared."""
    return [
        f"{part.name} is not compared, because no texel of it is both covered by the surface and visible"
        for part in parts
        if not len(part.reference)
    ]


def _compare(
    documents: tuple[Document, Document], settings: SmoothSettings, weights: Weights, access: Access
) -> tuple[list[ComparedColours], Document | None, list[str]]:
    """Return the parts, vertices first, the reference if it is a model, and notices."""
    images = [document for document in documents if isinstance(document, ImageDocument)]
    if len(images) == 1:
        kinds = ["an image" if document in images else "a model" for document in documents]
        raise InputError(
            documents[1].name,
            f"it is {kinds[1]}, but {documents[0].name} is {kinds[0]}",
            "compare two files of one kind",
        )
    if images:
        return [compare_images(images, settings, access)], None, []
    parts, notices = _compare_models(documents, settings, weights, access)
    return parts, documents[0], notices


def _open(
    names: tuple[str, str], data: tuple[bytes, bytes], settings: SmoothSettings, access: Access
) -> tuple[Document, Document]:
    """Open both; one may be a level set, and the other the mesh that was made of it."""
    volumes = [kind_of(each, name) == "volume" for each, name in zip(data, names, strict=True)]
    plain = dataclasses.replace(settings, level_set=LevelSetSettings()) if any(volumes) else settings
    one, other = (
        document_from(each, name, settings if volume else plain, access)
        for each, name, volume in zip(data, names, volumes, strict=True)
    )
    return one, other


def _compare_models(
    documents: tuple[Document, Document], settings: SmoothSettings, weights: Weights, access: Access
) -> tuple[list[ComparedColours], list[str]]:
    reference, test = documents
    selection = select(reference, settings)
    parts, notices = [], [f"{reference.name}: {notice}" for notice in selection.notices]
    if selection.vertices:
        part, moved = compare_vertices(reference, test, settings, weights)
        parts.append(part)
        notices += [f"{test.name}: {notice}" for notice in moved]
    for slot in selection.slots:
        for document in documents:
            require_memory_for_textures(document, selection.slots, settings.textures, access)
        parts += compare_textures(reference, test, slot, settings, weights, access)
    return parts, notices
