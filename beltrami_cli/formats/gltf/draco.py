"""Geometry of primitives that Draco has compressed, decoded into accessors that no JSON names.

References
----------
.. [1] KHR_draco_mesh_compression, in the registry of glTF extensions.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Hashable

    from numpy.typing import NDArray

    from beltrami_cli.formats.gltf.accessors import Accessors
    from beltrami_cli.formats.gltf.layouts import Accessor
    from beltrami_cli.formats.gltf.tree import Entry

EXTENSION = "KHR_draco_mesh_compression"

_MAGIC = b"DRACO"
_MESH = b"\1"  # the kind of geometry, after the magic and the version


def packed_in(primitive: Entry) -> Entry | None:
    """Return the extension of a primitive; None if it is not compressed."""
    extensions = primitive.entry("extensions")
    return extensions.entry(EXTENSION) if EXTENSION in extensions else None


class DracoMeshes:
    """All compressed meshes of a file; each is decoded when it is first asked for.

    Parameters
    ----------
    accessors : Accessors
        Where decoded attributes are added.
    """

    def __init__(self, accessors: Accessors) -> None:
        self._accessors = accessors
        self._meshes: dict[int, Any] = {}
        self._added: dict[Hashable, int] = {}

    def attribute(self, packed: Entry, name: str, index: int) -> int:
        """Return the accessor of an attribute's decoded numbers, in the type that its own accessor says.

        Parameters
        ----------
        packed : Entry
            The extension.
        name : str
            The attribute, which is among those of the extension.
        index : int
            Its accessor, which describes what is compressed.

        Raises
        ------
        InputError
            If the data is damaged or not what the accessor says, or the package that decodes it is not installed.
        """
        view, number = self._view(packed), packed.entry("attributes").integer(name)
        accessor = self._accessors[index]
        key = view, number, accessor.component.str, accessor.shape, accessor.normalised
        if key not in self._added:
            numbers = _fitted(self._numbers(packed, view, number, name), accessor)
            self._added[key] = self._accessors.add(accessor, numbers)
        return self._added[key]

    def indices(self, packed: Entry, index: int) -> int:
        """Return the accessor of the decoded triangles, three indices each; `index` is the primitive's own.

        Raises
        ------
        InputError
            As `attribute`.
        """
        view = self._view(packed)
        key = view, "faces"
        if key not in self._added:
            numbers = np.asarray(self._mesh(packed, view).faces).astype("<u4").reshape(-1, 1)
            if not len(numbers):
                raise packed.fault("bufferView", "holds no triangles")
            accessor = replace(self._accessors[index], shape="SCALAR", width=1, normalised=False)
            self._added[key] = self._accessors.add(accessor, numbers)
        return self._added[key]

    def _view(self, packed: Entry) -> int:
        return packed.integer("bufferView", below=len(self._accessors.views))

    def _numbers(self, packed: Entry, view: int, number: int, name: str) -> NDArray[Any]:
        for found in self._mesh(packed, view).attributes:
            if found["unique_id"] == number:
                return np.asarray(found["data"])
        raise packed.entry("attributes").fault(
            name, f"is {number}, but there is no such attribute in the data"
        )

    def _mesh(self, packed: Entry, view: int) -> Any:
        if view not in self._meshes:
            try:
                import DracoPy
            except ImportError:
                cause = f"to decode {EXTENSION}, the package DracoPy is needed"
                remedy = "install it with: pip install 'beltrami-cli[draco]'"
                raise packed.fault("", cause, remedy) from None
            place = self._accessors.views[view]
            octets = self._accessors.buffers.stored(place.buffer)
            data = bytes(octets[place.offset : place.offset + place.length])
            # Points could claim to be any number, and would be given the memory for it.
            if data[:5] == _MAGIC and data[7:8] != _MESH:
                raise packed.fault("bufferView", "holds points, not triangles")
            try:
                self._meshes[view] = DracoPy.decode(data)
            except (DracoPy.FileTypeException, TypeError, ValueError) as error:
                raise packed.fault("bufferView", f"holds damaged data ({error})") from None
        return self._meshes[view]


def _fitted(numbers: NDArray[Any], accessor: Accessor) -> NDArray[Any]:
    """Return decoded numbers, shape (n, width), in the type of their accessor."""
    if numbers.shape != (accessor.count, accessor.width):
        found = f"{numbers.shape[0]} elements of {numbers.shape[-1]} numbers"
        raise accessor.entry.fault(
            "count", f"is {accessor.count} of {accessor.width}, but {found} were decoded"
        )
    fitted = numbers.astype(accessor.component)
    if (numbers.dtype.kind == "f") != (fitted.dtype.kind == "f") or (
        numbers.dtype.kind != "f" and not np.array_equal(numbers, fitted)
    ):
        raise accessor.entry.fault(
            "componentType", f"does not fit the decoded numbers of {numbers.dtype.name}"
        )
    return fitted
