"""A surface that is smoothed in partitions has the bits of one that is smoothed as a whole."""

from __future__ import annotations

import pickle
import weakref

import numpy as np
import pytest

from beltrami_cli.errors import UsageError
from beltrami_cli.flow import grid_partitions, mesh_partitions
from beltrami_cli.flow.beltrami_flow import choose_parameters, in_partitions
from beltrami_cli.flow.canvas import kernel_margin
from beltrami_cli.flow.embedding import Guide
from beltrami_cli.flow.mesh_manifold import mesh_manifold
from beltrami_cli.flow.moving_positions import GeometryParameters
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.layers.image_surface import ImageSurface, plan_on_image
from flow.split_surfaces import (
    FIXED,
    ON_GRIDS,
    SURFACE,
    InTurn,
    image_plan,
    is_clipped,
    noisy,
    outcome,
    same_bits,
    smooth_mesh,
    textured_plan,
    wavy_surface,
)
from properties.textured_planes import smoothed


class Sent:
    """Runs partitions in turn after they were sent through a pickle, as to other machines, and counts them."""

    def __init__(self):
        self.counts = []

    def run(self, partitions, values, iterations, progress):
        self.counts.append(len(partitions))
        assert sorted(np.concatenate([each.owned for each in partitions])) == list(range(len(values)))
        return InTurn(2).run(pickle.loads(pickle.dumps(partitions)), values, iterations, progress)


ON_MESHES = {
    "segments": {"solver": "segments"},
    "marching": {"solver": "fast-marching"},
    "areas": {"solver": "segments", "weights": "area", "iterations": 3},
    "world": {"solver": "segments", "units": "world", "metric_steps": 0, "beta": 0.0},
    "cut short": {"solver": "segments", "max_samples": 15},
}


def test_triangles_are_kept_only_where_partitions_are_cut():
    manifold = mesh_manifold(SURFACE, KernelParameters(**FIXED))
    triangles = weakref.ref(manifold.geometry.faces)
    plan = choose_parameters(manifold, KernelParameters(**FIXED))
    del manifold
    assert plan.manifold.geometry.size
    assert triangles() is None


@pytest.mark.slow
@pytest.mark.parametrize("name", ON_MESHES)
def test_a_mesh_in_partitions_has_the_bits_of_the_whole(name):
    parameters = KernelParameters(**{**FIXED, **ON_MESHES[name]})
    random = np.random.default_rng(1)
    guides = [Guide("guide", random.random((len(SURFACE.positions), 2)).astype(np.float32), 2.0)]
    whole = smooth_mesh(SURFACE, parameters, guides=guides, metric_channels=[0, 1])
    assert not np.array_equal(whole.colours, SURFACE.colours)
    for count, made in ((2, 2), (9, 3)):  # three blocks, so not more partitions
        runner = Sent()
        with in_partitions(count, runner):
            parts = smooth_mesh(SURFACE, parameters, guides=guides, metric_channels=[0, 1])
        assert runner.counts[-1] == made
        assert np.array_equal(parts.colours, whole.colours)
        assert parts.samples_per_kernel == pytest.approx(whole.samples_per_kernel, rel=0.1)
        assert (parts.truncated > 0) == (whole.truncated > 0)


@pytest.mark.slow
def test_kernels_that_are_too_large_for_groups_have_the_bits_of_the_whole_too():
    surface = wavy_surface(65)
    large = {"solver": "segments", "t": 32.0, "max_samples": 20, "iterations": 1}
    parameters = KernelParameters(**{**FIXED, **large})
    whole = smooth_mesh(surface, parameters)
    with in_partitions(2, InTurn(2)):
        parts = smooth_mesh(surface, parameters)
    assert np.array_equal(parts.colours, whole.colours)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["segments", "marching"])
def test_partitions_that_are_too_narrow_are_found_out_and_cut_anew(name, monkeypatch):
    parameters = KernelParameters(**{**FIXED, **ON_MESHES[name]})
    whole = smooth_mesh(SURFACE, parameters)
    monkeypatch.setattr(mesh_partitions, "EDGES_PER_SPACING", 0.5)  # the first guess is four edges
    runner = Sent()
    with in_partitions(3, runner):
        parts = smooth_mesh(SURFACE, parameters)
    assert len(runner.counts) > 1
    assert np.array_equal(parts.colours, whole.colours)


@pytest.mark.slow
def test_parameters_are_chosen_on_the_whole():
    parameters = KernelParameters(free=("iterations", "beta"), threads=2)
    surface = wavy_surface(65)  # two blocks
    whole = smooth_mesh(surface, parameters)
    runner = Sent()
    with in_partitions(2, runner):
        parts = smooth_mesh(surface, parameters)
    assert runner.counts[-1] == 2
    assert parts.choice == whole.choice
    assert np.array_equal(parts.colours, whole.colours)


def test_vertices_are_not_moved_in_partitions():
    geometry = GeometryParameters(np.arange(len(SURFACE.positions), dtype=np.int32))
    with in_partitions(2, InTurn(1)), pytest.raises(UsageError, match="not moved in pieces"):
        smooth_mesh(SURFACE, KernelParameters(**FIXED), geometry=geometry)


@pytest.mark.slow
@pytest.mark.parametrize("make", [textured_plan, image_plan])
@pytest.mark.parametrize("name", ON_GRIDS)
def test_a_grid_in_partitions_has_the_bits_of_the_whole(make, name):
    """The result and the gutter are those of the whole, and samples are counted exactly."""
    parameters = KernelParameters(**{**FIXED, **ON_GRIDS[name]})
    plan = make(parameters)
    assert name == "world" or is_clipped(plan)
    whole = outcome(plan)
    for count in (1, 2, 5):
        runner = Sent()
        with in_partitions(count, runner):
            parts = outcome(make(parameters))
        assert runner.counts == [count]
        assert same_bits(parts, whole)


def test_a_margin_that_is_one_cell_too_narrow_is_not_enough(monkeypatch):
    """So the test above would see it."""
    parameters = KernelParameters(**{**FIXED, "metric_scale": 1.0, "beta": 1.0})
    whole = smoothed(image_plan(parameters))
    monkeypatch.setattr(grid_partitions, "kernel_margin", lambda parameters: kernel_margin(parameters) - 2)
    with in_partitions(4, InTurn(2)):
        parts = smoothed(image_plan(parameters))
    assert not np.array_equal(parts, whole)


def test_nothing_to_do_is_nothing_in_partitions_too():
    nothing = KernelParameters(**{**FIXED, "iterations": 0})
    values = noisy(30)

    def grid(valid, parameters):
        return smoothed(plan_on_image(ImageSurface(valid=valid), lambda pixels: values[pixels], parameters))

    with in_partitions(3, InTurn(1)):
        result = grid(np.ones((5, 6), bool), nothing)
        mesh = smooth_mesh(SURFACE, nothing)
        empty = grid(np.zeros((5, 6), bool), KernelParameters(**FIXED))
    assert np.array_equal(result, values)
    assert np.array_equal(mesh.colours, SURFACE.colours)
    assert len(empty) == 0
