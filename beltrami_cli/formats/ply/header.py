"""The header of a PLY file.

References
----------
.. [1] G. Turk, "The PLY polygon file format", Stanford University, 1994.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from beltrami_cli.errors import InputError

TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float32": "f4", "float64": "f8",
}  # fmt: skip
"""PLY's type names, old and new, with NumPy's codes."""

_ENCODINGS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_MOST = 4096  # elements, and properties of one; real files have a hundred at most
_DIGITS = 18  # of a count, more than any file can hold and no more than an int64 can


@dataclass(frozen=True)
class Property:
    """A scalar (`count` is empty) or a list of them, with NumPy codes of the types."""

    name: str
    type: str
    count: str = ""


@dataclass(frozen=True)
class Element:
    """A table of the file: `count` rows of these properties."""

    name: str
    count: int
    properties: tuple[Property, ...] = ()

    @property
    def scalars(self) -> dict[str, str]:
        return {known.name: known.type for known in self.properties if not known.count}

    @property
    def lists(self) -> list[Property]:
        return [known for known in self.properties if known.count]


@dataclass(frozen=True)
class Header:
    """What a PLY file announces."""

    encoding: str  # "ascii", "binary_little_endian" or "binary_big_endian"
    elements: tuple[Element, ...]  # in file order
    comments: int  # how many comment and obj_info lines there are
    end: int  # offset of the first byte behind the header

    @property
    def order(self) -> str:
        """NumPy's sign for the byte order, empty for text."""
        return _ENCODINGS[self.encoding]

    def element(self, name: str) -> Element | None:
        return next((element for element in self.elements if element.name == name), None)


def read_header(data: bytes, name: str) -> Header:
    """Read the header of a PLY file; InputError names the line that is damaged."""
    if data[:3] != b"ply" or data[3:4] not in (b"\n", b"\r", b" ", b"\t"):
        raise InputError(name, "not a PLY file, which would start with the line 'ply'")
    lines, at = _Lines(name), 0
    line_end = b"\r" if data[3:4] == b"\r" and data[4:5] != b"\n" else b"\n"
    while not lines.finished:
        stop = data.find(line_end, at)
        if stop < 0:
            raise InputError(name, "the header has no line 'end_header'", "the file may be cut off")
        lines.take(data[at:stop].decode("latin-1"))
        at = stop + 1
    if not lines.encoding:
        raise InputError(name, "the header has no line 'format'")
    return Header(lines.encoding, tuple(lines.elements), lines.comments, at)


@dataclass
class _Lines:
    """What the lines up to now have said."""

    name: str
    number: int = 0
    encoding: str = ""
    elements: list[Element] = field(default_factory=list)
    comments: int = 0
    finished: bool = False

    def take(self, line: str) -> None:
        self.number += 1
        match line.split():
            case ["ply"] if self.number == 1:
                pass
            case ["comment" | "obj_info", *_]:
                self.comments += 1
            case ["format", encoding, "1.0"] if encoding in _ENCODINGS and not self.encoding:
                self.encoding = encoding
            case ["element", name, count]:
                self._add_element(name, count)
            case ["property", "list", count, kind, name]:
                self._add_property(name, kind, count)
            case ["property", kind, name]:
                self._add_property(name, kind)
            case ["end_header"]:
                self.finished = True
            case _:
                raise self._error(f"'{line.strip()[:60]}' is not understood")

    def _add_element(self, name: str, count: str) -> None:
        if not (count.isascii() and count.isdigit() and len(count) <= _DIGITS):
            raise self._error(f"'{count[:30]}' is no count of elements")
        if any(element.name == name for element in self.elements):
            raise self._error(f"element '{name}' is announced twice")
        if len(self.elements) >= _MOST:
            raise self._error(f"there are more than {_MOST} elements")
        self.elements.append(Element(name, int(count)))

    def _add_property(self, name: str, kind: str, count: str = "") -> None:
        if not self.elements:
            raise self._error(f"property '{name}' belongs to no element")
        for word in (kind, count):
            if word and word not in TYPES:
                raise self._error(f"'{word[:30]}' is no PLY type")
        if count and TYPES[count][0] == "f":
            raise self._error(f"the count of a list cannot be a {count}")
        element = self.elements[-1]
        if any(known.name == name for known in element.properties):
            raise self._error(f"element '{element.name}' has two properties '{name}'")
        if len(element.properties) >= _MOST:
            raise self._error(f"element '{element.name}' has more than {_MOST} properties")
        new = Property(name, TYPES[kind], TYPES[count] if count else "")
        self.elements[-1] = replace(element, properties=(*element.properties, new))

    def _error(self, cause: str) -> InputError:
        shown = cause.encode("ascii", "backslashreplace").decode()
        return InputError(self.name, f"line {self.number} of the header: {shown}")
