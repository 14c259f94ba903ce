"""Lines of points: what the columns are, and that nothing but colours changes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltrami_cli.errors import InputError, UnpaintedError
from beltrami_cli.formats.document import Naming
from beltrami_cli.formats.points.text_document import TextPointsDocument, write_pts, write_xyz
from formats.points_files import patched

RGB = ("red", "green", "blue")
PLAIN = b"0 0 0 10 20 30\n1 0 0.5 40 50 60\n0 1 -2e-1 255 0 128\n"


def opened(text, name="cloud.xyz"):
    return TextPointsDocument(text, name)


@pytest.mark.parametrize(
    ("text", "channels", "colours"),
    [
        (b"1 2 3 0 51 255", RGB, [0, 0.2, 1]),
        (b"1 2 3 0 0.2 1", RGB, [0, 0.2, 1]),
        (b"1 2 3 0 13107 65535", RGB, [0, 0.2, 1]),
        (b"1 2 3 0.25", ("intensity",), [0.25]),
        (b"1 2 3 51", ("intensity",), [0.2]),
        (b"1 2 3 -1024 \n 1 2 3 2048", ("intensity",), [-0.5]),
        (b"1 2 3 977 0 51 255", RGB, [0, 0.2, 1]),
        (b"1 2 3 0 51 255 0 0.6 -0.8", RGB, [0, 0.2, 1]),
        (b"1 2 3 0 51 255 0 0 1", RGB, [0, 0.2, 1]),
        (b"1 2 3 0 0 1 0 51 255", RGB, [0, 0.2, 1]),
        (b"1 2 3 1 0 0 0 0.6 0.8", RGB, [1, 0, 0]),
        (b"1 2 3 0 0.6 -0.8 0 51 255", RGB, [0, 0.2, 1]),
        (b"1 2 3 977 0 51 255 0 0.6 -0.8", RGB, [0, 0.2, 1]),
        (b"# x y z b g r\n1 2 3 255 51 0", RGB, [0, 0.2, 1]),
        (b"//X;Y;Z;R;G;B;Intensity\n1;2;3;0;51;255;9", RGB, [0, 0.2, 1]),
        (b"x y z i nx ny nz\n1 2 3 0.25 0 0 1", ("intensity",), [0.25]),
        (b"i r g b z y x\n7 0 51 255 3 2 1", RGB, [0, 0.2, 1]),
        (b"\xef\xbb\xbf1,2,3,0,51,255\r\n", RGB, [0, 0.2, 1]),
        (b"1\t2\t3\t0\t51\t255\r1 2 3 4 5 6\r", RGB, [0, 0.2, 1]),
        (b"# scanned on Monday\n\n 1 2 3 1 0 0 # red\n1 2 3 0 1 0\n", RGB, [1, 0, 0]),
    ],
)
def test_columns_are_recognised_by_their_names_or_by_how_many_there_are(text, channels, colours):
    painted = opened(text).painted()
    assert painted.channels == channels
    assert painted.positions[0].tolist() == [1, 2, 3]
    assert np.allclose(painted.colours[0], colours, atol=1e-6)
    assert painted.faces.shape == (0, 3)


def test_what_is_not_obvious_is_said():
    assert opened(PLAIN).painted()
    document = opened(b"1 2 3 977 0 51 255")
    document.painted()
    assert document.notices == ["Its 7 columns are taken for x y z intensity red green blue."]
    document = opened(b"1 2 3 -1024.5")
    document.painted()
    assert "1024.5" in document.notices[-1]


@pytest.mark.parametrize(
    ("text", "error", "said"),
    [
        (b"1 2 3", UnpaintedError, "no colours"),
        (b"1 2 3 0 0.6 -0.8\n1 2 3 1 0 0", InputError, "normals"),
        (
            b"1 2 3 4 5 6 7 8",
            InputError,
            "columns 4 to 6 or 5 to 7 or 6 to 8; .*--columns.*x,y,z,r,g,b,scalar",
        ),
        (b"1 2 3 -4 5 -6 7 8", InputError, "8 numbers each, and it is not clear which are colours"),
        (b"1 2 3 0 0 1 1 0 0", InputError, "columns 4 to 6 or .* or 7 to 9"),
        (b"1 2 3 4 5 6\n1 2 3 4 5\n", InputError, "line 2: 5 numbers, but the first point has 6"),
        (b"\n1 2 3 4 5 6\n1 2 3 four 5 6\n", InputError, "line 3: 'four' is no number"),
        (b"C 0 0 0\n", InputError, "line 1: 'C' is no number"),
        (b"3\n1 2 3 4 5 6\n1 2 3 4 5 6\n", InputError, "line 1: 3 points are announced, but 2 follow"),
        (b"1 2 3 4 5 6\n1\n1 2 3 4 5 6\n", InputError, "line 2: one number only"),
        (b"0\n", InputError, "no points"),
        (b"# nothing\n", InputError, "no points"),
        (b"1 2 3 4 5 nan\n", InputError, "the colour of point 0 is not finite"),
        (b"nan 2 3 4 5 6\n", InputError, "none of its points has a place"),
        (b"1 2 3 4 5 6000.5\n", InputError, "full scale"),
        (b"x y z r g\n1 2 3 4 5\n", UnpaintedError, "x y z r g have no colours"),
        (b"a b r g b\n1 2 3 4 5\n", InputError, "no x, y and z"),
        (b"x y z r g b\n1 2 3 4\n", InputError, "names 6 columns, but there are 4"),
        (b"\xff\xfe1\x00 \x002\x00\n1 2 3 4", InputError, "it is no plain text; export"),
        (b"\0" * 40, InputError, "it is no plain text; export"),
        (b"[Points]\n1 2 3 4 5 6\n\xc0\0\n", InputError, "it is no plain text; export"),
    ],
)
def test_what_cannot_be_read_is_refused_in_one_line(text, error, said):
    with pytest.raises(error, match=said) as caught:
        opened(text).painted()
    assert "\n" not in str(caught.value)
    assert "\0" not in str(caught.value)


def test_counts_may_head_several_scans():
    document = opened(b"2\n0 0 0 1 2 3 4\n1 0 0 5 6 7 8\n1\n0 1 0 1 2 3 4\n", "scan.pts")
    assert len(document.painted().positions) == 3
    assert document.facts()["announced"] == [2, 1]
    assert document.facts()["columns"] == ["x", "y", "z", "intensity", "red", "green", "blue"]


def test_points_without_a_place_take_no_part_and_keep_their_bytes():
    text = b"0 0 0 10 20 30\nnan nan nan 0 0 0\n1 0 inf 9 9 9\n1 0 0 40 50 60\n"
    document = opened(text)
    assert len(document.painted().positions) == 2
    assert "2 of 4 points have no place" in document.notices[0]
    result = patched(document, np.array([[1, 0, 0], [0, 0, 1]]))
    assert result == b"0 0 0 255 0 0\nnan nan nan 0 0 0\n1 0 inf 9 9 9\n1 0 0 0 0 255\n"


def test_colours_that_stay_keep_their_bytes_to_the_last():
    document = opened(b"  1 2.50 3 010 +20 030 # a\r\n\r\n// b\r\n4,5,6;\t40 50\t60")
    same = document.painted().colours
    assert patched(document, same) == b"  1 2.50 3 010 +20 030 # a\r\n\r\n// b\r\n4,5,6;\t40 50\t60"
    assert b"".join(document.patch(None, Naming("out")).main) == patched(document, same)
    # A change that is lost in rounding is none.
    assert patched(document, same + np.float32(1e-4)) == patched(document, same)
    other = same.copy()
    other[0, 1] = 21 / 255
    assert patched(document, other) == b"  1 2.50 3 010 21 030 # a\r\n\r\n// b\r\n4,5,6;\t40 50\t60"


@pytest.mark.parametrize(
    ("text", "new", "expected"),
    [
        (b"0 0 0 0.5 0.25 0.75", [0.5, 0.3, 0.75], b"0 0 0 0.5 0.300000 0.75"),
        (b"0 0 0 0.500000000 0 1", [0.5, 0.1, 1], b"0 0 0 0.500000000 0.100000001 1"),
        (b"0 0 0 5e-1 0 1", [0.5, 0.125, 1], b"0 0 0 5e-1 0.125 1"),
        (b"0 0 0 127.5 0 255", [0.5, 0.125, 1], b"0 0 0 127.5 31.8750 255"),
        (b"0 0 0 -1024\n0 0 1 2048", [[-0.25], [1]], b"0 0 0 -512\n0 0 1 2048"),
        (b"0 0 0 -1024\n0 0 1 2048", [[-1e-5], [1]], b"0 0 0 0\n0 0 1 2048"),
        (b"0 0 0 -9 1 2 3\n0 0 0 9 4 5 6", [[1, 0, 0], [0, 1, 0]], b"0 0 0 -9 255 0 0\n0 0 0 9 0 255 0"),
        (b"x y z b g r\n0 0 0 1 2 3", [1, 2 / 255, 0], b"x y z b g r\n0 0 0 0 2 255"),
        (b"0 0 0 200 0 7", [1.5, -1, 0.5], b"0 0 0 255 0 128"),
    ],
)
def test_new_colours_are_spelled_as_the_old_ones(text, new, expected):
    assert patched(opened(text), np.atleast_2d(new)) == expected


@pytest.mark.slow
@given(
    st.lists(st.tuples(*[st.integers(0, 255)] * 6), min_size=1, max_size=20),
    st.sampled_from([b" ", b"\t", b", ", b";"]),
    st.sampled_from([b"\n", b"\r\n", b"\r"]),
    st.booleans(),
)
def test_new_whole_colours_are_read_back_and_the_rest_is_as_it_was(rows, blank, line_end, counted):
    lines = [blank.join(b"%d" % value for value in row[:3] + row[3:]) for row in rows]
    head = [b"%d" % len(rows)] if counted else []
    document = opened(line_end.join([*head, *lines, b""]))
    new = np.array([row[3:] for row in rows[::-1]], np.float32) / 255
    lines = [
        blank.join(b"%d" % value for value in row[:3] + other[3:])
        for row, other in zip(rows, rows[::-1], strict=True)
    ]
    # Where no colour is above 1 they count as of 0 to 1.
    if max(max(row[3:]) for row in rows) > 1:
        assert patched(document, new) == line_end.join([*head, *lines, b""])


def test_other_columns_are_attributes():
    document = opened(b"1 2 3 -7 1 2 3 0 0 1\n4 5 6 8 1 2 4 0 0 1\n")
    assert document.attributes() == ("normal", "intensity")
    assert document.attribute("Intensity").tolist() == [[-7], [8]]
    assert document.attribute("normal").tolist() == [[0, 0, 1], [0, 0, 1]]
    with pytest.raises(InputError, match="no depth"):
        document.attribute("depth")


def test_the_fingerprint_of_two_files_differs_in_colours_alone():
    document = opened(PLAIN, "scan.pts")
    other = opened(patched(document, 1 - document.painted().colours), "scan.pts")
    assert other.fingerprint().parts == document.fingerprint().parts
    assert np.allclose(
        other.fingerprint().colours["point colours"], 1 - document.painted().colours, atol=1e-6
    )
    moved = opened(PLAIN.replace(b"0.5", b"0.6"), "scan.pts")
    assert moved.fingerprint().parts != document.fingerprint().parts


@pytest.mark.parametrize("writer", [write_xyz, write_pts])
def test_what_is_written_is_read_back(writer):
    contents = opened(b"# x y z r g b nx ny nz\n0.1 2e7 3 1 2 3 0 0 1\n4 5 6 7 8 9 0 1 0\n").contents()
    written = writer(contents, "out")
    again = opened(b"".join(written.main))
    assert np.array_equal(again.painted().positions, contents.positions)
    assert np.allclose(again.painted().colours, contents.colours, atol=1e-6)
    assert np.array_equal(again.attribute("normal"), contents.normals)
