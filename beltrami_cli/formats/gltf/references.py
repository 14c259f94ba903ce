"""Files beside the model that it needs: external buffers and images."""

from __future__ import annotations

from typing import TYPE_CHECKING

from beltrami_cli.formats.gltf.files import is_data, located
from beltrami_cli.formats.model_folder import LEFT_OUTSIDE, UnfitReferenceError, is_outside

if TYPE_CHECKING:
    from beltrami_cli.formats.gltf.tree import Entry
    from beltrami_cli.formats.model_folder import ModelFolder


def present(root: Entry, beside: ModelFolder) -> tuple[list[str], list[str]]:
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
                path = located(uri, beside)
                if is_outside(path):
                    notices[f"{entry.place}: {uri!r} {LEFT_OUTSIDE}"] = None
                else:
                    names[path] = None
            except UnfitReferenceError as error:
                notices[f"{entry.place}: {error}."] = None
    return list(names), list(notices)
