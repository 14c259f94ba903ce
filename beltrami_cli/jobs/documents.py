"""Documents of a job: the input, the files of the output, and the files that belong beside it."""

from __future__ import annotations

import dataclasses
import os
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from beltrami_cli.errors import BeltramiError, OutputError, UsageError
from beltrami_cli.formats.access import EVERYTHING_INSIDE, Access, read_regular, read_source
from beltrami_cli.formats.image.recognition import suffix_for
from beltrami_cli.formats.registry import document_of, kind_of, open_document, write_contents
from beltrami_cli.surface.geometry import vertex_normals
from beltrami_cli.surface.grouping import group_equal_rows
from beltrami_cli.surface.records import ImageFile, MovedVertices

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from numpy.typing import NDArray

    from beltrami_cli.formats.access import Access
    from beltrami_cli.formats.document import Document, Written
    from beltrami_cli.jobs.writing.output import Output
    from beltrami_cli.samples.selection import OutputFormat, Selection
    from beltrami_cli.samples.settings import SmoothSettings
    from beltrami_cli.surface.records import MeshContents, PaintedVertices, Slot


def open_input(source: str, settings: SmoothSettings, access: Access) -> Document:
    """Read a file, or standard input for "-", as a document; errors if it is unsupported, or no level set."""
    return document_from(read_source(source, access), source, settings, access)


def document_from(data: bytes, source: str, settings: SmoothSettings, access: Access) -> Document:
    """Open a source whose bytes have been read already; see `open_input`."""
    name, folder = ("<stdin>", None) if source == "-" else (source, Path(source).parent)
    kind = kind_of(data, name)
    if kind == "volume":
        from beltrami_cli.samples.voxels import LevelSetDocument

        return LevelSetDocument(data, name, folder, settings.level_set, access, settings.kernel.thread_count)
    if settings.level_set.given:
        raise UsageError(f"{', '.join(settings.level_set.given)}: for level sets, and {name} is none")
    if kind == "image":
        from beltrami_cli.formats.image.document import ImageDocument

        return ImageDocument(data, name, folder, access)
    return document_of(data, source, access)


def make_files(
    document: Document,
    colours: NDArray[np.float32] | None,
    images: Mapping[tuple[Slot, str], ImageFile],
    kind: OutputFormat,
    stem: str,
    *,
    moved: bool,
    places: MovedVertices | None = None,
) -> Written:
    """Return the files of a document with other colours and positions; UsageError if textures cannot be converted."""
    target_format = kind.name
    if kind.is_own or kind.suffix is not None:
        return document.patch(colours, stem, moved=moved, images=images, places=places)
    from beltrami_cli.formats.gltf import GltfDocument

    if isinstance(document, GltfDocument) and target_format in ("glb", "gltf"):
        form: Literal["glb", "gltf"] = "glb" if target_format == "glb" else "gltf"
        return document.repackaged(colours, stem, form, moved=moved, images=images, places=places)
    if images or (document.slots() and not document.has_vertex_colours()):
        raise UsageError(
            f"textures cannot be converted from {document.format} to {target_format}; "
            f"give the output the extension .{document.format}, or add --unwrap, which makes one new texture of them"
        )
    contents = document.contents()
    if colours is not None:
        contents = dataclasses.replace(contents, colours=colours)
    if places is not None:
        contents = _moved(contents, places)
    return write_contents(contents, target_format, stem)


def _moved(contents: MeshContents, places: MovedVertices) -> MeshContents:
    normals = contents.normals
    if normals is not None and places.normals is not None:
        normals = np.where(np.isnan(places.normals), normals, places.normals)
    return dataclasses.replace(contents, positions=places.positions, normals=normals)


def moved_vertices(document: Document, positions: NDArray[np.float64]) -> MovedVertices:
    """Return new positions, rows as in `painted`, with normals around moved vertices if every vertex has one."""
    painted = document.painted()
    if not document.has_normals_by_vertex():
        return MovedVertices(positions)
    return MovedVertices(positions, _normals(painted, document.attribute("normal"), positions))


