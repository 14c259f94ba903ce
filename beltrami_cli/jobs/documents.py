"""Documents of a job: the input, the files of the output, and the files that belong beside it."""

from __future__ import annotations

import dataclasses
import os
from contextlib import suppress
from copy import copy
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np

from beltrami_cli.errors import BeltramiError, UsageError
from beltrami_cli.formats import registry
from beltrami_cli.formats.access import read_regular, read_source
from beltrami_cli.formats.document import Naming
from beltrami_cli.formats.image.recognition import suffix_for
from beltrami_cli.formats.textured_mesh import as_if_with_suffixes, with_images, with_suffixes
from beltrami_cli.surface.geometry import vertex_normals
from beltrami_cli.surface.grouping import group_equal_rows
from beltrami_cli.surface.records import ImageFile, MovedVertices

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from beltrami_cli.arrays import Float32s, Float64s
    from beltrami_cli.formats.access import Access
    from beltrami_cli.formats.document import Document, Written
    from beltrami_cli.jobs.output import Output
    from beltrami_cli.samples.samples import Repainted
    from beltrami_cli.samples.selection import OutputFormat, Selection
    from beltrami_cli.samples.settings import SmoothSettings
    from beltrami_cli.surface.records import PaintedVertices, Slot, TexturedSurface


def open_input(source: str, settings: SmoothSettings, access: Access) -> Document:
    """Read a file, or standard input for "-", as a document; errors if it is unsupported, or no level set."""
    return document_from(read_source(source, access), source, settings, access)


def document_from(data: bytes, source: str, settings: SmoothSettings, access: Access) -> Document:
    """Open a source whose bytes have been read already; see `open_input`."""
    name, folder = ("<stdin>", None) if source == "-" else (source, Path(source).parent)
    kind = registry.kind_of(data, name)
    if kind == "volume":
        from beltrami_cli.samples.voxels import LevelSetDocument

        return LevelSetDocument(data, name, folder, settings.level_set, access, settings.kernel.thread_count)
    if settings.level_set.given:
        raise UsageError(f"{', '.join(settings.level_set.given)}: for level sets, and {name} is none")
    if kind == "image":
        from beltrami_cli.formats.image import ImageDocument

        return ImageDocument(data, name, folder, access)
    return registry.document_of(data, source, access)


def with_painted(document: Document, painted: Sequence[Repainted]) -> Document:
    """Return a document that looks like one with other colours, for reading only: it has no bytes of its own."""
    from beltrami_cli.formats.image import ImageDocument

    images = {key: image.data for each in painted for key, image in each.images.items()}
    if isinstance(document, ImageDocument):
        data = images.get(("baseColor", ""), document.data)
        return document if data == document.data else ImageDocument(data, document.name)

    def textured(slot: Slot) -> TexturedSurface:
        surface = document.textured(slot)
        textures = [
            dataclasses.replace(each, content=images.get((slot, each.key), each.content))
            for each in surface.textures
        ]
        return dataclasses.replace(surface, textures=tuple(textures))

    made = copy(document)
    for each in painted:
        if each.colours is not None:
            made.painted = partial(_with_colours, document, each)  # type: ignore[method-assign]
    if images:
        made.textured = textured  # type: ignore[method-assign]
    return made


def _with_colours(document: Document, new: Repainted) -> PaintedVertices:
    """Return the vertices of a document with new colours, rounded to what a file holds of them."""
    painted, colours = document.painted(), cast("Float32s", new.colours)
    if painted.stored.startswith("uint"):
        full = np.float32(np.iinfo(painted.stored).max)
        colours = np.asarray(np.rint(np.clip(colours, 0, 1) * full) / full, np.float32)
    places = painted.positions if new.positions is None else new.positions
    return dataclasses.replace(painted, colours=colours, positions=places)


def make_files(
    document: Document, colours: Float32s | None, images: Mapping[tuple[Slot, str], ImageFile], kind: OutputFormat,
    naming: Naming, places: MovedVertices | None = None,
) -> Written:  # fmt: skip
    """Return the files of a document with other colours and positions; UsageError if textures cannot be converted."""
    target_format = kind.name
    if kind.is_own or kind.suffix is not None:
        return document.patch(colours, naming, images=images, places=places)
    if target_format in document.forms:
        return document.repackaged(colours, naming, target_format, images=images, places=places)
    if is_converted_with_textures(document, kind):
        if places is not None:
            raise UsageError(
                f"{document.name}: positions that --smooth-geometry moves cannot be converted together with textures; "
                f"give the output the extension .{document.format}"
            )
        mesh = with_images(document.textured_mesh(colours), images)
        mesh, notices = with_suffixes(mesh, registry.held_images(target_format) or ())
        stem = naming.free_stem(lambda stem: registry.textured_sidecars(mesh, target_format, stem))
        written = registry.write_textured(mesh, target_format, stem)
        return dataclasses.replace(written, notices=(*notices, *written.notices))
    if images or (document.slots() and not document.has_vertex_colours()):
        remedy = "end the name of the output in .glb, .gltf, .obj or .ply"
        raise UsageError(f"a .{target_format} file has no textures; {remedy}")
    contents = document.contents()
    if colours is not None:
        contents = dataclasses.replace(contents, colours=colours)
    if places is not None:
        normals = contents.normals
        if normals is not None and places.normals is not None:
            normals = np.where(np.isnan(places.normals), normals, places.normals)
        contents = dataclasses.replace(contents, positions=places.positions, normals=normals)
    stem = naming.free_stem(lambda stem: registry.sidecar_names(target_format, stem, None))
    return registry.write_contents(contents, target_format, stem)


