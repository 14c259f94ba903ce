"""The files of an edited glTF: where changed buffers go, and under which names."""

from __future__ import annotations

from typing import TYPE_CHECKING

from beltrami_cli.formats.document import Written
from beltrami_cli.formats.gltf.files import as_uri, re_embedded, relative_name
from beltrami_cli.formats.gltf.naming import named_files, place_pictures, used_names
from beltrami_cli.formats.gltf.tree import Entry
from beltrami_cli.formats.model_folder import path_inside

if TYPE_CHECKING:
    from collections.abc import Iterator

    from beltrami_cli.formats.document import Bytes
    from beltrami_cli.formats.gltf.editing import Edit
    from beltrami_cli.formats.gltf.json_text import Tree


def written(edit: Edit, stem: str, *, moved: bool) -> Written:
    """Return the files of an edit in the form of the source; the source itself if nothing was edited.

    Parameters
    ----------
    edit : Edit
        The changes.
    stem, moved
        As for `Document.patch`.
    """
    if not edit.buffers and not edit.pictures and edit.tree == edit.container.tree:
        return Written([edit.container.data], {}, tuple(edit.notices))
    sidecars = place_buffers(edit, edit.tree, sidecar_names(edit.container.root, stem), moved=moved)
    sidecars |= place_pictures(edit, edit.tree, stem, moved=moved)
    chunk = edit.buffers.get(0) if _source(edit, 0) == "chunk" else None
    kept = used_names(Entry(edit.container.name, "", edit.tree))
    superseded = {name for name in named_files(edit.container.root) if name.casefold() not in kept}
    pieces = edit.container.rebuilt(edit.tree, chunk)
    return Written(pieces, sidecars, tuple(edit.notices), frozenset(superseded))


def place_buffers(edit: Edit, tree: Tree, names: Iterator[str], *, moved: bool) -> dict[str, Bytes]:
    """Put changed buffers where they belong: data URIs into the tree, external ones into sidecars.

    Parameters
    ----------
    edit : Edit
        The changes.
    tree : dict
        The JSON, whose URIs are changed.
    names : iterator of str
        Names for sidecars that must not keep theirs.
    moved : bool
        Whether sidecars keep their names.

    Returns
    -------
    dict of str to bytes-like
        The sidecars; the BIN chunk is not among them.
    """
    sidecars: dict[str, Bytes] = {}
    buffers = edit.accessors.buffers
    for index, data in edit.buffers.items():
        source = _source(edit, index)
        if source == "data":
            tree["buffers"][index]["uri"] = re_embedded(tree["buffers"][index]["uri"], data)
        elif source == "file":
            old = relative_name(buffers.uris[index] or "", outside=True)
            name = path_inside(old) if moved else next(names)
            sidecars[name] = data
            for other in range(len(buffers)):
                if buffers.canonical(other) == index and name != old:
                    tree["buffers"][other]["uri"] = as_uri(name)
    return sidecars


def _source(edit: Edit, index: int) -> str:
    buffers = edit.accessors.buffers
    if index >= len(buffers):  # one that the edit added
        return "data" if index in edit.buffers else "nowhere"
    return buffers.source(index)


def sidecar_names(root: Entry, stem: str) -> Iterator[str]:
    """Generate ``stem.bin``, ``stem-2.bin``, ... without names that the file already uses."""
    taken = used_names(root)
    number = 1
    while True:
        name = f"{stem}.bin" if number == 1 else f"{stem}-{number}.bin"
        if name.casefold() not in taken:
            yield name
        number += 1
