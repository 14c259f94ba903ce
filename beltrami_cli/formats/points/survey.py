"""Point clouds of scanners: LAS and LAZ by laspy, E57 by pye57, PCD by pypcd4, in a process of their own.

The process returns the points as an archive of arrays: positions, colours or intensities, and whatever else the file
holds. Written back are the colours or intensities alone.

References
----------
.. [1] ASPRS, "LAS specification", version 1.4. The points of LAZ are the same, compressed.
.. [2] ASTM E2807, "Standard specification for 3D imaging data exchange": pages of 1024 bytes end with a checksum of 4.
.. [3] Point Cloud Library, "The PCD file format": `rgb` is a float or an integer of 4 bytes, blue in the lowest one.
"""

from __future__ import annotations

import io
import re
import struct
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from beltrami_cli.arrays import Array
from beltrami_cli.formats.access import most_unpacked
from beltrami_cli.formats.archives import NpzArchive
from beltrami_cli.formats.changes import Changes, Naming, Written
from beltrami_cli.formats.foreign_library import ForeignLibrary, serve_files
from beltrami_cli.formats.points.archive import NpzPointsDocument
from beltrami_cli.formats.tokens import NewNumbers, find_tokens, renumbered

_SECONDS_PER_MEBIBYTE = 5  # LAZ: a million points of 3 MiB take a second
_REMEDY = "convert it to PLY, for example with PDAL or CloudCompare"
_LIBRARY = ForeignLibrary("beltrami_cli.formats.points.survey", "scans", _SECONDS_PER_MEBIBYTE, _REMEDY)
_PAGE, _CHECKSUM = 1024, 4  # bytes, see [2]_
_AT_XML = 24  # bytes: where the place and the length of the description stand in the header of E57
# Bytes in the header of LAS: its size, the place of the points, the number of records; the format of points; the places
# of waveforms and of extended records, whose number follows.
_AT_SIZES, _AT_POINT_FORMAT, _AT_WAVEFORMS, _AT_RECORDS = 94, 104, 227, 235
_LAZ = b"\x80"  # the bit of it that LAZ sets
# Owners of the records that describe how LAZ is packed, and that index it; a file with an index starts with its record.
_LASZIP, _COPC = b"laszip encoded", b"copc"
_AT_OWNER = 377  # byte of LAS 1.4: the owner of the first record
_LITERALS = 32  # bytes that one run of LZF holds at most
Columns = dict[str, Array]


class SurveyDocument(NpzPointsDocument):
    """A file that its library reads and writes; its points are taken as arrays, like an NPZ archive."""

    def _open(self, folder: Path | None) -> None:
        self._archive = NpzArchive(self._ask(None, {}), self.name)

    @property
    def format(self) -> str:  # type: ignore[override]
        if self.data.startswith(b"LASF"):
            return "laz" if _is_laz(self.data) else "las"
        return "e57" if self.data.startswith(b"ASTM") else "pcd"

    @property
    def forms(self) -> tuple[str, ...]:  # type: ignore[override]
        return ("las", "laz") if self.data.startswith(b"LASF") else (self.format,)

    def _patched(self, new: Changes, naming: Naming) -> Written:
        stored, form = self._recoloured(new.colours), new.form or self.format
        if stored is None and form == self.format:
            return Written([self.data])
        is_indexed = _is_laz(self.data) and self.data.startswith(_COPC, _AT_OWNER)
        notices = ("The index of COPC is left out: the file becomes plain LAS or LAZ.",) if is_indexed else ()
        return Written([self._ask(form, {} if stored is None else {"new": stored})], notices=notices)

    def _ask(self, form: str | None, arrays: Columns) -> bytes:
        """Return the file in a form with new colours, or, for None, the archive of its arrays."""
        question = form, {"data": np.frombuffer(self.data, np.uint8), **arrays}
        return _LIBRARY.ask(question, self.name, len(self.data), self.access.memory)[1]["made"].tobytes()