def is_converted_with_textures(document: Document, kind: OutputFormat) -> bool:
    """Whether a document is written anew, as another format that can hold its textures."""
    if kind.is_own or kind.suffix is not None or kind.name in document.forms:
        return False
    return registry.held_images(kind.name) is not None and bool(document.slots())


def moved_vertices(document: Document, positions: Float64s) -> MovedVertices:
    """Return new positions, rows as in `painted`, with normals around moved vertices if every vertex has one."""
    painted = document.painted()
    if not document.has_normals_by_vertex():
        return MovedVertices(positions)
    # Copies of a vertex that share a normal share the new one; others stay separate, so that hard edges stay hard.
    columns = [*painted.positions.T, *document.attribute("normal").T]
    if painted.space_of is not None:
        columns.append(painted.space_of)
    group_of, _ = group_equal_rows(*columns)
    normals = vertex_normals(positions, painted.faces, group_of)
    moved = np.any(positions != painted.positions, axis=1)
    touched = np.zeros(int(group_of.max(initial=-1)) + 1, bool)
    touched[group_of[painted.faces[moved[painted.faces].any(axis=1)]]] = True
    normals[~touched[group_of] | ~normals.any(axis=1)] = np.nan
    return MovedVertices(positions, normals)


@dataclass(frozen=True)
class Sidecars:
    """The files beside an output."""

    folder: Path  # of the source
    naming: Naming
    notices: tuple[str, ...] = ()

    def complete(self, written: Written, access: Access) -> Written:
        """Add the contents of the unchanged files that are copied, and the notices."""
        copied = {new: read_regular(self.folder / old, access) for new, old in written.copies.items()}
        sidecars, notices = {**written.sidecars, **copied}, (*self.notices, *written.notices)
        return dataclasses.replace(written, sidecars=sidecars, notices=notices)


def plan_sidecars(
    document: Document, selection: Selection, settings: SmoothSettings, kind: OutputFormat, ends: tuple[str, str],
    output: Output | None, access: Access,
) -> Sidecars:  # fmt: skip
    """Plan the files beside the output, from `ends[0]` to `ends[1]`; OutputError if they cannot be written."""
    others: dict[str, None] = {}
    naming = naming_of(document, *ends, output, access, others)
    plan = Sidecars(Path(ends[0]).parent, naming)
    if output is None:
        return plan
    output.check_sidecars(_names(naming, document, selection, settings, kind))
    if not others:
        return plan
    state = "is of something else, and stays" if len(others) == 1 else "are of something else, and stay"
    notice = f"{', '.join(others)} beside OUTPUT {state}; what is new has a number in its name."
    return dataclasses.replace(plan, notices=(notice,))


def naming_of(
    document: Document, source: str, target: str, output: Output | None, access: Access,
    others: dict[str, None] | None = None,
) -> Naming:  # fmt: skip
    """Return how the files beside an output are named; files of something else that are in the way go to `others`."""
    folder = None if output is None else output.folder
    keeps = "-" not in (source, target) and Path(source).resolve() == Path(os.path.realpath(target))
    if output is not None and keeps:
        output.replaceable = frozenset(document.references())

    def is_taken(name: str) -> bool:
        if output is None or folder is None or not os.path.lexists(folder / name):
            return False
        if not output.replaceable:
            with suppress(BeltramiError):  # there may be no output yet, or none that names files
                there = registry.open_document(target, dataclasses.replace(access, note=None))
                output.replaceable = frozenset(there.references())
        if name in output.replaceable:
            return False
        if others is not None:
            others[name] = None
        return True

    return Naming(Path(target).stem, keeps, is_moved(source, target), is_taken)


def _names(
    naming: Naming, document: Document, selection: Selection, settings: SmoothSettings, kind: OutputFormat
) -> list[str]:
    """Find the files that would be written beside the output, by writing the old images anew."""
    from beltrami_cli.samples.texel_colours import choose_textures

    suffix = settings.textures.image_suffix
    images = {
        (slot, texture.key): ImageFile(
            # Other bytes, since what is equal is not written anew; each its own.
            f"new {texture.key}".encode(),
            suffix or suffix_for(texture.data, texture.name) or ".png",
        )
        for slot in selection.slots
        for texture in choose_textures(document.textured(slot), settings.textures).textures
    }
    if is_converted_with_textures(document, kind):
        held = registry.held_images(kind.name) or ()
        mesh = as_if_with_suffixes(with_images(document.textured_mesh(), images), held)
        stem = naming.free_stem(lambda stem: registry.textured_sidecars(mesh, kind.name, stem))
        return registry.textured_sidecars(mesh, kind.name, stem)
    written = make_files(document, None, images, kind, naming)
    return [*written.sidecars, *written.copies]


def is_moved(source: str, target: str) -> bool:
    """Whether the output is in another folder than the source."""
    if "-" in (source, target):
        return source != "-"
    return Path(source).resolve().parent != Path(os.path.realpath(target)).parent
