"""PCD files, read by pypcd4.

References
----------
.. [1] Point Cloud Library, "The PCD file format": `rgb` is a float or an integer of 4 bytes, blue in the lowest one.
"""

from __future__ import annotations

import io
import struct

import numpy as np

from beltrami_cli.arrays import Array
from beltrami_cli.formats.files.edits import NewNumbers, renumbered
from beltrami_cli.formats.files.tokens import find_tokens
from beltrami_cli.formats.points.scan import ScanContents, colour_fields, joined, require_room

_LITERALS = 32  # bytes that one run of LZF holds at most


class Pcd:
    """PCD; names of fields are case-insensitive, since PDAL writes capital letters."""

    _RGB = ("r", "g", "b"), ("red", "green", "blue")
    _NORMAL = ("normal_x", "normal_y", "normal_z")
    _PADDING = "#$%&~~"  # how pypcd4 starts the random names of fields that are called "_"

    def __init__(self, data: bytes) -> None:
        import pypcd4

        self._data, self._body = data, data.index(b"\n", data.index(b"\nDATA") + 1) + 1
        if data[: self._body].split()[-1] == b"ascii":  # pypcd4 reads numbers that are one space apart
            lines = (b" ".join(line.split()) + b"\n" for line in data[self._body :].splitlines())
            data = data[: self._body] + b"".join(lines)
        cloud = pypcd4.PointCloud.from_fileobj(io.BytesIO(data))
        self._points, self._metadata = np.atleast_1d(cloud.pc_data), cloud.metadata
        require_room(self._metadata.points, 1, self._points.size)
        self._names = self._points.dtype.names or ()
        # A name in lower case goes before another spelling of it.
        known = {name.lower(): name for name in self._names} | {name: name for name in self._names}
        self._axes = [known[axis] for axis in "xyz"]
        self._normal = [known[name] for name in self._NORMAL] if known.keys() >= {*self._NORMAL} else []
        fields = {name: self._points[known[name]] for name in known}
        # Of another size than in [1]_ nothing is known.
        packed = [known[name] for name in ("rgb", "rgba") if name in fields and fields[name].itemsize == 4]
        self._packed = packed[0] if packed else ""
        rgb = next((names for names in self._RGB if known.keys() >= {*names}), self._RGB[0])
        chosen = () if self._packed else colour_fields(fields, rgb, "intensity")
        self._colour_fields = [known[name] for name in chosen]

    def contents(self) -> ScanContents:
        points = {name: np.ascontiguousarray(self._points[name]) for name in self._names}
        padding = {name for name in self._names if name.startswith(self._PADDING)}
        rest = {
            f"padding {number}": points[name] for number, name in enumerate(self._names) if name in padding
        }
        rest["header"] = np.frombuffer(self._data[: self._body], np.uint8)
        used = {*self._axes, *self._normal, *self._colour_fields, self._packed, *padding}
        fields = {name: each for name, each in points.items() if name not in used}
        colours = joined(points, self._colour_fields)
        if self._packed:
            octets = points[self._packed].view(np.uint8).reshape(-1, 4)
            colours = octets[:, 2::-1]
            # A field, so that it can be a guide, unless the file has one of that name.
            (rest if "opacity" in fields else fields)["opacity"] = octets[:, 3]
        rows, width = self._metadata.height, self._metadata.width
        return ScanContents(
            positions=np.column_stack([points[axis] for axis in self._axes]),
            normals=joined(points, self._normal),
            colours=colours,
            fields=fields,
            rest=rest,
            shape=(rows, width) if rows > 1 and rows * width == len(self._points) else (),
        )

    def written(self, new: Array | None, form: str) -> bytes:
        points = self._points if new is None else self._recoloured(new)
        head, body = self._data[: self._body], self._data[self._body :]
        if self._metadata.data == "binary":
            records: bytes = points.tobytes()
            return head + records + body[len(records) :]
        if self._metadata.data == "ascii":
            return head + b"".join(renumbered(body, self._new_numbers(points, body)))
        return head + _compressed(b"".join(points[name].tobytes() for name in self._names))

    def _recoloured(self, new: Array) -> Array:
        points = self._points.copy()
        if self._packed:
            packed = np.ascontiguousarray(points[self._packed])
            packed.view(np.uint8).reshape(-1, 4)[:, 2::-1] = new
            self._require_writable(packed)
            points[self._packed] = packed
            return points
        for name, column in zip(self._colour_fields, new.T, strict=True):
            points[name] = column
        return points

    def _require_writable(self, packed: Array) -> None:
        """Raise ValueError if text cannot hold new colours: opaque ones with red above 127 are not finite as floats."""
        old = np.ascontiguousarray(self._points[self._packed])
        is_new = packed.view(np.uint32) != old.view(np.uint32)
        if self._metadata.data == "ascii" and not np.isfinite(packed[is_new]).all():
            raise ValueError(f"text cannot hold colours that are packed as the floats of {self._packed}")

    def _new_numbers(self, points: Array, body: bytes) -> list[NewNumbers]:
        """Return where lines of numbers differ from new points."""
        count = points.size * len(self._names)
        starts, ends = (each[:count].reshape(points.size, -1) for each in find_tokens(body))
        numbers = []
        for n, name in enumerate(self._names):
            old, new = self._points[name], points[name]
            at = (new != old) & ~(np.isnan(new) & np.isnan(old))
            numbers.append(NewNumbers(starts[at, n], ends[at, n], new[at]))
        return numbers


def _compressed(data: bytes) -> bytes:
    import lzf

    # Data that compression would make longer becomes runs of literal bytes, each behind its length less 1.
    runs = (data[at : at + _LITERALS] for at in range(0, len(data), _LITERALS))
    packed = lzf.compress(data) or b"".join(bytes([len(run) - 1]) + run for run in runs)
    return struct.pack("<II", len(packed), len(data)) + packed