def _is_laz(data: bytes) -> bool:
    return data[_AT_POINT_FORMAT : _AT_POINT_FORMAT + 1] >= _LAZ


def _answer(form: str | None, arrays: Columns) -> tuple[None, Columns]:
    data = arrays["data"].tobytes()
    cloud: _Las | _Pcd | _E57 = next((each for mark, each in _READERS if data.startswith(mark)), _Pcd)(data)
    if form is not None:
        made = cloud.written(arrays.get("new"), form)
    else:
        buffer = io.BytesIO()
        named: dict[str, Any] = {name.replace("/", " "): each for name, each in cloud.arrays().items()}
        np.savez(buffer, **named)
        made = buffer.getvalue()
    return None, {"made": np.frombuffer(made, np.uint8)}


def _with_colours(columns: Columns, rgb: tuple[str, ...]) -> Columns:
    """Return columns with the colours as one array; there are none where all are black, as LAS files may have it."""
    if not columns.keys() >= {*rgb} or not any(columns[name].any() for name in rgb):
        return columns
    colours = np.column_stack([columns[name] for name in rgb])
    return {"colours": colours} | {name: each for name, each in columns.items() if name not in rgb}


def _replaced(new: Array, rgb: tuple[str, ...]) -> Columns:
    """Return the columns of new colours, shape (points, 3), or of intensities, by name."""
    return dict(zip(rgb if new.shape[1] > 1 else ("intensity",), new.T, strict=True))


def _require_held(count: int, size: int, held: int) -> None:
    """Raise ValueError if points, by number and size in bytes, exceed what a file can hold or unpack to."""
    if count * size > held:
        raise ValueError(f"there is no room for the {count} points that it announces")


class _Las:
    """LAS and LAZ: points are records of the specification; all other bytes are kept, so that nothing is lost."""

    _RGB = ("red", "green", "blue")

    def __init__(self, data: bytes) -> None:
        import laspy

        with laspy.open(io.BytesIO(data)) as reader:
            about = reader.header
            held = most_unpacked(len(data)) if _is_laz(data) else len(data) - about.offset_to_point_data
            _require_held(about.point_count, about.point_format.size, held)
            self._data, self._las = data, reader.read()
        self._points = self._las.points.array
        # Where extended records and waveforms start: places of data behind the points.
        self._places = (_AT_WAVEFORMS, _AT_RECORDS)[: max(0, self._las.header.version.minor - 2)]
        start = self._las.header.offset_to_point_data
        self._end = start + self._points.nbytes
        if _is_laz(data):
            behind = (int.from_bytes(data[at : at + 8], "little") for at in self._places)
            self._end = min((place for place in behind if place > start), default=len(data))

    def arrays(self) -> Columns:
        head, tail = self._frame(b"")
        for at in self._places:  # compressed points may differ in length
            head[at : at + 8] = bytes(8)
        names = [name for name in self._points.dtype.names if name not in "XYZ"]  # which become the positions
        columns = {name: np.ascontiguousarray(self._points[name]) for name in names}
        places = {"positions": np.array(self._las.xyz), "header": np.frombuffer(head + tail, np.uint8)}
        return places | _with_colours(columns, self._RGB)

    def _frame(self, packing: bytes) -> tuple[bytearray, bytes]:
        """Return the bytes before and behind the points, with a record that describes how LAZ packs them."""
        data, about = self._data, self._las.header
        size, start, count = struct.unpack_from("<HII", data, _AT_SIZES)
        records, gap = _records(data[size:start], count, 2)
        kept = [record for record in records if not record.startswith((_LASZIP, _COPC), 2)]
        if packing:
            kept.append(struct.pack("<2x16sHH32s", _LASZIP, 22204, len(packing), b"") + packing)
        head = bytearray(b"".join([data[:size], *kept, gap]))
        form = about.point_format.id | (_LAZ[0] if packing else 0)
        struct.pack_into("<IIB", head, _AT_SIZES + 2, len(head), len(kept), form)
        tail = data[self._end :]
        if about.number_of_evlrs:
            first = about.start_of_first_evlr - self._end
            records, rest = _records(tail[first:], about.number_of_evlrs, 8)
            kept = [record for record in records if not record.startswith(_COPC, 2)]
            tail = b"".join([tail[:first], *kept, rest])
            struct.pack_into("<I", head, _AT_RECORDS + 8, len(kept))
        return head, tail

    def written(self, new: Array | None, form: str) -> bytes:
        for name, column in ({} if new is None else _replaced(new, self._RGB)).items():
            self._points[name] = column
        made, points = io.BytesIO(), np.frombuffer(self._points, np.uint8)
        if form == "laz":
            import lazrs

            known = self._las.point_format
            packing = lazrs.LazVlr.new_for_compression(known.id, known.num_extra_bytes)
            head, tail = self._frame(packing.record_data())
            made.write(head)
            packer = lazrs.ParLasZipCompressor(made, packing)
            packer.compress_many(points)
            packer.done()
        else:
            head, tail = self._frame(b"")
            made.write(head)
            made.write(points.data)
        shift = made.seek(0, io.SEEK_END) - self._end
        made.write(tail)
        for at in self._places:
            (place,) = struct.unpack_from("<Q", head, at)
            made.seek(at)
            made.write(struct.pack("<Q", place + shift if place >= self._end else place))
        return made.getvalue()


