"""Primitives that Draco [1]_ has compressed: their accessors, decoded when needed.

References
----------
.. [1] KHR_draco_mesh_compression, in the registry of glTF extensions.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import replace
from typing import Any

import numpy as np

from beltrami_cli.arrays import Array
from beltrami_cli.errors import install_hint
from beltrami_cli.formats.gltf.accessors import Accessor, Accessors, Layout, Stored
from beltrami_cli.formats.gltf.entries import Entry

DRACO = "KHR_draco_mesh_compression"  # extension of a primitive
_DRACO_MAGIC = b"DRACO"
_DRACO_MESH = b"\1"  # the kind of geometry, after the magic and the version


class Draco:
    """The primitives of one file that Draco has compressed, each decoded once."""

    def __init__(self, accessors: Accessors) -> None:
        self._accessors = accessors
        self._meshes: dict[int, Any] = {}  # decoded, by view
        self._decoded: dict[Hashable, Accessor] = {}

    def attribute(self, packed: Entry, name: str, described: Accessor) -> Accessor:
        view, mesh = self._mesh(packed)
        number = packed.entry("attributes").integer(name)
        key = view, number, described.component.str, described.shape, described.normalised
        if key not in self._decoded:
            data = (each["data"] for each in mesh.attributes if each["unique_id"] == number)
            numbers = next(data, None)
            if numbers is None:
                cause = f"is {number}, but there is no such attribute in the data"
                raise packed.entry("attributes").fault(name, cause)
            self._add(key, described, _fitted(np.asarray(numbers), described))
        return self._decoded[key]

    def indices(self, packed: Entry, described: Accessor) -> Accessor:
        """Return the accessor of the triangles; `described` is that of the indices in the JSON."""
        view, mesh = self._mesh(packed)
        if (view, "faces") not in self._decoded:
            numbers = np.asarray(mesh.faces).astype("<u4").reshape(-1, 1)
            if not len(numbers):
                raise packed.fault("bufferView", "holds no triangles")
            scalar = replace(described, shape="SCALAR", width=1, normalised=False)
            self._add((view, "faces"), scalar, numbers)
        return self._decoded[view, "faces"]

    def _mesh(self, packed: Entry) -> tuple[int, Any]:
        """Return the index of a compressed view, and its mesh, which is decoded once."""
        buffers, views = self._accessors.buffers, self._accessors.views
        view = packed.integer("bufferView", below=len(views))
        if view not in self._meshes:
            self._meshes[view] = _decoded_mesh(packed, buffers.viewed(views[view]))
        return view, self._meshes[view]

    def _add(self, key: Hashable, described: Accessor, numbers: Stored) -> None:
        """Add decoded numbers, shape (n, width), with the description of an accessor."""
        octets = numbers.tobytes()
        buffer = self._accessors.buffers.add(lambda: octets)
        size, count = numbers.dtype.itemsize * numbers.shape[1], len(numbers)
        layout = Layout(buffer, 0, size, size, count)
        bare = replace(described, view=None, sparse=None, is_decoded=True)
        self._decoded[key] = replace(bare, component=numbers.dtype, count=count, layout=layout)


def _fitted(numbers: Array, accessor: Accessor) -> Stored:
    """Return decoded numbers, shape (n, width), in the type of their accessor."""
    if numbers.shape != (accessor.count, accessor.width):
        decoded = f"{numbers.shape[0]} elements of {numbers.shape[-1]} numbers"
        cause = f"is {accessor.count} of {accessor.width}, but {decoded} were decoded"
        raise accessor.entry.fault("count", cause)
    fitted = numbers.astype(accessor.component)
    if (numbers.dtype.kind == "f") != (fitted.dtype.kind == "f") or (
        numbers.dtype.kind != "f" and not np.array_equal(numbers, fitted)
    ):
        cause = f"does not fit the decoded numbers of {numbers.dtype.name}"
        raise accessor.entry.fault("componentType", cause)
    return fitted


def _decoded_mesh(packed: Entry, data: bytes) -> Any:
    try:
        import DracoPy
    except ImportError:
        cause = f"to decode {DRACO}, the package DracoPy is needed"
        raise packed.fault("", cause, install_hint("beltrami-cli[draco]")) from None
    # Points could claim to be any number, and would be given the memory for it.
    if data[:5] == _DRACO_MAGIC and data[7:8] != _DRACO_MESH:
        raise packed.fault("bufferView", "holds points, not triangles")
    try:
        return DracoPy.decode(data)
    except (DracoPy.FileTypeException, TypeError, ValueError) as error:
        raise packed.fault("bufferView", f"holds damaged data ({error})") from None
