"""What the painted vertices of a glTF file have beside their places and colours."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.formats.gltf.primitives import attribute_accessor

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from beltrami_cli.formats.gltf.accessors import Accessors
    from beltrami_cli.formats.gltf.surfaces import Block
    from beltrami_cli.formats.gltf.tree import Entry

_OTHERWISE = ("POSITION", "COLOR_0", "NORMAL")
_INDICES = ("JOINTS_", "WEIGHTS_")


def attribute_names(root: Entry, blocks: Sequence[Block]) -> tuple[str, ...]:
    """Return the attributes that all blocks have; "normal" for their normals."""
    held = [set(_attributes(root, block).value) for block in blocks]
    common = set.intersection(*held) if held else set()
    others = sorted(name for name in common if name not in _OTHERWISE and not name.startswith(_INDICES))
    return (*(("normal",) if "NORMAL" in common else ()), *others)


def read_attribute(
    root: Entry, blocks: Sequence[Block], accessors: Accessors, name: str
) -> NDArray[np.float64]:
    """Read an attribute of all blocks, shape (V, G).

    Raises
    ------
    InputError
        If it is damaged, or of another width or length in one of them.
    """
    parts: list[NDArray[np.float64]] = []
    for block in blocks:
        mesh, part = block.users[0]
        primitive = root.entries("meshes")[mesh].entries("primitives")[part]
        values = accessors.values(attribute_accessor(primitive, name, accessors))
        if len(values) != block.count or (parts and values.shape[1] != parts[0].shape[1]):
            cause = f"is {len(values)} x {values.shape[1]} numbers, which do not fit {block.count} vertices"
            if parts and len(values) == block.count:
                cause += f" of {parts[0].shape[1]} numbers elsewhere"
            raise _attributes(root, block).fault(name, cause)
        parts.append(values)
    return np.concatenate(parts)


def _attributes(root: Entry, block: Block) -> Entry:
    mesh, part = block.users[0]
    return root.entries("meshes")[mesh].entries("primitives")[part].entry("attributes")
