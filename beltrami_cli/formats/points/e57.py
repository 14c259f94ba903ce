"""E57 files, read and written by pye57.

References
----------
.. [1] ASTM E2807, "Standard specification for 3D imaging data exchange": pages of 1024 bytes end with a checksum of 4.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from beltrami_cli.arrays import Array
from beltrami_cli.formats.files.archives import most_unpacked
from beltrami_cli.formats.points.scan import Arrays, ScanContents, joined, require_room

_PAGE, _CHECKSUM = 1024, 4  # bytes, see [1]_
_AT_XML = 24  # bytes: where the place and the length of the description stand in the header


def _content(blob: Any) -> Array:
    content = np.empty(blob.byteCount(), np.uint8)
    blob.read(content, 0, len(content))
    return content


def _common_fields(scans: Sequence[Arrays]) -> tuple[Arrays, dict[tuple[int, str], Array]]:
    """Return the fields that all scans have, joined, and the others by the number of the scan."""
    names = [name for name in scans[0] if all(name in scan for scan in scans)]
    joint = {name: np.concatenate([scan[name] for scan in scans]) for name in names}
    apart = {
        (number, name): scan[name] for number, scan in enumerate(scans) for name in scan if name not in joint
    }
    return joint, apart


class E57:
    """E57: all scans, in their common coordinate system."""

    _RGB = ("colorRed", "colorGreen", "colorBlue")
    _CARTESIAN = ("cartesianX", "cartesianY", "cartesianZ")
    _SPHERICAL = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")

    def __init__(self, data: bytes) -> None:
        import pye57

        self._data, self._folder = data, TemporaryDirectory()
        path = Path(self._folder.name, "in.e57")
        path.write_bytes(data)
        self._file = pye57.E57(str(path))
        self._scans = [self._file.get_header(number) for number in range(self._file.scan_count)]
        if not self._scans:
            raise ValueError("it has no scans")
        names = [{child.elementName() for child in self._children(scan.points)} for scan in self._scans]
        choices = (self._RGB, ("intensity",))
        common = set.intersection(*names)
        self._colour_fields = next((each for each in choices if common >= {*each}), ())

    def contents(self) -> ScanContents:
        size = sum(scan.point_count * (len(self._children(scan.points)) + 3) for scan in self._scans)
        require_room(size, 8, most_unpacked(len(self._data)))  # numbers of 8 bytes, and three of a place
        scans = [self._raw(scan.points) for scan in self._scans]
        places = [self._positions_of(*each) for each in zip(self._scans, scans, strict=True)]
        blobs = b"".join(_content(blob).tobytes() for blob in self._blobs(self._file.root))
        rest = {"xml": np.frombuffer(self._xml(), np.uint8), "blobs": np.frombuffer(blobs, np.uint8)}
        fields, apart = _common_fields(scans)
        rest |= {f"{name} of scan {number}": each for (number, name), each in apart.items()}
        return ScanContents(
            positions=np.concatenate(places),
            colours=joined(fields, self._colour_fields),
            fields={name: each for name, each in fields.items() if name not in self._colour_fields},
            rest=rest,
        )

    def _raw(self, node: Any) -> Arrays:
        """Read the numbers of points as they are stored, before they are scaled."""
        buffers, columns = self._buffers(self._file.image_file, node)
        reader = node.reader(buffers)
        reader.read()
        reader.close()
        return columns

    def _buffers(self, image: Any, node: Any, columns: Arrays | None = None) -> tuple[Any, Arrays]:
        from pye57 import libe57

        count, found, buffers = node.childCount(), Arrays(), libe57.VectorSourceDestBuffer()
        for child in self._children(node):
            name, kind = child.elementName(), "q"  # the only integers of 64 bits that pye57 knows
            if isinstance(child, libe57.FloatNode):
                kind = "f" if child.precision() == libe57.E57_SINGLE else "d"
            found[name] = np.zeros(count, kind)
            if columns is not None:
                found[name][:] = columns[name]
            buffers.append(libe57.SourceDestBuffer(image, name, found[name], count, True, False))
        return buffers, found

    def _blobs(self, node: Any) -> Iterator[Any]:
        """Yield the images and other embedded files."""
        from pye57 import libe57
        from pye57.utils import get_node

        for number in range(node.childCount()):
            child = get_node(node, number)
            if isinstance(child, libe57.BlobNode):
                yield child
            elif isinstance(child, (libe57.StructureNode, libe57.VectorNode)):
                yield from self._blobs(child)

    def _children(self, node: Any) -> list[Any]:
        from pye57 import libe57
        from pye57.utils import get_node

        prototype = libe57.StructureNode(node.prototype())
        return [get_node(prototype, number) for number in range(prototype.childCount())]

    def _positions_of(self, scan: Any, columns: Arrays) -> Array:
        from pye57.utils import convert_spherical_to_cartesian

        columns = dict(columns)
        for child in self._children(scan.points):
            if hasattr(child, "scale"):
                name = child.elementName()
                columns[name] = columns[name] * child.scale() + child.offset()
        is_cartesian = self._CARTESIAN[0] in columns
        names = self._CARTESIAN if is_cartesian else self._SPHERICAL
        places = np.column_stack([columns[name] for name in names]).astype(np.float64)
        places = places if is_cartesian else convert_spherical_to_cartesian(places)
        invalid = columns.get("cartesianInvalidState" if is_cartesian else "sphericalInvalidState")
        if invalid is not None:
            places[invalid != 0] = np.nan
        return self._file.to_global(places, scan.rotation, scan.translation) if scan.has_pose() else places

    def _xml(self) -> bytes:
        """Return the description of everything, without the places of binary sections and the padding."""
        offset, length = struct.unpack_from("<QQ", self._data, _AT_XML)
        pages = np.frombuffer(self._data, np.uint8).reshape(-1, _PAGE)[:, :-_CHECKSUM]
        at = offset // _PAGE * (_PAGE - _CHECKSUM) + offset % _PAGE
        return re.sub(rb' fileOffset="\d+"', b"", pages.tobytes()[at : at + length]).rstrip()

    def written(self, new: Array | None, form: str) -> bytes:
        from pye57 import libe57
        from pye57.utils import copy_node, get_node

        path, image = Path(self._folder.name, "out.e57"), self._file.image_file
        made = libe57.ImageFile(str(path), "w")
        for number in range(image.extensionsCount()):
            made.extensionsAdd(image.extensionsPrefix(number), image.extensionsUri(number))
        vectors: list[Any] = []
        blobs: list[Any] = []
        for number in range(image.root().childCount()):
            child = get_node(image.root(), number)
            copy, own_vectors, own_blobs = copy_node(child, made)
            made.root().set(child.elementName(), copy)
            vectors, blobs = vectors + own_vectors, blobs + own_blobs
        for pair in blobs:
            content = _content(pair["in"])
            pair["out"].write(content, 0, len(content))
        ends = np.cumsum([scan.point_count for scan in self._scans])
        parts = [] if new is None else np.split(new, ends[:-1])
        fresh = {scan.points.pathName(): part for scan, part in zip(self._scans, parts, strict=False)}
        for pair in vectors:
            columns = self._raw(pair["in"])
            if (part := fresh.get(pair["in"].pathName())) is not None:
                columns |= zip(self._colour_fields, part.T, strict=True)
            buffers, _kept = self._buffers(made, pair["in"], columns)  # which point into these arrays
            writer = pair["out"].writer(buffers)
            writer.write(pair["in"].childCount())
            writer.close()
        made.close()
        return path.read_bytes()
