"""Smoothing is estimate, choose, smooth: functions of values, of which only the last takes an array over."""

import dataclasses

import numpy as np
import pytest

from beltrami_cli.flow.corrections.coarse_levels import without_shared_noise
from beltrami_cli.flow.estimation import estimate_on_canvas, estimate_on_mesh
from beltrami_cli.flow.manifolds.grid.manifold import ColouredCanvas, grid_manifold
from beltrami_cli.flow.manifolds.iteration import Step
from beltrami_cli.flow.manifolds.mesh.manifold import ColouredMesh, mesh_manifold
from beltrami_cli.flow.noise.model import NoiseModel
from beltrami_cli.flow.noise.stabiliser import VarianceStabiliser
from beltrami_cli.flow.noise_amount import COLOURS
from beltrami_cli.flow.parameters import KernelParameters, parameters_from
from beltrami_cli.flow.plan import choose_parameters
from beltrami_cli.surface.atlas import build_atlas
from beltrami_cli.surface.grid_atlas import grid_atlas
from flow.split_surfaces import SURFACE
from flow.test_correlated_noise import phantom
from oracles.textured import strips
from properties.textured_planes import texel_plan

CAMERA = "shot:0.01,read:0.005"  # whose colours are stabilised


@pytest.fixture(scope="module")
def shared():
    """A phantom with noise that neighbours share, which is removed before parameters are chosen."""
    random, truth = np.random.default_rng(4), phantom(96)
    small = random.normal(0, 25, (48, 48, 3)).repeat(2, axis=0).repeat(2, axis=1)
    return np.clip(truth + small / 255, 0, 1).astype(np.float32)


def canvas_of(image, parameters):
    atlas = grid_atlas(image.shape[:2], 8, None, np.ones(image.shape[:2], bool))
    colours_of = image.reshape(-1, 3).__getitem__
    return ColouredCanvas(atlas=atlas, parameters=parameters, channels=3, colours_of=colours_of)


@pytest.mark.slow
@pytest.mark.parametrize("noise", [None, CAMERA])
def test_estimating_and_choosing_leave_the_colours_of_a_canvas(shared, noise):
    parameters, before = parameters_from({"threads": 1, "noise": noise}), shared.copy()
    canvas = canvas_of(shared, parameters)
    colours = estimate_on_canvas(canvas)
    stack = colours.stack.copy()
    plan = choose_parameters(grid_manifold(canvas, colours))
    assert np.array_equal(shared, before)
    assert np.array_equal(colours.stack, stack)
    assert not np.array_equal(plan.manifold.colours, stack)


@pytest.mark.slow
def test_the_error_of_means_is_that_of_the_input_s_colours(shared):
    """The same stabilised colours, which stand for themselves or for others, in which they differ more."""
    canvas = canvas_of(shared, parameters_from({"threads": 1, "noise": CAMERA}))
    manifold = grid_manifold(canvas, estimate_on_canvas(canvas))
    plain = dataclasses.replace(manifold, noise=dataclasses.replace(manifold.noise, stabiliser=None))
    (_, error), (_, expected) = (without_shared_noise(each) for each in (manifold, plain))
    assert expected > 0
    assert error == pytest.approx(manifold.noise.square_to_input(expected))
    assert error != pytest.approx(expected, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("noise", [None, CAMERA])
def test_estimating_and_choosing_leave_the_colours_of_a_mesh(noise):
    parameters = parameters_from({"threads": 1, "noise": noise})
    mesh = ColouredMesh.of(SURFACE, parameters)
    before = mesh.colours.copy()
    colours = estimate_on_mesh(mesh)
    stack = colours.stack.copy()
    choose_parameters(mesh_manifold(mesh, colours))
    assert np.array_equal(mesh.colours, before)
    assert np.array_equal(colours.stack, stack)


@pytest.mark.parametrize("solver", ["segments", "fast-marching"])
def test_a_metric_stays_valid_after_the_next_is_measured(solver):
    parameters = parameters_from({"threads": 1, "solver": solver, "iterations": 2, "t": 1.0, "beta": 4.0})
    mesh = ColouredMesh.of(SURFACE, parameters)
    manifold = mesh_manifold(mesh, estimate_on_mesh(mesh))
    first = manifold.measure(manifold.colours, Step(4.0, 1.0, regularised=False))
    (expected,) = manifold.average([manifold.colours], first).stacks
    other = manifold.measure(expected, Step(0.0, 1.0, regularised=False))
    (plain,) = manifold.average([manifold.colours], other).stacks
    (again,) = manifold.average([manifold.colours], first).stacks
    assert np.array_equal(again, expected)
    assert not np.array_equal(plain, expected)


def test_reading_new_colours_leaves_those_of_the_manifold():
    """The gutter shows interpolated colours, while halo cells repeat their nearest ones."""
    shifted = strips([((0, 8), (4, 12)), ((8, 16), (20.5, 28.5))], (32, 16))
    atlas = build_atlas(shifted, [(32, 16)], 4, 1)
    colours = np.random.default_rng(3).random((len(atlas.owned_cells), 3)).astype(np.float32)
    manifold = texel_plan(atlas, colours, KernelParameters(threads=1, beta=0.0)).manifold
    before = manifold.colours.copy()
    new = manifold.new_colours()
    flat, gutter = before.reshape(len(before), -1), manifold.geometry.atlas.gutter.cells
    assert not np.array_equal(new.beyond, manifold.noise.to_input(flat[:, gutter].T))
    assert np.array_equal(manifold.colours, before)


def test_what_is_measured_in_stabilised_colours_is_converted_to_the_input_s():
    """A length is beta times a difference in either unit; of small differences over all levels, root mean squares."""
    random = np.random.default_rng(2)
    levels, relative = np.linspace(0, 1, 9), np.linspace(0.2, 2.0, 9)
    noise = NoiseModel(np.eye(COLOURS)[None] * 1e-4, VarianceStabiliser(levels, relative, np.ones(9)))
    colours = np.repeat(random.random((20_000, 1)), COLOURS, axis=1).astype(np.float32)
    stable = noise.stabiliser.stabilised(colours.T).T
    moved = stable + np.float32(1e-3)
    size = float(np.sqrt(np.mean((noise.to_input(moved) - noise.to_input(stable)) ** 2)))
    assert noise.difference_to_input(1e-3) == pytest.approx(size, rel=0.1)
    assert noise.square_to_input(1e-6) == pytest.approx(size**2, rel=0.2)
    assert noise.beta_to_input(5.0) * size == pytest.approx(5.0 * 1e-3, rel=0.1)
    assert noise.of_input == pytest.approx(noise.difference_to_input(1e-2) * np.ones(COLOURS))
