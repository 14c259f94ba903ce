"""Files beside the model that it needs: external buffers and images."""

from __future__ import annotations

from typing import TYPE_CHECKING

from beltrami_cli.formats.gltf.files import UnfitReferenceError, is_data, located, relative_name

if TYPE_CHECKING:
    from pathlib import Path

    from beltrami_cli.formats.gltf.tree import Entry


def present(root: Entry, folder: Path | None) -> tuple[list[str], list[str]]:
    """Return the relative paths of files that exist inside the folder, and a notice for every other.

    Raises
    ------
    InputError
        If a uri is not a string.
    """
    names: dict[str, None] = {}
    notices: dict[str, None] = {}
    for kind in ("buffers", "images"):
        for entry in root.entries(kind):
            uri = entry.text("uri")
            if uri is None or is_data(uri):
                continue
            try:
                located(uri, folder)
                names[relative_name(uri)] = None
            except UnfitReferenceError as error:
                notices[f"{entry.place}: {error}."] = None
    return list(names), list(notices)
