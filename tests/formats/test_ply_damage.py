"""Whatever is wrong with a PLY file, the answer is one clear InputError."""

from __future__ import annotations

import numpy as np
import pytest

from beltrami_cli.errors import InputError
from beltrami_cli.formats.document import Naming
from beltrami_cli.formats.ply.document import PlyDocument
from formats.ply_files import ENCODINGS, build, coloured


def read(data):
    document = PlyDocument(data, "bad.ply")
    painted = document.painted()
    document.contents()
    document.facts()
    assert np.isfinite(painted.positions).all()
    assert np.isfinite(painted.colours).all()
    assert painted.faces.size == 0 or 0 <= painted.faces.min() <= painted.faces.max() < len(painted.positions)
    document.patch(painted.colours * np.float32(0.5), Naming("out"))


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_every_truncation_is_an_error(encoding):
    data = build(coloured(4, [[0, 1, 2], [0, 1, 2, 3]]), encoding).data
    # The last blanks of a text may go, and a shortened last token looks like a shorter number.
    whole = len(data.rstrip()) if encoding == "ascii" else len(data)
    for length in range(whole):
        with pytest.raises(InputError):
            read(data[:length])
    read(data)


def change(old, new, encoding="ascii"):
    data = build(coloured(), encoding).data
    assert old in data
    return data.replace(old, new, 1)


def of_colours(kind, value, encoding="ascii", row=slice(None)):
    """Return a file in which all colours, or one vertex's, have a value."""
    tables = coloured(colour=kind, value=0.5 if "f" in kind or "d" in kind else 10)
    for vertex in tables[0].rows[row]:
        vertex[3:] = [value] * 3
    return build(tables, encoding).data


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (of_colours("char", 10), "no more than 127"),
        (of_colours("float", 1000.0), "neither 1 nor 255"),
        (of_colours("double", -1e130, "binary_little_endian"), "go from -1e+130 to -1e+130"),
        (of_colours("float", np.inf, "binary_big_endian", slice(2, 3)), "colour of vertex 2 is not finite"),
        (b"solid cube", "not a PLY file"),
        (b"ply\nformat ascii 1.0\n", "no line 'end_header'"),
        (change(b"format ascii 1.0\n", b""), "no line 'format'"),
        (
            change(b"ascii", b"binary_middle_endian"),
            "line 2 of the header: 'format binary_middle_endian 1.0'",
        ),
        (change(b"vertex 4", b"vertex -4"), "line 3 of the header: '-4' is no count"),
        (change(b"vertex 4", b"vertex 0"), "there are no vertices"),
        (change(b"vertex 4", b"vertex 123456789012345678"), "data end before the 123456789012345678 rows"),
        (
            change(b"face 2", b"face 999999999999", "binary_little_endian"),
            "data end before the 999999999999 rows",
        ),
        (change(b"float y", b"half y"), "line 5 of the header: 'half' is no PLY type"),
        (change(b"float y", b"float x"), "two properties 'x'"),
        (change(b"element face", b"element vertex"), "announced twice"),
        (change(b"float y", b"float why"), "vertices have no property y"),
        (change(b"uchar red", b"char red"), "red, green, blue are of several types"),
        (change(b"uchar red", b"uchar rot"), "no vertex colours among the vertex properties x, y, z, rot"),
        (change(b"1 1 0 10", b"1 nan 0 10"), "the position of vertex 1 is not finite"),
        (change(b"1 1 0 10", b"1 1 0 256"), "property 'red' of element 'vertex': 256 in row 1 is no uint8"),
        (change(b"1 1 0 10", b"1 1 0 9.5"), "9.5 in row 1 is no uint8"),
        (change(b"1 1 0 10", b"1 one 0 10"), "data end before"),
        (change(b"3 0 2 3", b"3 0 2 4"), "face 1 refers to vertex 4, but there are 4 vertices"),
        (change(b"3 0 2 3", b"3 0 -2 3"), "face 1 refers to vertex -2"),
        (change(b"3 0 2 3", b"-3 0 2 3"), "row 1 of element 'face' has a list of -3 items"),
        (change(b"3 0 2 3", b"3.5 0 2 3"), "has a list of 3.5 items"),
        (change(b"vertex_indices", b"corners"), "element 'face' has no list vertex_indices"),
        (change(b"uchar int vertex", b"float int vertex"), "count of a list cannot be a float"),
        (change(b"uchar int vertex", b"uchar float vertex"), "not whole numbers"),
    ],
)
def test_the_message_names_the_cause_and_the_place(data, message):
    with pytest.raises(InputError) as caught:
        read(data)
    assert message in str(caught.value)
    assert str(caught.value).startswith("bad.ply: ")
