"""Names of new image files beside a glTF, such that no source is overwritten."""

from __future__ import annotations

import re
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

from beltrami_cli.formats.gltf.files import UnfitReferenceError, as_uri, is_data, relative_name
from beltrami_cli.formats.gltf.storing import MEDIA

if TYPE_CHECKING:
    from beltrami_cli.formats.document import Bytes
    from beltrami_cli.formats.gltf.json_text import Tree
    from beltrami_cli.formats.gltf.patching import Edit
    from beltrami_cli.formats.gltf.tree import Entry
    from beltrami_cli.mesh.textured import ImageFile


def used_names(root: Entry) -> set[str]:
    """Return the names of all files that a glTF refers to, case folded."""
    taken = set()
    for entry in [*root.entries("buffers"), *root.entries("images")]:
        uri = entry.text("uri")
        if uri is not None and not is_data(uri):
            try:
                taken.add(relative_name(uri).casefold())
            except UnfitReferenceError:
                continue  # not a name beside the file, so it cannot be hit
    return taken


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
        old = relative_name(tree["images"][index]["uri"])
        key = old, index < known, file
        if key not in chosen:
            keeps = moved and index < known
            name = with_suffix(old if keeps else renamed(old, source, stem), file.suffix)
            if not keeps or name != old:
                name = _unused(name, taken)
            chosen[key] = name
            taken.add(name.casefold())
            sidecars[name] = file.data
        if chosen[key] != old:
            tree["images"][index]["uri"] = as_uri(chosen[key])
    return sidecars


def renamed(name: str, source: str, stem: str) -> str:
    """Return the path of a file named after another model: its stem replaced as a word, or put in front."""
    path = PurePosixPath(name)
    word = rf"(?<![^\W_]){re.escape(source)}(?![^\W_])"
    new, count = re.subn(word, lambda _: stem, path.name, count=1)
    return str(path.with_name(new if count else f"{stem}_{path.name}"))


def with_suffix(name: str, suffix: str) -> str:
    """Return a path that ends as its type asks for; unchanged if it already does."""
    path = PurePosixPath(name)
    if MEDIA.get(path.suffix.lower()) == MEDIA[suffix.lower()]:
        return name
    return str(path.with_suffix(suffix))


def _unused(name: str, taken: set[str]) -> str:
    path, number = PurePosixPath(name), 2
    while name.casefold() in taken:
        name = str(path.with_name(f"{path.stem}-{number}{path.suffix}"))
        number += 1
    return name