def _records(data: bytes, count: int, width: int) -> tuple[list[bytes], bytes]:
    """Return so many records of LAS, whose lengths are numbers of a width in bytes, and the data behind them."""
    records, at = list[bytes](), 0
    for _ in range(count):
        end = at + 20 + width + 32 + int.from_bytes(data[at + 20 : at + 20 + width], "little")
        records.append(data[at:end])
        at = end
    return records, data[at:]


class _Pcd:
    """PCD; names of fields are case-insensitive, since PDAL writes capital letters."""

    _RGB = ("r", "g", "b"), ("red", "green", "blue")
    _PADDING = "#$%&~~"  # how pypcd4 starts the random names of fields that are called "_"

    def __init__(self, data: bytes) -> None:
        import pypcd4

        self._data, self._body = data, data.index(b"\n", data.index(b"\nDATA") + 1) + 1
        if data[: self._body].split()[-1] == b"ascii":  # pypcd4 reads numbers that are one space apart
            lines = (b" ".join(line.split()) + b"\n" for line in data[self._body :].splitlines())
            data = data[: self._body] + b"".join(lines)
        cloud = pypcd4.PointCloud.from_fileobj(io.BytesIO(data))
        self._points, self._about = np.atleast_1d(cloud.pc_data), cloud.metadata
        _require_held(self._about.points, 1, self._points.size)
        self._names = self._points.dtype.names or ()
        known = {name.lower(): name for name in self._names}
        self._axes = [known[axis] for axis in "xyz"]
        self._packed = known.get("rgb", known.get("rgba", ""))
        named = (names for names in self._RGB if known.keys() >= {*names})
        self._rgb = tuple(known[name] for name in next(named, ()))

    def arrays(self) -> Columns:
        columns = {name: np.ascontiguousarray(self._points[name]) for name in self._names}
        for number, name in enumerate(self._names):
            if name.startswith(self._PADDING):
                columns[f"padding {number}"] = columns.pop(name)
        columns = {"positions": np.column_stack([columns.pop(axis) for axis in self._axes])} | columns
        if self._packed:
            octets = columns.pop(self._packed).view(np.uint8).reshape(-1, 4)
            columns |= {"colours": octets[:, 2::-1], "opacity": octets[:, 3]}
        columns = _with_colours(columns, self._rgb) if self._rgb else columns
        rows, width = self._about.height, self._about.width
        if rows > 1 and rows * width == len(self._points):
            columns = {name: each.reshape(rows, width, *each.shape[1:]) for name, each in columns.items()}
        return columns | {"header": np.frombuffer(self._data[: self._body], np.uint8)}

    def written(self, new: Array | None, form: str) -> bytes:
        old, points = self._points, self._points.copy()
        if new is not None and self._packed:
            packed = np.ascontiguousarray(points[self._packed])
            packed.view(np.uint8).reshape(-1, 4)[:, 2::-1] = new
            points[self._packed] = packed
        elif new is not None:
            for name, column in _replaced(new, self._rgb).items():
                points[name] = column
        head, body = self._data[: self._body], self._data[self._body :]
        if self._about.data == "binary":
            records: bytes = points.tobytes()
            return head + records + body[len(records) :]
        if self._about.data == "ascii":
            count = old.size * len(self._names)
            starts, ends = (each[:count].reshape(old.size, -1) for each in find_tokens(body))
            changes = [(n, points[name] != old[name], points[name]) for n, name in enumerate(self._names)]
            numbers = [NewNumbers(starts[at, n], ends[at, n], values[at]) for n, at, values in changes]
            return head + b"".join(renumbered(body, numbers))
        return head + _compressed(b"".join(points[name].tobytes() for name in self._names))


