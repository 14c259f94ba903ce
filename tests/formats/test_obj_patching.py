"""Patching an OBJ file changes colour tokens and no other byte."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beltrami_cli.formats.document import Naming
from beltrami_cli.formats.obj.document import ObjDocument

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
    before = document.painted().colours
    whole = "." not in tokens[0][0]
    stored = np.array(tokens, float) / (255 if whole else 1)
    np.testing.assert_array_equal(before, stored.astype(np.float32))
    new = before.copy()
    for _ in range(data.draw(st.integers(0, 4))):
        place = data.draw(st.integers(0, len(new) - 1)), data.draw(st.integers(0, 2))
        new[place] = data.draw(st.integers(0, 1000)) / 1000
    patched = b"".join(document.patch(new, Naming("out")).main)
    changed = (new != before).ravel()
    style = r"\d+" if whole else r"\d\.\d{6}"
    pattern = [re.escape(piece) for piece in pieces]
    for entry in np.flatnonzero(changed):
        pattern[2 * entry + 1] = style
    assert re.fullmatch("".join(pattern).encode(), patched)
    again = ObjDocument(patched, "again.obj", None)
    if any("0..255" in notice for notice in again.notices) == whole:  # otherwise the brightest vertex is gone
        expected = np.rint(new.astype(float) * 255) / 255 if whole else np.round(new.astype(float), 6)
        np.testing.assert_array_equal(again.painted().colours, expected.astype(np.float32))


@settings(max_examples=50, deadline=None)
@given(files())
def test_unchanged_colours_give_the_same_bytes(file):
    source = "".join(file[0]).encode()
    document = ObjDocument(source, "random.obj", None)
    assert b"".join(document.patch(document.painted().colours.copy(), Naming("out")).main) == source
    assert document.patch(None, Naming("out")).main == [source]


def test_decimals_follow_the_source_within_what_loses_nothing():
    for token, found in (("1", 6), ("0.5", 6), ("0.50000000", 8), ("0.5000000000000000", 9)):
        document = ObjDocument(f"v 0 0 0 {token} 0 0\n".encode(), "x.obj", None)
        patched = b"".join(document.patch(np.full((1, 3), 0.2, np.float32), Naming("out")).main)
        assert len(patched.split()[-1]) == 2 + found


def test_exponents_are_kept():
    document = ObjDocument(b"v 0 0 0 5e-1 0 1E0\n", "x.obj", None)
    patched = document.patch(np.array([[0.25, 0, 1]], np.float32), Naming("out"))
    assert b"".join(patched.main) == b"v 0 0 0 0.25 0 1E0\n"


def test_whole_numbers_of_0_to_255_stay_whole_and_in_range():
    document = ObjDocument(b"v 0 0 0 200 0 7\n", "x.obj", None)
    patched = document.patch(np.array([[1.5, -1, 0.5]], np.float32), Naming("out"))
    assert b"".join(patched.main) == b"v 0 0 0 255 0 128\n"
    assert "0..255" in document.notices[0]
