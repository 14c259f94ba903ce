"""A small PLY builder of the tests' own: struct and string formatting, one value after the other."""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass, field

CODES = {
    "char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I", "float": "f", "double": "d",
    "int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i", "uint32": "I", "float32": "f", "float64": "d",
}  # fmt: skip
ENCODINGS = ("ascii", "binary_little_endian", "binary_big_endian")
Value = float | list[float]


@dataclass
class Table:
    """An element: properties as ("x", "float") or ("vertex_indices", "uchar int"), and its rows."""

    name: str
    properties: list[tuple[str, str]]
    rows: list[list[Value]] = field(default_factory=list)


@dataclass
class Built:
    """A file, and where its scalars stand: spans[(element, row, property)] = (start, end)."""

    data: bytes
    spans: dict[tuple[str, int, str], tuple[int, int]]

    def is_same_but_at(self, changed, data, longest=24):
        """Return whether a file differs in nothing but some scalars, which have at most so many characters as text."""
        spans = sorted(self.spans[scalar] for scalar in changed)
        ends, starts = [0, *(end for _, end in spans)], [*(start for start, _ in spans), len(self.data)]
        kept = [self.data[a:b] for a, b in zip(ends, starts, strict=True)]
        if b"format ascii" in self.data:
            return re.fullmatch((b"[0-9.e-]{1,%d}" % longest).join(map(re.escape, kept)), data) is not None
        return [data[a:b] for a, b in zip(ends, starts, strict=True)] == kept and len(data) == len(self.data)


def build(tables, encoding="ascii", newline="\n", comments=None):
    lines = ["ply", f"format {encoding} 1.0", *(f"comment {text}" for text in comments or [])]
    for table in tables:
        lines.append(f"element {table.name} {len(table.rows)}")
        for name, kind in table.properties:
            lines.append(f"property {'list ' if ' ' in kind else ''}{kind} {name}")
    data = bytearray(newline.join([*lines, "end_header", ""]).encode())
    spans = {}
    for table in tables:
        for number, row in enumerate(table.rows):
            for (name, kind), value in zip(table.properties, row, strict=True):
                start = len(data)
                data += _text(kind, value) if encoding == "ascii" else _binary(kind, value, encoding)
                if " " not in kind:
                    spans[table.name, number, name] = (start, len(data) - (encoding == "ascii"))
            if encoding == "ascii":
                data += newline.encode()
    return Built(bytes(data), spans)


def _binary(kind, value, encoding):
    order = "<" if "little" in encoding else ">"
    if isinstance(value, list):
        count, item = kind.split()
        return struct.pack(f"{order}{CODES[count]}{len(value)}{CODES[item]}", len(value), *value)
    return struct.pack(order + CODES[kind], value)


def _text(kind, value):
    if isinstance(value, list):
        return f"{len(value)} {''.join(f'{item} ' for item in value)}".encode()
    return f"{value} ".encode()


def coloured(vertices=4, faces=None, colour="uchar", value=10):
    """A plain coloured mesh, vertex i at (i, i², 0)."""
    names = [*((axis, "float") for axis in "xyz"), *((name, colour) for name in ("red", "green", "blue"))]
    rows = [[i, i * i, 0, value, value, value] for i in range(vertices)]
    polygons = [[face] for face in (faces if faces is not None else [[0, 1, 2], [0, 2, 3]])]
    return [Table("vertex", names, rows), Table("face", [("vertex_indices", "uchar int")], polygons)]
