"""Names of new image files beside a glTF, such that no source is overwritten."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from beltrami_cli.formats.gltf.files import as_uri, is_data, relative_name
from beltrami_cli.formats.model_folder import UnfitReferenceError, path_inside, renamed, unused, with_suffix

if TYPE_CHECKING:
    from beltrami_cli.formats.document import Bytes
    from beltrami_cli.formats.gltf.editing import Edit
    from beltrami_cli.formats.gltf.json_text import Tree
    from beltrami_cli.formats.gltf.tree import Entry
    from beltrami_cli.surface.records import ImageFile


def used_names(root: Entry) -> set[str]:
    """Return the names of all files that a glTF refers to, case folded."""
    return {name.casefold() for name in named_files(root)}


def named_files(root: Entry) -> set[str]:
    """Return the relative paths of all files that a glTF refers to."""
    names = set()
    for entry in [*root.entries("buffers"), *root.entries("images")]:
        uri = entry.text("uri")
        if uri is not None and not is_data(uri):
            try:
                names.add(relative_name(uri))
            except UnfitReferenceError:
                continue  # not a name beside the file, so it cannot be hit
    return names


def place_pictures(edit: Edit, tree: Tree, stem: str, *, moved: bool) -> dict[str, Bytes]:
    """Name the new image files and put their names into the tree.

    Parameters
    ----------
    edit : Edit
        The changes.
    tree : dict
        The JSON, whose URIs are changed.
    stem, moved
        As for `Document.patch`. Images that were added get a name of their own in any case.

    Returns
    -------
    dict of str to bytes-like
        The image files.
    """
    sidecars: dict[str, Bytes] = {}
    chosen: dict[tuple[str, bool, ImageFile], str] = {}
    taken, source = used_names(edit.container.root), Path(edit.container.name).stem
    known = len(edit.container.root.entries("images"))
    for index, file in edit.pictures.items():
        old = relative_name(tree["images"][index]["uri"], outside=True)
        key = old, index < known, file
        if key not in chosen:
            keeps = moved and index < known
            name = with_suffix(
                path_inside(old) if keeps else renamed(path_inside(old), source, stem), file.suffix
            )
            if not keeps or name != old:
                name = unused(name, taken)
            chosen[key] = name
            taken.add(name.casefold())
            sidecars[name] = file.data
        if chosen[key] != old:
            tree["images"][index]["uri"] = as_uri(chosen[key])
    return sidecars
