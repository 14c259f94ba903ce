"""What is written as PLY is read back the same, in types that lose nothing."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beltrami_cli.formats.ply.document import PlyDocument
from beltrami_cli.formats.ply.writer import write_ply
from beltrami_cli.surface.colour_values import linear_to_srgb
from beltrami_cli.surface.records import MeshContents


def contents(
    sizes: list[int], stored: str = "uint8", encoding: str = "srgb", double: bool = False, channels: int = 3
) -> MeshContents:
    random = np.random.default_rng(5)
    positions = random.normal(size=(300, 3))
    colours = random.integers(0, 256, (300, channels)) / 255
    if stored == "uint16":
        colours = random.integers(0, 65536, (300, channels)) / 65535
    return MeshContents(
        positions=positions if double else positions.astype(np.float32).astype(np.float64),
        corners=random.integers(0, 300, sum(sizes)).astype(np.int32),
        offsets=np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64),
        colours=colours.astype(np.float32),
        encoding=encoding,  # type: ignore[arg-type]
        stored=stored,
    )


def written(mesh: MeshContents) -> tuple[bytes, PlyDocument]:
    data = b"".join(write_ply(mesh, "out").main)
    return data, PlyDocument(data, "out.ply")


@settings(max_examples=30, deadline=None)
@given(
    st.lists(st.sampled_from([3, 3, 4, 7, 300]), max_size=6),
    st.sampled_from(["uint8", "uint16", "float32", "text"]),
    st.booleans(),
)
def test_round_trip(sizes: list[int], stored: str, double: bool) -> None:
    mesh = contents(sizes, stored, double=double)
    _, document = written(mesh)
    back = document.contents()
    for field in ("positions", "corners", "offsets", "colours"):
        np.testing.assert_array_equal(getattr(back, field), getattr(mesh, field))
    assert back.stored == (stored if stored.startswith("uint") else "float32")


def test_positions_are_doubles_only_where_floats_would_lose() -> None:
    assert b"property float x" in written(contents([3]))[0]
    assert b"property double x" in written(contents([3], double=True))[0]


def test_normals_and_alpha_are_kept() -> None:
    plain = contents([3])
    normals = np.random.default_rng(6).normal(size=(300, 3)).astype(np.float32)
    alpha = (np.arange(300) % 256 / 255).astype(np.float32)
    back = written(MeshContents(**{**vars(plain), "normals": normals, "alpha": alpha}))[1].contents()
    np.testing.assert_array_equal(back.normals, normals)
    np.testing.assert_array_equal(back.alpha, alpha)


@pytest.mark.parametrize(
    ("stored", "kept"), [("uint8", "uint16"), ("uint16", "uint16"), ("float32", "float32")]
)
def test_linear_colours_become_srgb_and_8_bit_steps_stay_apart(stored: str, kept: str) -> None:
    mesh = contents([3], stored, "linear")
    back = written(mesh)[1].contents()
    assert back.stored == kept
    np.testing.assert_allclose(back.colours, linear_to_srgb(mesh.colours), atol=0.5001 / 65535)
    if stored == "uint8":
        assert len(np.unique(back.colours)) == len(np.unique(mesh.colours))
    assert "Linear colours are written as sRGB" in write_ply(mesh, "out").notices[0]


def test_grey_becomes_three_equal_channels() -> None:
    mesh = contents([3], channels=1)
    np.testing.assert_array_equal(written(mesh)[1].painted().colours, np.repeat(mesh.colours, 3, axis=1))


def test_what_is_left_out_is_said_in_one_sentence() -> None:
    mesh = MeshContents(**{**vars(contents([3])), "left_out": ("materials", "skins")})
    assert write_ply(mesh, "out").notices == ("Not converted: materials; skins.",)