def _compressed(data: bytes) -> bytes:
    import lzf

    # Data that compression would make longer becomes runs of literal bytes, each behind its length less 1.
    runs = (data[at : at + _LITERALS] for at in range(0, len(data), _LITERALS))
    packed = lzf.compress(data) or b"".join(bytes([len(run) - 1]) + run for run in runs)
    return struct.pack("<II", len(packed), len(data)) + packed


def _content(blob: Any) -> Array:
    content = np.empty(blob.byteCount(), np.uint8)
    blob.read(content, 0, len(content))
    return content


class _E57:
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

    def arrays(self) -> Columns:
        size = sum(scan.point_count * (len(self._children(scan.points)) + 3) for scan in self._scans)
        _require_held(size, 8, most_unpacked(len(self._data)))  # numbers of 8 bytes, and three of a place
        known = [self._raw(scan.points) for scan in self._scans]
        places = [self._places(*each) for each in zip(self._scans, known, strict=True)]
        found = {"positions": np.concatenate(places), "xml": np.frombuffer(self._xml(), np.uint8)}
        blobs = b"".join(_content(blob).tobytes() for blob in self._blobs(self._file.root))
        found["blobs"] = np.frombuffer(blobs, np.uint8)
        for key, names in (("colours", self._RGB), ("intensity", ("intensity",))):
            if key not in found and all(columns.keys() >= {*names} for columns in known):
                found[key] = np.concatenate([np.column_stack([c.pop(name) for name in names]) for c in known])
        for number, columns in enumerate(known):
            found |= {f"{number} {name}": column for name, column in columns.items()}
        return found

    def _raw(self, node: Any) -> Columns:
        """Read the numbers of points as they are stored, before they are scaled."""
        buffers, columns = self._buffers(self._file.image_file, node)
        reader = node.reader(buffers)
        reader.read()
        reader.close()
        return columns

    def _buffers(self, image: Any, node: Any, columns: Columns | None = None) -> tuple[Any, Columns]:
        from pye57 import libe57

        count, found, buffers = node.childCount(), Columns(), libe57.VectorSourceDestBuffer()
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

    def _places(self, scan: Any, columns: Columns) -> Array:
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
                columns |= _replaced(part, self._RGB)
            buffers, _kept = self._buffers(made, pair["in"], columns)  # which point into these arrays
            writer = pair["out"].writer(buffers)
            writer.write(pair["in"].childCount())
            writer.close()
        made.close()
        return path.read_bytes()


_READERS: list[tuple[bytes, type[_Las | _E57]]] = [(b"LASF", _Las), (b"ASTM", _E57)]

if __name__ == "__main__":
    serve_files(_answer, "LAS, LAZ, E57 and PCD", "laspy, lazrs, pye57 or pypcd4")