def _normals(
    painted: PaintedVertices, old: NDArray[np.float64], positions: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Return the normals of moved vertices and their neighbours, shape (V, 3), NaN for the others."""
    # Copies of a vertex that share a normal share the new one; others stay separate, so that hard edges stay hard.
    columns = [*painted.positions.T, *old.T]
    if painted.space_of is not None:
        columns.append(painted.space_of)
    group_of, _ = group_equal_rows(*columns)
    normals = vertex_normals(positions, painted.faces, group_of)
    moved = np.any(positions != painted.positions, axis=1)
    touched = np.zeros(int(group_of.max(initial=-1)) + 1, bool)
    touched[group_of[painted.faces[moved[painted.faces].any(axis=1)]]] = True
    kept = ~touched[group_of] | ~normals.any(axis=1)
    normals[kept] = np.nan
    return normals


@dataclass(frozen=True)
class Sidecars:
    """The files beside an output."""

    folder: Path  # of the source
    references: tuple[str, ...]  # unchanged files of the source to copy, relative to its folder
    keep_names: bool  # changed files keep the names of the source's
    target_folder: Path | None = None
    strangers: frozenset[str] = frozenset()  # files in it that belong to something else
    notices: tuple[str, ...] = ()

    def complete(self, written: Written, access: Access = EVERYTHING_INSIDE) -> Written:
        """Add the unchanged files that the model still names, and the notices; OutputError as `plan_sidecars`."""
        left = [n for n in self.references if n not in written.sidecars and n not in written.superseded]
        copied = {name: read_regular(self.folder / name, access) for name in left}
        self.check_copies(copied)
        sidecars, notices = {**written.sidecars, **copied}, (*self.notices, *written.notices)
        return dataclasses.replace(written, sidecars=sidecars, notices=notices)

    def check_copies(self, names: Iterable[str]) -> None:
        """Raise OutputError if a file of the source would replace one of something else that is different."""
        folder = self.target_folder
        for name in self.strangers.intersection(names):
            if folder is not None and not _equal(folder / name, self.folder / name):
                raise _in_the_way(folder / name)


def plan_sidecars(
    document: Document,
    selection: Selection,
    settings: SmoothSettings,
    kind: OutputFormat,
    ends: tuple[str, str],
    output: Output | None,
    access: Access,
) -> Sidecars:
    """Plan the files beside the output, from `ends[0]` to `ends[1]`; OutputError if they may not be written."""
    # In another folder than the source's, files keep their names. If that folder has a file of such a name already,
    # which the old OUTPUT does not name, changed files are named after OUTPUT, as beside the source.
    source, target = ends
    moved = is_moved(source, target)
    references = tuple(document.references()) if moved and kind.is_own else ()
    plan = Sidecars(Path(source).parent, references, moved)
    if output is None:
        return plan
    names = _names(plan, document, selection, settings, kind, target)
    output.check_sidecars(names.keys())
    strangers = _strangers(output, {*names, *references}, target, access) if moved else frozenset()
    if any(names.get(name) for name in strangers):
        others = ", ".join(sorted(name for name in strangers if names.get(name)))
        notice = f"{others} beside OUTPUT is of something else, and stays; what is new is named after OUTPUT."
        plan = dataclasses.replace(plan, keep_names=False, notices=(notice,))
        names = _names(plan, document, selection, settings, kind, target)
        output.check_sidecars(names.keys())
        strangers = _strangers(output, {*names, *references}, target, access)
    plan = dataclasses.replace(plan, target_folder=output.folder, strangers=strangers)
    if output.folder is not None and (blocked := [name for name in strangers if names.get(name)]):
        raise _in_the_way(output.folder / min(blocked))
    plan.check_copies(name for name, is_new in names.items() if not is_new)
    return plan


def _names(
    plan: Sidecars,
    document: Document,
    selection: Selection,
    settings: SmoothSettings,
    kind: OutputFormat,
    target: str,
) -> dict[str, bool]:
    """Find the files that would be written beside the output, by writing the old images anew; True: it is new."""
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
    written = make_files(document, None, images, kind, Path(target).stem, moved=plan.keep_names)
    copied = [name for name in plan.references if name not in written.superseded]
    return dict.fromkeys(copied, False) | dict.fromkeys(written.sidecars, True)


def _strangers(output: Output, names: set[str], target: str, access: Access) -> frozenset[str]:
    """Find which of the names stand for files there that the old OUTPUT does not name."""
    folder = output.folder
    found = frozenset() if folder is None else frozenset(name for name in names if (folder / name).exists())
    if found:
        with suppress(BeltramiError):  # there may be no old OUTPUT, or none that names files
            found -= set(open_document(target, dataclasses.replace(access, note=None)).references())
    return found


def _equal(one: Path, other: Path) -> bool:
    with suppress(OSError):
        return read_regular(one, EVERYTHING_INSIDE) == read_regular(other, EVERYTHING_INSIDE)
    return False


def _in_the_way(path: Path) -> OutputError:
    cause = "is of something else than OUTPUT, and would be replaced by a file of the same name"
    return OutputError(str(path), cause, "choose another folder")


def is_moved(source: str, target: str) -> bool:
    """Return whether the output is in another folder than the source."""
    if "-" in (source, target):
        return source != "-"
    return Path(source).resolve().parent != Path(os.path.realpath(target)).parent
