"""Views that meshoptimizer has compressed, compressed again after their bytes were changed."""

from __future__ import annotations

from typing import TYPE_CHECKING

from beltrami_cli.formats.gltf.meshopt import repacked
from beltrami_cli.formats.gltf.sharing import named_places

if TYPE_CHECKING:
    from beltrami_cli.formats.gltf.editing import Edit
    from beltrami_cli.formats.gltf.layouts import View


def compress_again(edit: Edit) -> None:
    """Put the changed bytes of all compressed views back into the buffers of the file.

    The new data takes the place of the old if it is not longer and nothing else reads that, otherwise it is appended.
    Bytes for viewers that do not know the extension are renewed, too, where there are such.
    """
    for index, view in enumerate(edit.accessors.views):
        data = edit.buffers.pop(view.buffer, None) if view.packed is not None else None
        if data is not None:
            _store(edit, index, view, data)


def _store(edit: Edit, index: int, view: View, data: bytearray) -> None:
    packed = view.packed
    if packed is None or view.fallback is None:
        raise AssertionError("only compressed views are compressed again")
    buffers = edit.accessors.buffers
    home, end = buffers.canonical(packed.buffer), packed.offset + packed.length
    octets = repacked(packed, data, buffers.stored(packed.buffer))
    extension = edit.tree["bufferViews"][index]["extensions"][packed.extension]
    extension.pop("filter", None)
    extension["byteLength"] = len(octets)
    if len(octets) <= packed.length and _alone(edit, (index, packed.extension), home, packed.offset, end):
        edit.open(home)[packed.offset : end] = octets.ljust(packed.length, b"\0")
    else:
        extension |= {"buffer": home, "byteOffset": edit.append(home, octets)}
    plain, start = buffers.canonical(view.fallback[0]), view.fallback[1]
    if buffers.source(plain) != "nowhere" and _alone(edit, (index, None), plain, start, start + len(data)):
        edit.open(plain)[start : start + len(data)] = data


def _alone(edit: Edit, own: tuple[int, str | None], buffer: int, start: int, end: int) -> bool:
    """Return whether no other view, and no other extension of a view, names any of these bytes."""
    canonical = edit.accessors.buffers.canonical
    return not any(
        place != own and canonical(part.buffer) == buffer and part.start < end and start < part.end
        for place, part in named_places(edit.container.tree, edit.accessors.buffers.lengths)
    )
