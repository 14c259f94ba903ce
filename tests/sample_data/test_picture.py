"""The picture shows what is in front, where it is, in the colours that it has."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

FOLDER = Path(__file__).parents[2] / "sample_data"


@pytest.fixture
def picture(monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER))
    import picture

    yield picture
    for path in FOLDER.glob("*.py"):
        sys.modules.pop(path.stem, None)


def square(z, rgb):
    corners = np.array([[-1.0, -1, z], [1, -1, z], [1, 1, z], [-1, 1, z]])
    return corners, np.array([[0, 1, 2], [0, 2, 3]]), np.tile(np.float32(rgb), (4, 1))


def test_the_nearer_square_hides_the_farther_one_whatever_their_order(picture):
    (a, f, red), (b, _, blue) = square(-0.5, (0.9, 0, 0)), square(0.5, (0, 0, 0.9))
    both = np.concatenate([f, f + 4])
    for faces in (both, both[::-1]):
        paint = picture.at_vertices(faces, np.concatenate([red, blue]))
        image = picture.draw(np.concatenate([a, b]), faces, paint, 32)
        assert image[4:28, 4:28] == pytest.approx(np.tile(np.float32([0, 0, 0.9]), (24, 24, 1)))
        behind = picture.draw(np.concatenate([a, b]), faces, paint, 32, (180.0, 0.0))
        assert behind[16, 16] == pytest.approx([0.9, 0, 0])
        assert image[0, 0] == pytest.approx([picture.BACKGROUND] * 3)


def test_x_runs_to_the_right_and_y_upwards(picture):
    corners, faces, colours = square(0.0, (0, 0, 0))
    colours[:, 0], colours[:, 1] = (corners[:, :2].T + 1) / 2
    image = picture.draw(corners, faces, picture.at_vertices(faces, colours), 40)
    assert np.allclose(image[20, 8:32, 0], (np.arange(8, 32) - 1.6) / 36.8, atol=0.03)
    assert np.allclose(image[8:32, 20, 1], 1 - (np.arange(8, 32) - 1.6) / 36.8, atol=0.03)


def test_a_texture_is_looked_up_between_texels_with_v_down_and_repeats(picture):
    pytest.importorskip("OpenImageIO")
    import images
    from beltrami_cli.mesh.textured import Texture, TexturedSurface
    from textured import Painting

    corners, faces, _ = square(0.0, (0, 0, 0))
    row, column = np.mgrid[:16, :16] / 15
    pixels = np.stack([column, row, np.zeros((16, 16))], axis=2)
    data = images.encode(Painting("", pixels, np.ones((16, 16), bool), "png16"))
    image = Texture("0", "ramp.png", data)
    for shift in (0.0, -3.0):
        uv = (corners[:, :2] * (1, -1) + 1)[faces] / 2 + shift
        surface = TexturedSurface(corners, faces, uv, np.zeros(2, np.int32), (image,))
        paint = picture.textured(surface)
        # The middle of the first triangle is at u = 2/3, v = 2/3; texel centres are at (i + 0.5) / 16.
        seen = paint(np.array([0]), np.full((1, 3), 1 / 3))
        assert seen[0] == pytest.approx([(2 / 3 * 16 - 0.5) / 15] * 2 + [0], abs=1e-4)
        drawn = picture.draw(corners, faces, paint, 40)
        assert (drawn[8, 8, :2] < 0.25).all()
        assert (drawn[32, 32, :2] > 0.75).all()


def test_two_samples_make_one_png_of_twice_the_width(picture, tmp_path):
    pytest.importorskip("OpenImageIO")
    written = tmp_path / "both.png"
    meshes = [str(FOLDER / f"nonmanifold-{kind}.ply") for kind in ("clean", "noisy")]
    assert picture.main([*meshes, str(written), "--size", "48", "--shade"]) == 0
    data = written.read_bytes()
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    assert (int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")) == (96, 48)
