"""The sidecar files of an OBJ file with new images: their names, and the names by which others refer to them."""

from __future__ import annotations

import os
import posixpath
from collections.abc import Mapping, Set
from dataclasses import dataclass, replace
from pathlib import PurePosixPath

from beltrami_cli.formats.changes import Naming, NewImages, Written
from beltrami_cli.formats.files.edits import Spans, exchange_spans
from beltrami_cli.formats.obj.materials import SLOTS, Library, Map, Materials
from beltrami_cli.formats.sidecars.model_folder import is_outside
from beltrami_cli.formats.sidecars.new_files import (
    NewFiles,
    common_suffix,
    new_paths,
    new_reference,
    path_inside,
    replacements,
)


@dataclass(frozen=True)
class Renaming:
    """New names in an OBJ file and its libraries, and the sidecar files of the output except the libraries."""

    files: NewFiles
    spans: Spans  # in the model
    libraries: dict[str, tuple[Library, Spans]]  # changed ones, by their new names

    @property
    def sidecar_names(self) -> list[str]:
        return [*self.files.sidecars, *self.libraries, *self.files.copies]

    def written(self) -> Written:
        """Return the sidecar files."""
        edited = {
            name: exchange_spans(library.data, spans) for name, (library, spans) in self.libraries.items()
        }
        return replace(self.files.written(), sidecars=self.files.sidecars | edited)


def renaming(materials: Materials, images: NewImages, source: str, naming: Naming) -> Renaming:
    """Name the sidecar files of an OBJ file with new images."""
    missing = [shown.name for library in materials.libraries for shown, path in library.maps if path is None]
    names = NewFiles(naming, source, materials.paths, missing)
    edits = _take_images(materials, images, names)
    _rename_others(materials, names, edits)
    return _name_libraries(materials, names, edits)


def _take_images(materials: Materials, images: NewImages, names: NewFiles) -> dict[str, Spans]:
    """Put new images among the sidecars, other tiles of their sets among the copies; return new names by library."""
    edits: dict[str, Spans] = {}
    paths = materials.paths_by_file()
    for each in replacements(images, lambda slot, file: paths[file]):
        path = each.path
        # Equal images of two slots are one file; maps of the base colour may be of other slots, too.
        maps = [shown for slot in each.slots for shown in materials.affected(slot, path)]
        affected = {(library.path, shown.start): (library, shown) for library, shown in maps}
        _note_stale_uses(materials, names, path, affected.keys())
        # Its name is free only if no map that keeps the old image has it.
        is_replaced = len(affected) == materials.uses(path)
        suffix = common_suffix(image.suffix for image in each.files.values())
        tiles = materials.folder.tiles_of(path)
        new = names.image(path, suffix, is_replaced=is_replaced, tiles=tiles)
        new_of = new_paths(path, new, tiles)
        names.sidecars |= {new_of.pop(file): image.content for file, image in each.files.items()}
        names.copies |= {file: old for old, file in new_of.items() if file != old}
        for library, shown in affected.values():
            edits.setdefault(library.path, {})[shown.start, shown.end] = _spelled(shown, path, new, library)
    return edits


def _note_stale_uses(
    materials: Materials, names: NewFiles, path: str, replaced: Set[tuple[str, int]]
) -> None:
    """Note the maps outside of the slots that keep an old image; `replaced`: library and offset of the others."""
    for library in materials.libraries:
        for shown, used in library.maps:
            if used == path and shown.keyword not in SLOTS and (library.path, shown.start) not in replaced:
                names.note_stale_use(f"{shown.keyword} of material {shown.material}", path)


def _rename_others(materials: Materials, names: NewFiles, edits: dict[str, Spans]) -> None:
    """Name the images that stay as they are, for libraries that are written, or copied, into another folder."""
    new_of: dict[str, str] = {}
    for library in materials.libraries:
        moves_inside = is_outside(library.path)
        if not (edits.get(library.path) if moves_inside else names.is_moved):
            continue
        edits_of_file = edits.setdefault(library.path, {})
        for shown, path in library.maps:
            if path is None or (shown.start, shown.end) in edits_of_file:
                continue
            if is_outside(path) and not moves_inside:
                names.leave(shown.name)
                continue
            if path not in new_of:
                moves = is_outside(path) or names.is_moved
                new_of[path] = _copied(materials, names, path) if moves else path
            edits_of_file[shown.start, shown.end] = _spelled(shown, path, new_of[path], library)


def _copied(materials: Materials, names: NewFiles, path: str) -> str:
    """Put an image or tile set that stays as it is among the copies; return its new path."""
    tiles = materials.folder.tiles_of(path)
    new = names.image(path, tiles=tiles)
    for old, copy in new_paths(path, new, tiles).items():
        if is_outside(old):
            names.sidecars[copy] = materials.folder.content(old)
        else:
            names.copies[copy] = old
    return new


def _name_libraries(materials: Materials, names: NewFiles, edits: Mapping[str, Spans]) -> Renaming:
    """Name the libraries that change, or that another folder needs copies of."""
    spans: Spans = {}
    changed: dict[str, tuple[Library, Spans]] = {}
    for library in materials.libraries:
        new_names, outside = edits.get(library.path, {}), is_outside(library.path)
        differs = any(library.data[start:end] != new for (start, end), new in new_names.items())
        is_new = bool(new_names) and (outside or differs)
        if not is_new and outside:
            for name, _, _ in library.mentions:
                names.leave(name)
        if not is_new and (outside or not names.is_moved):
            continue
        new = names.other(library.path, ".mtl")
        spans |= {
            (start, end): new_reference(name, library.path, new) for name, start, end in library.mentions
        }
        if is_new:
            changed[new] = library, new_names
        else:
            names.copies[new] = library.path
    return Renaming(names, spans, changed)


def _spelled(shown: Map, path: str, new: str, library: Library) -> bytes:
    """Return the name in a library of an image that moves from one path to another."""
    plain = PurePosixPath(shown.name.replace("\\", "/"))
    leads_there = posixpath.normpath(PurePosixPath(library.path).parent / plain) == path
    is_plain = leads_there and ".." not in plain.parts
    if is_outside(path) or is_outside(library.path) or not (is_plain or new == path):
        home = PurePosixPath(path_inside(library.path)).parent
        return os.fsencode("../" * len(home.parts) + new)
    return new_reference(shown.name, path, new)
