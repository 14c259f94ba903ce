"""Accessors, views and bytes of a new glTF file, while they are put together."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.errors import InputError
from beltrami_cli.formats.gltf.layouts import COMPONENTS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.formats.gltf.accessors import Stored
    from beltrami_cli.formats.gltf.json_text import Tree

_COMPONENT_TYPE = {np.dtype(name): number for number, name in COMPONENTS.items()}
_MOST_FOR_U16 = 65535  # vertices: index 65535 would mean the restart of a strip


class Arrays:
    """Accessors, their views, and the bytes behind them, while they are put together."""

    def __init__(self) -> None:
        self.accessors: list[Tree] = []
        self.views: list[Tree] = []
        self.binary = bytearray()

    def add(self, numbers: Stored, *, bounds: bool = False, target: int = 34962) -> int:
        """Add an array of shape (n, width) and return its accessor; vertex elements are padded to 4 bytes."""
        size = numbers.dtype.itemsize * numbers.shape[1]
        stride = size if target == 34963 else -(-size // 4) * 4
        octets = np.zeros((len(numbers), stride), np.uint8)
        octets[:, :size] = np.ascontiguousarray(numbers).view(np.uint8)
        self.binary += bytes(-len(self.binary) % 4)
        view = {"buffer": 0, "byteOffset": len(self.binary), "byteLength": octets.size}
        self.views.append(view | ({"byteStride": stride} if stride != size else {}) | {"target": target})
        self.binary += octets.tobytes()
        accessor: dict[str, Any] = {
            "bufferView": len(self.views) - 1,
            "componentType": _COMPONENT_TYPE[numbers.dtype],
            "count": len(numbers),
            "type": {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}[numbers.shape[1]],
        }
        if numbers.dtype.kind == "u" and target == 34962:
            accessor["normalized"] = True
        if bounds:
            accessor |= {"min": numbers.min(axis=0).tolist(), "max": numbers.max(axis=0).tolist()}
        self.accessors.append(accessor)
        return len(self.accessors) - 1

    def add_faces(self, faces: NDArray[np.integer[Any]], vertices: int) -> int:
        """Add triangles, shape (F, 3), as narrow as the number of vertices allows, and return their accessor."""
        narrow = vertices <= _MOST_FOR_U16
        return self.add(faces.reshape(-1, 1).astype("<u2" if narrow else "<u4"), target=34963)

    def add_bytes(self, content: bytes) -> int:
        """Add the bytes of a file, such as an image, and return their view."""
        self.binary += bytes(-len(self.binary) % 4)
        self.views.append({"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(content)})
        self.binary += content
        return len(self.views) - 1


def single_precision(exact: NDArray[np.float64], stem: str, notices: list[str]) -> Stored:
    """Return positions as glTF stores them; a notice is added if that rounds them.

    Raises
    ------
    InputError
        If they exceed float32.
    """
    with np.errstate(over="ignore"):
        positions = exact.astype("<f4")
    if not np.isfinite(positions).all():
        raise InputError(
            stem, "positions are too large for glTF, which stores float32", "scale the mesh down"
        )
    if np.any(positions != exact):
        notices.append("Positions are rounded to single precision.")
    return positions
