"""Without beta the kernel is linear: a Gaussian on the surface that colours have no part in, on every input."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import beltrami_cli
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.jobs.job import Job
from beltrami_cli.layers.image_surface import ImageSurface
from beltrami_cli.layers.settings import SmoothSettings
from oracles import surfaces
from properties.textured_planes import Board, smooth_image

SAMPLES = Path(__file__).parents[2] / "sample_data"
LINEAR = {"beta": 0.0, "iterations": 3}


def on_a_mesh(colours):
    flat, faces = surfaces.plane(15, 15, 0.3)
    hilly = flat + np.column_stack([np.zeros((len(flat), 2)), np.sin(flat[:, 0]) * np.cos(flat[:, 1])])
    return beltrami_cli.smooth(
        hilly, faces, colours.reshape(-1, 3)[: len(flat)], space="data", **LINEAR
    ).colours


def on_a_plane(colours):
    return beltrami_cli.smooth_image(colours, space="data", **LINEAR).colours


def on_heights(colours):
    y, x = np.mgrid[:48, :48]
    return beltrami_cli.smooth_image(
        colours, surface=ImageSurface(heights=5 * np.sin(x / 6 + y / 9)), space="data", **LINEAR
    ).colours


def with_the_papers_scheme(colours):
    return beltrami_cli.smooth_image(colours, scheme="metric", space="data", **LINEAR).colours


def on_charts(colours):
    # A plane cut into four charts that lie elsewhere in the image, so that there are seams.
    places = [(1, 1, 1, False), (0, 0, 2, False), (0, 1, 3, False), (1, 0, 1, False)]
    board = Board(cells=8, texels=6, block=4, slot=32, slots=2, places=places)
    image, _ = smooth_image(board.surface(), board.image_of(colours), **LINEAR)
    return image[board.texel_places()]


@pytest.mark.parametrize("smooth", [on_a_mesh, on_a_plane, on_heights, with_the_papers_scheme, on_charts])
def test_what_is_smoothed_of_a_sum_is_the_sum_of_what_is_smoothed(smooth):
    random = np.random.default_rng(4)
    a, b = random.random((48, 48, 3)), random.random((48, 48, 3))
    # Jumps that are real edges to a nonlinear kernel, also at the seams of charts.
    a[24:] += 2
    b[:, 24:] -= 3
    a, b = a.astype(np.float32), b.astype(np.float32)
    total = smooth((2 * a - b).astype(np.float32))
    # Float32 sums of some 50 terms up to 7, over three iterations.
    np.testing.assert_allclose(total, 2 * smooth(a) - smooth(b), atol=2e-5)


@pytest.mark.parametrize(
    "name",
    [
        "nonmanifold-noisy.ply",
        "knot-noisy.obj",
        "terrain-noisy.glb",
        "mirrored-noisy.obj",
        "mirrored-noisy.png",
    ],
)
def test_kernels_of_a_file_hold_the_same_samples_with_and_without_noise(name, tmp_path):
    settings = SmoothSettings(KernelParameters(iterations=1, beta=0.0))

    def samples(source):
        target = tmp_path / Path(name).with_stem("out")
        report = beltrami_cli.smooth_file(SAMPLES / source, target, settings, job=Job(dry_run=True))
        parts = [*report.textures, *filter(None, [report.image])]
        return [part.samples_per_kernel for part in parts] or [report.vertices.counts["samples_per_kernel"]]

    noisy, clean = samples(name), samples(name.replace("noisy", "clean"))
    assert noisy == clean
    assert noisy[0] > 40
