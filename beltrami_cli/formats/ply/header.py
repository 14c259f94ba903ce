"""The header of a PLY file: its elements and their properties.

References
----------
.. [1] G. Turk, "The PLY polygon file format", Stanford University, 1994.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from beltrami_cli.errors import InputError

TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float32": "f4", "float64": "f8",
}  # fmt: skip
"""PLY's type names, old and new, with NumPy's codes."""

POSITION, NORMAL = ("x", "y", "z"), ("nx", "ny", "nz")  # scalars of vertices
_ENCODINGS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_MAX_DECLARATIONS = 4096  # elements, and properties of one; real files have a hundred at most
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
        return {prop.name: prop.type for prop in self.properties if not prop.count}

    @property
    def lists(self) -> list[Property]:
        return [prop for prop in self.properties if prop.count]


@dataclass(frozen=True)
class Header:
    """The header of a PLY file."""

    encoding: str  # "ascii", "binary_little_endian" or "binary_big_endian"
    elements: tuple[Element, ...]  # in file order
    comments: int  # how many comment and obj_info lines there are
    end: int  # offset of the first byte behind the header

    @property
    def order(self) -> str:
        """NumPy's sign for the byte order, empty for text."""
        return _ENCODINGS[self.encoding]

    @property
    def vertex(self) -> Element | None:
        return next((element for element in self.elements if element.name == "vertex"), None)


def read_header(data: bytes, name: str) -> Header:
    """Read the header of a PLY file; InputError names the line that is damaged."""
    if data[:3] != b"ply" or data[3:4] not in (b"\n", b"\r", b" ", b"\t"):
        raise InputError(name, "not a PLY file, which would start with the line 'ply'")
    elements: list[Element] = []
    encoding, comments, at, number, words = "", 0, 0, 0, list[str]()
    line_end = b"\r" if data[3:4] == b"\r" and data[4:5] != b"\n" else b"\n"
    while words != ["end_header"]:
        stop = data.find(line_end, at)
        if stop < 0:
            raise InputError(name, "the header has no line 'end_header'", "the file may be cut off")
        line, at, number = data[at:stop].decode("latin-1"), stop + 1, number + 1
        words = line.split()
        try:
            match words:
                case ["ply"] if number == 1:
                    pass
                case ["comment" | "obj_info", *_]:
                    comments += 1
                case ["format", kind, "1.0"] if kind in _ENCODINGS and not encoding:
                    encoding = kind
                case ["element", label, count]:
                    _add_element(elements, label, count)
                case ["property", "list", count, kind, label]:
                    _add_property(elements, label, kind, count)
                case ["property", kind, label]:
                    _add_property(elements, label, kind)
                case other if other != ["end_header"]:
                    raise ValueError(f"'{line.strip()[:60]}' is not understood")
        except ValueError as error:
            shown = str(error).encode("ascii", "backslashreplace").decode()
            raise InputError(name, f"line {number} of the header: {shown}") from None
    if not encoding:
        raise InputError(name, "the header has no line 'format'")
    return Header(encoding, tuple(elements), comments, at)


def _add_element(elements: list[Element], name: str, count: str) -> None:
    if not (count.isascii() and count.isdigit() and len(count) <= _DIGITS):
        raise ValueError(f"'{count[:30]}' is not a count of elements")
    if any(element.name == name for element in elements):
        raise ValueError(f"element '{name}' is announced twice")
    if len(elements) >= _MAX_DECLARATIONS:
        raise ValueError(f"there are more than {_MAX_DECLARATIONS} elements")
    elements.append(Element(name, int(count)))


def _add_property(elements: list[Element], name: str, kind: str, count: str = "") -> None:
    if not elements:
        raise ValueError(f"property '{name}' belongs to no element")
    for word in (kind, count):
        if word and word not in TYPES:
            raise ValueError(f"'{word[:30]}' is not a PLY type")
    if count and TYPES[count][0] == "f":
        raise ValueError(f"the count of a list cannot be a {count}")
    element = elements[-1]
    if any(prop.name == name for prop in element.properties):
        raise ValueError(f"element '{element.name}' has two properties '{name}'")
    if len(element.properties) >= _MAX_DECLARATIONS:
        raise ValueError(f"element '{element.name}' has more than {_MAX_DECLARATIONS} properties")
    new = Property(name, TYPES[kind], TYPES[count] if count else "")
    elements[-1] = replace(element, properties=(*element.properties, new))
