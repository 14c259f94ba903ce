"""Meshes written as OBJ or PLY are read back: all values the same, colours in OBJ to six decimals."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beltrami_cli.formats.obj.document import ObjDocument
from beltrami_cli.formats.ply.document import PlyDocument
from beltrami_cli.formats.registry import write_contents
from beltrami_cli.surface.records import MeshContents, linear_to_srgb
from formats.gltf_files import joined

DOCUMENTS = {"obj": ObjDocument, "ply": PlyDocument}
CLOSE = {"obj": 5.1e-7, "ply": 0}  # how far colours of full scale 1 may be off
FORMS = pytest.mark.parametrize("form", DOCUMENTS)


def mesh(sizes=(3,), stored="uint8", channels=3, **changes):
    random = np.random.default_rng(5)
    top = 65535 if stored == "uint16" else 255
    contents = MeshContents(
        positions=random.normal(size=(300, 3)),
        corners=random.integers(0, 300, sum(sizes)).astype(np.int32),
        offsets=np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64),
        colours=(random.integers(0, top + 1, (300, channels)) / top).astype(np.float32),
        encoding="srgb",
        stored=stored,
    )
    return dataclasses.replace(contents, **changes)


def back(form, contents):
    return DOCUMENTS[form](joined(write_contents(contents, form, "out")), f"out.{form}").contents()


def check(form, contents, dtype):
    """Positions of a type, polygons and colours are read back the same."""
    contents = dataclasses.replace(contents, positions=contents.positions.astype(dtype).astype(np.float64))
    found = back(form, contents)
    np.testing.assert_array_equal(found.positions.astype(dtype), contents.positions)
    np.testing.assert_array_equal(found.corners, contents.corners)
    np.testing.assert_array_equal(found.offsets, contents.offsets)
    np.testing.assert_allclose(found.colours, contents.colours, rtol=0, atol=CLOSE[form])
    return found


@FORMS
@settings(max_examples=30, deadline=None)
@given(
    sizes=st.lists(st.sampled_from([3, 3, 4, 7, 300]), max_size=6),
    stored=st.sampled_from(["uint8", "uint16", "float32", "text"]),
    dtype=st.sampled_from([np.float32, np.float64]),
)
def test_round_trip(form, sizes, stored, dtype):
    found = check(form, mesh(sizes, stored), dtype)
    if form == "ply":
        assert found.stored == (stored if stored.startswith("uint") else "float32")
    if stored == "uint16":
        levels = np.rint(mesh(sizes, stored).colours * 65535)
        np.testing.assert_array_equal(np.rint(found.colours * 65535), levels)


@FORMS
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_small_coordinates_and_more_polygons_than_a_block_are_read_back(form, dtype):
    plain = mesh(np.random.default_rng(8).integers(3, 7, 70_000))
    check(form, dataclasses.replace(plain, positions=plain.positions * 1e-7), dtype)


def test_positions_in_ply_are_doubles_only_where_floats_would_lose():
    single = mesh().positions.astype(np.float32).astype(np.float64)
    assert b"property float x" in joined(write_contents(mesh(positions=single), "ply", "out"))
    assert b"property double x" in joined(write_contents(mesh(), "ply", "out"))


def test_ply_keeps_normals_and_alpha():
    normals = np.random.default_rng(6).normal(size=(300, 3)).astype(np.float32)
    alpha = (np.arange(300) % 256 / 255).astype(np.float32)
    found = back("ply", mesh(normals=normals, alpha=alpha))
    np.testing.assert_array_equal(found.normals, normals)
    np.testing.assert_array_equal(found.alpha, alpha)


def test_obj_has_a_normal_for_every_vertex():
    normals = np.random.default_rng(9).normal(size=(300, 3)).astype(np.float32)
    text = joined(write_contents(mesh([3, 5] * 99, normals=normals), "obj", "out")).decode().splitlines()
    found = np.array([line.split()[1:] for line in text if line.startswith("vn ")], np.float32)
    np.testing.assert_array_equal(found, normals)
    corners = [corner.split("//") for line in text if line.startswith("f ") for corner in line.split()[1:]]
    assert corners
    assert all(vertex == normal for vertex, normal in corners)


@FORMS
@pytest.mark.parametrize(
    ("stored", "kept"), [("uint8", "uint16"), ("uint16", "uint16"), ("float32", "float32")]
)
@pytest.mark.parametrize("channels", [1, 3])
def test_linear_colours_become_srgb_in_three_channels_and_8_bit_steps_stay_apart(
    form, stored, kept, channels
):
    contents = mesh(stored=stored, channels=channels, encoding="linear")
    found = back(form, contents)
    assert found.stored == (kept if form == "ply" else "text")
    expected = np.broadcast_to(linear_to_srgb(contents.colours), (300, 3))
    np.testing.assert_allclose(found.colours, expected, atol=0.5001 / 65535 if form == "ply" else 5.1e-7)
    if stored == "uint8":
        assert len(np.unique(found.colours)) == len(np.unique(contents.colours))
    said = write_contents(contents, form, "out").notices
    assert "Linear colours are written as sRGB" in said[0]
    assert any("Grey" in notice for notice in said) == (channels == 1)


@FORMS
def test_what_is_left_out_is_said_in_one_sentence(form):
    contents = mesh(left_out=("materials", "skins"), alpha=np.ones(300, np.float32))
    *others, last = write_contents(contents, form, "out").notices
    assert last == "Not converted: materials; skins."
    assert ["Opacity is dropped" in notice for notice in others] == ([True] if form == "obj" else [])
