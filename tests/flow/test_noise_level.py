"""The estimated noise is the noise: on surfaces rich in texture and edges, near the limits, and where there is none."""

from functools import partial

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

import beltrami_cli
from beltrami_cli.flow.noise.clusters import VertexClusters
from beltrami_cli.flow.noise.reading import read_noise
from beltrami_cli.flow.vertex_graph import Graph
from flow.noisy_surfaces import in_8_bits as stored
from flow.noisy_surfaces import noise_of_image
from oracles import surfaces
from oracles.pictures import photograph, with_noise

noisy = partial(with_noise, seed=5, cut_off=False)


def on_grid(image):
    """Estimate the noise of an image of shape (R, C, N), in units of 1/255."""
    return 255 * noise_of_image(image, varies=False).sigma


def on_mesh(colours, faces):
    """Estimate the noise of vertices, in units of 1/255."""
    sides = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    priorities = np.random.default_rng(0).integers(0, 2**63, len(colours), dtype=np.uint64)
    graph = Graph(np.zeros((len(colours), 3)), np.unique(sides, axis=0).astype(np.int32), priorities)
    return 255 * read_noise(colours.T, VertexClusters.of(graph), varies=False).sigma


def grain(size, seed=0):
    """Return a texture without a plain place: grain of two texels' width whose contrast changes from place to place."""
    random = np.random.default_rng(seed)
    fine = gaussian_filter(random.standard_normal((size, size)), 0.85, mode="wrap")
    broad = gaussian_filter(random.standard_normal((size, size)), 12, mode="wrap")
    contrast = 0.08 * np.exp(0.7 * broad / broad.std())
    image = 0.5 + np.clip(contrast * fine / fine.std(), -0.4, 0.4)
    return image[:, :, None] * [1.0, 0.9, 0.8]


def test_rich_texture_is_not_taken_for_noise():
    """Grain adds to the finest detail everywhere, but least where coarse means are even."""
    clean = grain(192)
    found = np.mean([on_grid(stored(noisy(clean, 10 / 255, seed=seed))) for seed in range(3)])
    assert found == pytest.approx(10, rel=0.15)


@pytest.mark.parametrize("waves", [5, 9])
def test_edges_of_a_coarse_mesh_are_not_taken_for_noise(waves):
    """On 2,562 vertices with hard edges, in half of the neighbourhoods of two rings or in nearly all."""
    positions, faces = surfaces.icosphere(4)
    clean = 0.5 + 0.25 * np.sign(np.sin(waves * positions))
    found = np.mean([on_mesh(stored(noisy(clean, 5 / 255, seed=seed)), faces) for seed in range(4)])
    assert found < 1.45 * 5


@pytest.mark.parametrize("level", [0.97, 0.03])
def test_noise_is_found_near_the_limits_too(level):
    """On half white or half black images, which is measured on the other half."""
    clean = np.full((128, 128, 1), level)
    clean[:, 64:] = 0.5
    assert on_grid(stored(noisy(clean, 20 / 255))) == pytest.approx(20, rel=0.06)


def test_noise_is_found_where_all_is_cut_off():
    """On white everywhere, half of the noise is gone; the share and the mean of the rest show it."""
    assert on_grid(stored(noisy(np.ones((128, 128, 1)), 30 / 255))) == pytest.approx(30, rel=0.15)


def test_line_art_and_flat_areas_have_no_noise():
    """Colours at 0 and 1 with sharp or antialiased borders, and areas that are plain but for a few borders."""
    y, x = np.mgrid[:96, :96] / 96
    letters = np.clip(8 * np.sin(40 * x) * np.sin(30 * y + 9 * x) + 0.5, 0, 1)
    checks = (np.floor(12 * x) + np.floor(12 * y)) % 2
    image = np.stack([letters, checks, np.where(x + y > 0.8, 0.4, 1.0)], axis=2)
    assert (on_grid(image) < 0.5).all()


@pytest.mark.parametrize("side", [4, 12, 17])
def test_few_samples_are_detail(side):
    """An icon has too few to tell noise from detail."""
    icon = np.random.default_rng(side).choice([0.1, 0.4, 0.9], (side, side, 3)).astype(np.float32)
    assert np.array_equal(beltrami_cli.smooth_image(icon).colours, icon)
    part = icon[:12, :12]  # meshes have enough from some 200 vertices on
    _, faces = surfaces.plane(*part.shape[:2])
    assert (on_mesh(part.reshape(-1, 3), faces) == 0).all()


def test_noise_that_is_too_large_for_the_range_of_colours_is_detail():
    """Four colours without any order; each channel has two values."""
    colours = np.array([[1, 0, 0], [0, 1, 0], [1, 0, 1], [0, 1, 1]], np.float32)
    random = np.random.default_rng(3)
    assert (on_grid(0.1 + 0.8 * colours[random.integers(0, 4, (48, 48))]) == 0).all()
    positions, faces = surfaces.icosphere(3)
    assert (on_mesh(0.1 + 0.8 * colours[random.integers(0, 4, len(positions))], faces) == 0).all()


def test_the_noise_around_what_lies_on_black_is_read_right():
    """Half of the noise on black is cut off, and little else is even; the estimate is 30 % off at most."""
    down, across = np.mgrid[:256, :256]
    is_disc = (down % 64 - 32) ** 2 + (across % 64 - 32) ** 2 < 18**2
    clean = gaussian_filter(np.where(is_disc[..., None], photograph(256), 0), (0.6, 0.6, 0))
    read = beltrami_cli.smooth_image(stored(noisy(clean, 5 / 255, seed=2)), iterations=0).noise
    assert 255 * np.asarray(read) == pytest.approx(np.full(3, 5.0), rel=0.3)


def test_writing_on_plain_paper_stays():
    """Soft strokes nearly everywhere, and equal neighbours between them, as noise leaves none."""
    random, page = np.random.default_rng(0), np.zeros((256, 256))
    for top, left in np.argwhere(np.ones((16, 30))) * [15, 8] + 2:
        for row, column, is_high in random.integers(0, [9, 5, 2], (3, 3)):
            place = page[top + row :, left + column :]
            place[: 6 if is_high else 1, : 1 if is_high else 4] = 1
    soft = gaussian_filter(page, 0.5, truncate=2.0)[..., None]
    writing = stored(np.repeat(0.94 - 0.86 * soft / soft.max(), 3, axis=2))
    assert np.array_equal(beltrami_cli.smooth_image(writing).colours, writing)
    assert on_grid(stored(noisy(writing, 5 / 255))) == pytest.approx(5, rel=0.2)
