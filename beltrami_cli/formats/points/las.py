"""LAS and LAZ files, read by laspy, and compressed by lazrs.

References
----------
.. [1] ASPRS, "LAS specification", version 1.4. The points of LAZ are the same, compressed.
"""

from __future__ import annotations

import io
import struct
from typing import Any

import numpy as np

from beltrami_cli.arrays import Array
from beltrami_cli.formats.files.archives import most_unpacked
from beltrami_cli.formats.points.scan import ScanContents, colour_fields, joined, require_room

# Bytes in the header of LAS: its size, the place of the points, the number of records; the format of points; the places
# of waveforms and of extended records, whose number follows.
_AT_SIZES, _AT_POINT_FORMAT, _AT_WAVEFORMS, _AT_RECORDS = 94, 104, 227, 235
_LAZ = b"\x80"  # the bit of it that LAZ sets
# Owners of the records that describe how LAZ is packed, and that index it; a file with an index starts with its record.
_LASZIP, _COPC = b"laszip encoded", b"copc"
_LASZIP_NUMBER = 22204
_BEFORE_LENGTH = 20  # bytes of a record: two reserved ones, its owner, and its number
_DESCRIPTION = 32  # bytes behind the length
_AT_OWNER = 377  # byte of LAS 1.4: the owner of the first record


def is_laz(data: bytes) -> bool:
    return data[_AT_POINT_FORMAT : _AT_POINT_FORMAT + 1] >= _LAZ


def has_index(data: bytes) -> bool:
    """Whether a file is LAZ with an index (COPC)."""
    return is_laz(data) and data.startswith(_COPC, _AT_OWNER)


class Las:
    """LAS and LAZ: points are records of the specification; all other bytes are kept, so that nothing is lost."""

    def __init__(self, data: bytes) -> None:
        import laspy

        with laspy.open(io.BytesIO(data)) as reader:
            self._header = header = reader.header
            room = most_unpacked(len(data)) if is_laz(data) else len(data) - header.offset_to_point_data
            require_room(header.point_count, header.point_format.size, room)
            # Not as `LasData`, which has no place for fields with the names of its members, such as "header".
            self._points = reader.read_points(-1).array
        self._fields = {name: self._points[name] for name in self._points.dtype.names}
        self._colour_fields = colour_fields(self._fields, ("red", "green", "blue"), "intensity")
        self._envelope = _Envelope(data, header, self._points.nbytes)

    def contents(self) -> ScanContents:
        head, tail = self._envelope.packed(b"")
        for at in self._envelope.address_fields:  # compressed points may differ in length
            head[at : at + 8] = bytes(8)
        stored = np.column_stack([self._fields[axis] for axis in "XYZ"])
        used = {"X", "Y", "Z", *self._colour_fields}
        return ScanContents(
            positions=stored * self._header.scales + self._header.offsets,
            colours=joined(self._fields, self._colour_fields),
            fields={name: each for name, each in self._fields.items() if name not in used},
            rest={"header": np.frombuffer(head + tail, np.uint8)},
        )

    def written(self, new: Array | None, form: str) -> bytes:
        if new is not None:
            for name, column in zip(self._colour_fields, new.T, strict=True):
                self._fields[name][:] = column
        made, points = io.BytesIO(), np.frombuffer(self._points, np.uint8)
        if form == "laz":
            import lazrs

            known = self._header.point_format
            packing = lazrs.LazVlr.new_for_compression(known.id, known.num_extra_bytes)
            head, tail = self._envelope.packed(packing.record_data())
            made.write(head)
            packer = lazrs.ParLasZipCompressor(made, packing)
            packer.compress_many(points)
            packer.done()
        else:
            head, tail = self._envelope.packed(b"")
            made.write(head)
            made.write(points.data)
        end = made.seek(0, io.SEEK_END)
        made.write(tail)
        for at, address in self._envelope.addresses(head, end).items():
            made.seek(at)
            made.write(struct.pack("<Q", address))
        return made.getvalue()


class _Envelope:
    """The bytes of a file before and behind its points."""

    def __init__(self, data: bytes, header: Any, size: int) -> None:
        """Find them around points of so many bytes, unless they are compressed."""
        self._data, self._header = data, header
        # Fields of the header with the addresses of data behind the points: waveforms and extended records.
        self.address_fields = (_AT_WAVEFORMS, _AT_RECORDS)[: max(0, header.version.minor - 2)]
        start = header.offset_to_point_data
        self._end = start + size
        if is_laz(data):
            behind = (int.from_bytes(data[at : at + 8], "little") for at in self.address_fields)
            self._end = min((place for place in behind if place > start), default=len(data))

    def packed(self, packing: bytes) -> tuple[bytearray, bytes]:
        """Return both, with the record that describes how LAZ packs the points (b"": they are not packed)."""
        data, header = self._data, self._header
        size, start, count = struct.unpack_from("<HII", data, _AT_SIZES)
        records, gap = _records(data[size:start], count, 2)
        kept = [record for record in records if not record.startswith((_LASZIP, _COPC), 2)]
        if packing:
            kept.append(struct.pack("<2x16sHH32s", _LASZIP, _LASZIP_NUMBER, len(packing), b"") + packing)
        head = bytearray(b"".join([data[:size], *kept, gap]))
        form = header.point_format.id | (_LAZ[0] if packing else 0)
        struct.pack_into("<IIB", head, _AT_SIZES + 2, len(head), len(kept), form)
        tail = data[self._end :]
        if header.number_of_evlrs:
            first = header.start_of_first_evlr - self._end
            records, rest = _records(tail[first:], header.number_of_evlrs, 8)
            kept = [record for record in records if not record.startswith(_COPC, 2)]
            tail = b"".join([tail[:first], *kept, rest])
            struct.pack_into("<I", head, _AT_RECORDS + 8, len(kept))
        return head, tail

    def addresses(self, head: bytearray, end: int) -> dict[int, int]:
        """Return the addresses in a header, by their places in it, where points end at `end` instead."""
        found = {at: struct.unpack_from("<Q", head, at)[0] for at in self.address_fields}
        return {at: place + end - self._end if place >= self._end else place for at, place in found.items()}


def _records(data: bytes, count: int, width: int) -> tuple[list[bytes], bytes]:
    """Return `count` records of LAS, whose lengths are numbers of `width` bytes, and the data behind them."""
    records, at = list[bytes](), 0
    for _ in range(count):
        length = at + _BEFORE_LENGTH
        end = length + width + _DESCRIPTION + int.from_bytes(data[length : length + width], "little")
        records.append(data[at:end])
        at = end
    return records, data[at:]
