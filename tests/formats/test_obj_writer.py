"""What is written as OBJ is read back: positions the same, colours to six decimals, polygons whole."""

from __future__ import annotations

import numpy as np
import pytest

from beltrami_cli.formats.obj.document import ObjDocument
from beltrami_cli.formats.obj.writer import write_obj
from beltrami_cli.surface.colour_values import linear_to_srgb
from beltrami_cli.surface.records import MeshContents


def mesh(**changes: object) -> MeshContents:
    random = np.random.default_rng(8)
    sizes = random.integers(3, 7, 70_000)  # more than one block
    fields: dict[str, object] = {
        "positions": random.normal(size=(200, 3)),
        "corners": random.integers(0, 200, sizes.sum()).astype(np.int32),
        "offsets": np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64),
        "colours": (random.integers(0, 256, (200, 3)) / 255).astype(np.float32),
        "encoding": "srgb",
        "stored": "uint8",
    }
    return MeshContents(**{**fields, **changes})  # type: ignore[arg-type]


def back(contents: MeshContents) -> MeshContents:
    return ObjDocument(b"".join(write_obj(contents, "out").main), "out.obj", None).contents()


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_positions_and_polygons_are_read_back_the_same(dtype: type) -> None:
    plain = mesh()
    source = mesh(positions=(plain.positions * 1e-7).astype(dtype).astype(np.float64))
    read = back(source)
    if dtype == np.float32:
        np.testing.assert_array_equal(read.positions.astype(dtype), source.positions)
    else:
        np.testing.assert_array_equal(read.positions, source.positions)
    np.testing.assert_array_equal(read.corners, source.corners)
    np.testing.assert_array_equal(read.offsets, source.offsets)


def test_16_bit_colours_survive_six_decimals() -> None:
    stored = np.arange(600).reshape(200, 3) * 109
    read = back(mesh(colours=(stored / 65535).astype(np.float32), stored="uint16"))
    np.testing.assert_array_equal(np.rint(read.colours * 65535), stored)


def test_linear_grey_becomes_srgb_in_three_channels() -> None:
    grey = np.linspace(0, 1, 200, dtype=np.float32)[:, None]
    contents = mesh(colours=grey, encoding="linear", stored="float32")
    np.testing.assert_allclose(
        back(contents).colours, np.repeat(linear_to_srgb(grey), 3, axis=1), atol=5.1e-7
    )
    assert len(write_obj(contents, "out").notices) == 3


@pytest.mark.slow
def test_normals_are_written_for_every_vertex() -> None:
    normals = np.random.default_rng(9).normal(size=(200, 3)).astype(np.float32)
    text = b"".join(write_obj(mesh(normals=normals), "out").main).decode().splitlines()
    written = np.array([line.split()[1:] for line in text if line.startswith("vn ")], np.float32)
    np.testing.assert_array_equal(written, normals)
    corners = [corner.split("//") for line in text if line.startswith("f ") for corner in line.split()[1:]]
    assert all(vertex == normal for vertex, normal in corners)


def test_dropped_opacity_and_what_is_left_out_are_said() -> None:
    notices = write_obj(mesh(alpha=np.ones(200, np.float32), left_out=("skins",)), "out").notices
    assert len(notices) == 2
    assert "Opacity is dropped" in notices[0]
    assert notices[1] == "Not converted: skins."
