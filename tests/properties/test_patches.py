"""Patches on whole surfaces: no seam is seen, nothing crosses hard edges or thin sheets, and frames do not matter."""

import numpy as np
import pytest

from beltrami_cli import smooth, smooth_image
from beltrami_cli.layers.image_surface import ImageSurface
from oracles import surfaces
from oracles.pictures import photograph, psnr, with_noise
from properties import textured_planes
from properties.textured_planes import Board

SIGMA = 20 / 255
SIDE = 48
# Turned, mirrored, and each in another corner of the image.
PLACES = [(1, 1, 1, False), (0, 0, 2, True), (0, 1, 3, False), (1, 0, 0, True)]
BOARD = Board(cells=8, texels=12, block=4, slot=64, slots=2, places=PLACES)
FIXED = {"iterations": 1, "t": 2.0, "beta": 8.0, "patches": "on", "threads": 2}
RANDOM = np.random.default_rng(5)


def on_board(board, phantom, **parameters):
    """Smooth a phantom on a plane that is cut into charts; return it as it lies on the plane."""
    image = board.image_of(phantom)
    result, _ = textured_planes.smooth_image(board.surface(), image, **{**FIXED, **parameters})
    return result[board.texel_places()]


def test_charts_cost_nothing():
    side = BOARD.cells * BOARD.texels
    clean = photograph(side)
    noisy = with_noise(clean, SIGMA)
    whole = Board(cells=8, texels=12, block=8, slot=128, slots=1, places=[(0, 0, 0, False)])
    assert psnr(on_board(BOARD, noisy), clean) > psnr(on_board(whole, noisy), clean) - 0.3


def test_nothing_crosses_a_seam_where_colours_jump():
    side = BOARD.cells * BOARD.texels
    clean = 0.1 * photograph(side) + 0.2
    clean[:, side // 2 :] += 0.5
    result = on_board(BOARD, with_noise(clean, SIGMA / 2))
    near = (result - clean)[:, side // 2 - 3 : side // 2 + 3]
    # The mean of 96 x 3 samples by 3 channels; the kernel alone stays within this, too.
    assert np.abs(near.mean(axis=(0, 2))).max() < 0.01
    assert np.abs(near).max() < 0.1


def plane(side=SIDE, seed=1):
    positions, faces = surfaces.plane(side, side)
    clean = photograph(side, seed).reshape(-1, 3)
    return positions, faces, clean, with_noise(clean, SIGMA)


def result_on(positions, faces, noisy, **parameters):
    return smooth(positions, faces, noisy, **parameters).colours


@pytest.mark.slow
def test_the_other_side_of_a_thin_sheet_is_no_neighbour():
    positions, faces, clean, _ = plane()
    clean = clean - 0.2
    both = np.vstack([positions, positions + np.array([0, 0, 0.01])])
    truth = np.vstack([clean * 0.5, clean * 0.5 + 0.5])
    sides = np.vstack([faces, faces[:, ::-1] + len(positions)])
    result = result_on(both, sides, with_noise(truth, SIGMA / 2))
    for side in (slice(len(positions)), slice(len(positions), None)):
        assert abs((result - truth)[side].mean()) < 0.005
        assert np.abs((result - truth)[side]).max() < 0.2


@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (3, 3), (5, 64)])
def test_small_images_and_meshes_are_handled(shape):
    noisy = RANDOM.random((*shape, 3)).astype(np.float32)
    colours = smooth_image(noisy, patches="on").colours
    assert np.isfinite(colours).all()
    positions, faces = surfaces.plane(*shape)
    assert np.isfinite(result_on(positions, faces, noisy.reshape(-1, 3), patches="on")).all()


def test_pixels_of_holes_keep_their_colours_and_lend_none():
    clean = photograph(64)
    noisy = with_noise(clean, SIGMA)
    noisy[20:30, 10:50] = [1, 0, 1]
    valid = np.ones((64, 64), bool)
    valid[20:30, 10:50] = False
    result = smooth_image(noisy, surface=ImageSurface(valid=valid)).colours
    assert np.array_equal(result[~valid], noisy[~valid])
    near = np.zeros_like(valid)
    near[18:32, 8:52] = True
    assert np.abs((result - clean)[near & valid].mean(axis=0)).max() < 0.02
