"""OBJ files: vertex and face lines, colours of vertices and polypaint; a line for each fault; only colours change."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beltrami_cli.errors import InputError
from beltrami_cli.formats.obj.document import ObjDocument
from formats.gltf_files import patched

THREE = b"v 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 1 0 0 0 1\n"


def opened(data):
    return ObjDocument(data.encode() if isinstance(data, str) else data, "some.obj", None)


@pytest.mark.parametrize(
    "face",
    ["f 1 2 3", "f 1/1 2/1 3/1", "f 1//1 2//9 3//1", "f 1/4/1 2/5/1 3/6/1", "f -3 -2 -1", "\t f\t1  2\t3 # x",
     "f 1 \\\n2 3", "f 1 \\\r\n 2 3\r", "f 001 2 3"],
)  # fmt: skip
def test_every_shape_of_a_corner(face):
    for mark in (b"", b"\xef\xbb\xbf"):
        assert opened(mark + THREE + face.encode()).coloured_vertices().faces.tolist() == [[0, 1, 2]]


def test_negative_indices_count_back_from_the_vertices_before_the_face():
    data = THREE + b"f -3 -2 -1\n" + THREE + b"f -3 -2 -1\nf 1 5 6\n"
    assert opened(data).coloured_vertices().faces.tolist() == [[0, 1, 2], [3, 4, 5], [0, 4, 5]]


def test_polygons_are_kept_for_conversion_and_cut_for_the_surface():
    document = opened(THREE + b"v 1 1 0 1 1 1\nf 1 2 4 3\nf 1 2 3\nl 1 2\np 1\n")
    assert document.coloured_vertices().faces.shape == (3, 3)
    assert document.contents().offsets.tolist() == [0, 4, 7]
    assert document.contents().left_out == ("lines and points",)


@pytest.mark.parametrize(
    ("lines", "alpha"),
    [
        (["1 2 3 .1 .2 .3", "4 5 6 .4 .5 .6"], None),
        (["1 2 3 .1 .2 .3 .5", "4 5 6 .4 .5 .6 1"], [0.5, 1]),
        (["1 2 3 1 .1 .2 .3", "4 5 6 1 .4 .5 .6"], None),
        (["1 2 3 1 .1 .2 .3 .5", "4 5 6 2 .4 .5 .6 1"], [0.5, 1]),
    ],
)
def test_weights_and_alpha_are_distinguished_from_colours(lines, alpha):
    contents = opened("".join(f"v {line}\n" for line in lines).encode()).contents()
    assert contents.positions.tolist() == [[1, 2, 3], [4, 5, 6]]
    np.testing.assert_array_equal(contents.colours, np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]], np.float32))
    assert (None if contents.alpha is None else contents.alpha.tolist()) == alpha


def test_seven_numbers_with_red_and_opacity_full_are_colours():
    assert (
        opened(b"v 0 0 0 1 .2 .3 1\n").coloured_vertices().colours.tolist()
        == np.float32([[1, 0.2, 0.3]]).tolist()
    )


def test_uncoloured_vertices_and_their_faces_take_no_part():
    document = opened(b"v 9 9 9\n" + THREE + b"f 1 2 3\nf 2 3 4\nf 4 1\n")
    assert document.coloured_vertices().faces.tolist() == [[0, 1, 2]]
    assert document.coloured_vertices().positions[0].tolist() == [0, 0, 0]
    assert "1 of 4 vertices have no colour" in document.notices[0]
    assert patched(document, np.full((3, 3), 0.5)).startswith(
        b"v 9 9 9\nv 0 0 0 0.500000 0.500000 0.500000\n"
    )


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "there are no vertices"),
        (b"\x00\xff junk", "there are no vertices"),
        (b"v 0 0 0\nv 1 1 1\n", "no vertex colours on its 'v' lines; export"),
        (b"mtllib a.mtl\nv 0 0 0\n", "only materials"),
        (b"\nv 1 2\n", "line 2: a vertex has 3 to 8 numbers, not 2"),
        (b"#\r\n#\r\nv 1 2 3 4 5 6 7 8 9\r\n", "line 3: a vertex has 3 to 8 numbers, not 9"),
        (THREE + b"v 1 x2 3 1 1 1\n", "line 4: 'x2' is not a number"),
        (THREE + b"v 1 2 3 1 nan 1\n", "line 4: 'nan' is not a finite number"),
        (THREE + b"v 1 2 3 1 inf 1\n", "line 4: 'inf' is not a finite number"),
        (THREE + b"\nf 1 2 4\n", "line 5: '4' refers to no vertex; there are 3"),
        (THREE + b"f 1 2 0/1\n", "line 4: '0/1' refers to no vertex"),
        (THREE + b"f 1 2 -4\n", "line 4: '-4' refers to no vertex"),
        (b"v 0 0 0 1 0 0\nf -1 -1 -2\n" + THREE, "line 2: '-2' refers to no vertex"),
        (THREE + b"f 1 2 three\n", "line 4: 'three' is not a vertex index"),
        (THREE + b"f 1 2 3.5\n", "line 4: '3.5' is not a vertex index"),
        (THREE + b"f 1 2 " + b"9" * 40, "is not a vertex index"),
        (THREE + b"v 0 0 0 300 0 0\n", "neither 1 nor 255"),
    ],
)
def test_the_message_names_the_cause_and_the_line(data, message):
    with pytest.raises(InputError) as caught:
        opened(data).coloured_vertices()
    assert message in str(caught.value)


LINES = st.sampled_from([
    "", "# v 9 9 9 9 9 9", "vn 0 0 1", "vt 0.5 0.5", "usemtl red", "s off", "g a b", "f 1 1 1", "f -1/2/3 1//1 1/1",
    "\tf 1 1 -1 1 # why", "l 1 1", "#", "p 1", "o v", "mtllib none.mtl", "vp 1 2",
])  # fmt: skip


@st.composite
def files(draw):
    """Pieces of a file, every other one a colour token, and the tokens by vertex."""
    full = draw(st.sampled_from([1, 255]))
    newline = draw(st.sampled_from(["\n", "\r\n"]))
    blank = draw(st.sampled_from([" ", "\t", "  ", " \\" + newline]))
    tail = draw(st.sampled_from(["", " 1.0"]))
    pieces, tokens, text = [], [], ""
    for number in range(draw(st.integers(1, 6))):
        colour = [draw(st.integers(0, 255)) for _ in range(3)]
        if number == 0:
            colour[0] = 255  # so that the scale shows
        row = [str(c) if full == 255 else f"{c / 255:.6f}" for c in colour]
        text += draw(st.sampled_from(["v", " v", "\tv"])) + "".join(
            f"{blank}{draw(st.integers(-9, 9))}.25" for _ in range(3)
        )
        for token in row:
            pieces += [text + blank, token]
            text = ""
        text = tail + draw(st.sampled_from(["", " ", " # note 1"])) + newline
        for line in draw(st.lists(LINES, max_size=3)):
            text += line + newline
        tokens.append(row)
    return [*pieces, draw(st.sampled_from([text, text.rstrip()]))], tokens


@pytest.mark.slow
@settings(max_examples=150, deadline=None)
@given(files(), st.data())
def test_only_changed_tokens_change(file, data):
    pieces, tokens = file
    source = "".join(pieces).encode()
    document = ObjDocument(source, "random.obj", None)
    before = document.coloured_vertices().colours
    assert patched(document, before.copy()) == patched(document, None) == source
    whole = "." not in tokens[0][0]
    stored = np.array(tokens, float) / (255 if whole else 1)
    np.testing.assert_array_equal(before, stored.astype(np.float32))
    new = before.copy()
    for _ in range(data.draw(st.integers(0, 4))):
        place = data.draw(st.integers(0, len(new) - 1)), data.draw(st.integers(0, 2))
        new[place] = data.draw(st.integers(0, 1000)) / 1000
    after = patched(document, new)
    changed = (new != before).ravel()
    style = r"\d+" if whole else r"\d\.\d{6}"
    pattern = [re.escape(piece) for piece in pieces]
    for entry in np.flatnonzero(changed):
        pattern[2 * entry + 1] = style
    assert re.fullmatch("".join(pattern).encode(), after)
    again = ObjDocument(after, "again.obj", None)
    notices = again.coloured_vertices().notices
    if any("0..255" in notice for notice in notices) == whole:  # otherwise the brightest vertex is gone
        expected = np.rint(new.astype(float) * 255) / 255 if whole else np.round(new.astype(float), 6)
        np.testing.assert_array_equal(again.coloured_vertices().colours, expected.astype(np.float32))


SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


@pytest.mark.parametrize(("style", "newline"), [("{:02x}", "\n"), ("{:02X}", "\r\n")])
def test_polypaint_keeps_masks_and_every_byte_that_is_no_changed_colour(style, newline):
    levels = np.random.default_rng(1).integers(0, 256, (140, 4), np.uint8)
    new = levels.copy()
    new[[0, 63, 64, 139], 1:] ^= 0x81

    def text(levels):
        entries = ["".join(map(style.format, row)) for row in levels.tolist()]
        blocks = [f"#MRGB {''.join(entries[first : first + 64])}" for first in range(0, 140, 64)]
        return newline.join([*(f"v 0 0 {i}" for i in range(140)), *blocks, "f 1 2 3", ""]).encode()

    document = opened(text(levels))
    np.testing.assert_array_equal(np.rint(document.coloured_vertices().colours * 255), levels[:, 1:])
    assert patched(document, document.coloured_vertices().colours) == text(levels)
    assert patched(document, new[:, 1:] / 255).lower() == text(new).lower()


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ("#MRGB ffffffff\n", "there are 1 colours in its #MRGB lines, but 4 vertices"),
        ("#MRGB " + "ffffffff" * 3 + "fffffff\n", "line 5: its #MRGB colours"),
        ("#MRGB " + "ffffffff" * 3 + "fffffffg\n", "line 5: its #MRGB colours"),
        ("#MRGB \n", "0 colours"),
    ],
)
def test_damaged_polypaint_is_refused(lines, message):
    with pytest.raises(InputError, match=re.escape(message)):
        opened(SQUARE + lines).coloured_vertices()


def test_colours_of_vertices_go_before_polypaint_which_stays_and_is_mentioned():
    source = "v 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 1 0 0 0 1\n#MRGB ff000000ff000000ff000000\nf 1 2 3\n"
    document = opened(source)
    written = patched(document, document.coloured_vertices().colours * 0.5)
    assert b"#MRGB ff000000ff000000ff000000\n" in written
    assert any("#MRGB" in notice for notice in document.notices)
