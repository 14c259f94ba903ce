"""Patching a PLY file changes colour entries and no other byte, whatever else the file holds."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beltrami_cli.formats.ply.document import PlyDocument
from formats.patching import patched
from formats.ply_files import CODES, ENCODINGS, Table, build, coloured

FAMILIES = (
    ("red", "green", "blue"),
    ("diffuse_red", "diffuse_green", "diffuse_blue"),
    ("r", "g", "b"),
    ("gray",),
    ("grey",),
)
COLOUR_TYPES = ("uchar", "uint8", "ushort", "uint16", "float", "float32", "double", "float64")
FULL = {"B": 255, "H": 65535, "I": 2**32 - 1}


def value(draw, kind):
    if " " in kind:
        return [value(draw, kind.split()[1]) for _ in range(draw(st.integers(0, 4)))]
    code = CODES[kind]
    if code in "fd":
        return draw(st.floats(-100, 100, width=32))
    bits = {"b": 8, "h": 16, "i": 32}.get(code.lower(), 0)
    return draw(
        st.integers(-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
        if code.islower()
        else st.integers(0, 2**bits - 1)
    )


@st.composite
def files(draw):
    """A random file, its colour properties, their type, and the colours with full scale 1."""
    names, kind = draw(st.sampled_from(FAMILIES)), draw(st.sampled_from(COLOUR_TYPES))
    full = FULL.get(CODES[kind], 1)
    extras = st.sampled_from([*CODES, "uchar int", "int float", "ushort double"])
    properties = [
        *((name, draw(st.sampled_from(["float", "double", "int", "uchar"]))) for name in "xyz"),
        *((name, kind) for name in names),
        *((f"extra{i}", known) for i, known in enumerate(draw(st.lists(extras, max_size=3)))),
    ]
    vertex = Table("vertex", draw(st.permutations(properties)))
    colour = st.integers(0, full) if full > 1 else st.floats(0, 1, width=32)
    colours = []
    for _ in range(draw(st.integers(1, 6))):
        given_colours = dict(zip(names, (draw(colour) for _ in names), strict=True))
        vertex.rows.append(
            [given_colours.get(n, value(draw, k) if n not in names else 0) for n, k in vertex.properties]
        )
        colours.append([given_colours[name] / full for name in names])
    index = st.integers(0, len(vertex.rows) - 1)
    count = draw(st.sampled_from(["uchar", "ushort", "int"]))
    lists = (
        draw(st.sampled_from(["vertex_indices", "vertex_index"])),
        f"{count} {draw(st.sampled_from(['uint', 'short', 'int32']))}",
    )
    face = Table("face", draw(st.permutations([lists, ("flags", "uchar"), ("uv", "uchar float")])))
    for _ in range(draw(st.integers(0, 4))):
        face.rows.append(
            [
                draw(st.lists(index, max_size=5)) if n == lists[0] else value(draw, k)
                for n, k in face.properties
            ]
        )
    other = Table("other", [("list", "int uchar"), ("scalar", "short")])
    other.rows = [[value(draw, k) for _, k in other.properties] for _ in range(draw(st.integers(0, 3)))]
    built = build(
        draw(st.permutations([vertex, face, other])),
        draw(st.sampled_from(ENCODINGS)),
        draw(st.sampled_from(["\n", "\r\n"])),
        draw(st.lists(st.sampled_from(["made by hand", "element vertex 7"]), max_size=2)),
    )
    return built, names, kind, colours


@pytest.mark.slow
@settings(max_examples=150, deadline=None)
@given(files(), st.data())
def test_only_changed_colour_entries_change_and_they_are_rounded_once(file, data):
    built, names, kind, colours = file
    document = PlyDocument(built.data + b"trailing bytes", "random.ply")
    assert patched(document, document.painted().colours) == patched(document, None) == document.data
    before, full = document.painted().colours, document.painted().full_scale
    stored = np.array(colours) * FULL.get(CODES[kind], 1)
    np.testing.assert_array_equal(before, (stored / full).astype(np.float32))
    new = before.copy()
    rows = data.draw(
        st.lists(st.tuples(st.integers(0, len(new) - 1), st.integers(0, len(names) - 1)), max_size=5)
    )
    for row, channel in rows:
        new[row, channel] = data.draw(st.floats(0, 1, width=32))
    after = patched(document, new).removesuffix(b"trailing bytes")
    changed = sorted(
        built.spans["vertex", row, names[channel]] for row, channel in np.argwhere(new != before)
    )
    assert same_elsewhere(built.data, after, changed, text=b"format ascii" in built.data)
    again = PlyDocument(after, "again.ply").painted()
    # The new numbers may fit into fewer bits.
    expected = np.rint(new.astype(np.float64) * full) / again.full_scale if full > 1 else new
    np.testing.assert_array_equal(again.colours, np.asarray(expected).astype(np.float32))
    np.testing.assert_array_equal(again.faces, document.painted().faces)


def same_elsewhere(data, patched, spans, *, text):
    starts, ends = [start for start, _ in spans], [end for _, end in spans]
    kept = [data[a:b] for a, b in zip([0, *ends], [*starts, len(data)], strict=True)]
    if text:
        return re.fullmatch(rb"[0-9.e-]+".join(map(re.escape, kept)), patched) is not None
    there = [patched[a:b] for a, b in zip([0, *ends], [*starts, len(data)], strict=True)]
    return there == kept and len(patched) == len(data)


def test_text_keeps_spacing_tokens_and_line_ends():
    data = (
        b"ply\r\nformat ascii 1.0\r\ncomment  two  blanks \r\nobj_info 3\r\nelement vertex 2\r\n"
        b"property float x\r\nproperty float y\r\nproperty float z\r\nproperty uchar blue\r\n"
        b"property uchar green\r\nproperty uchar red\r\nend_header\r\n"
        b"  1.500\t2e0  3   007  8 9 \r\n4 5 6\r\n 1 2 3\r\n\r\n"
    )
    document = PlyDocument(data, "spaced.ply")
    colours = document.painted().colours.copy()
    assert np.rint(colours * 255).tolist() == [[9, 8, 7], [3, 2, 1]]
    colours[0, 1] = 200 / 255
    colours[1, 0] = 1
    assert patched(document, colours) == data.replace(b"007  8 9", b"007  200 9").replace(
        b" 1 2 3", b" 1 2 255"
    )


def test_float_text_round_trips_float32_in_a_plain_style():
    tables = coloured(colour="float", value=0.5)
    document = PlyDocument(build(tables).data, "x.ply")
    colours = np.random.default_rng(0).random((4, 3), np.float32)
    after = patched(document, colours)
    np.testing.assert_array_equal(PlyDocument(after, "y.ply").painted().colours, colours)
    assert max(len(token) for token in after.split(b"end_header")[1].split()) <= 12


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_integers_are_clipped_to_their_range_and_alpha_is_kept(encoding):
    tables = coloured()
    tables[0].properties.insert(3, ("alpha", "uchar"))
    for number, row in enumerate(tables[0].rows):
        row.insert(3, number)
    built = build(tables, encoding)
    document = PlyDocument(built.data, "x.ply")
    again = PlyDocument(patched(document, [[-1, 0.5, 2]] * 4), "y.ply")
    assert np.rint(again.painted().colours * 255).tolist() == [[0, 128, 255]] * 4
    assert np.rint(again.contents().alpha * 255).tolist() == [0, 1, 2, 3]


def test_float_colours_of_0_to_255_keep_their_scale_with_a_notice():
    document = PlyDocument(build(coloured(colour="float", value=51.0), "binary_little_endian").data, "x.ply")
    colours = document.painted().colours
    np.testing.assert_allclose(colours, 0.2)
    assert "0..255" in document.notices[0]
    again = PlyDocument(patched(document, colours * 2), "y.ply")
    np.testing.assert_allclose(again.painted().colours, 0.4)
    assert "0..255" in again.notices[0]
