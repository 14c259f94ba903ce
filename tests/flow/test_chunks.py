"""A surface that is smoothed in chunks has the bits of one that is smoothed as a whole."""

import dataclasses
import itertools
import pickle
from functools import partial

import numpy as np
import pytest

from beltrami_cli._native import PATCH_TILE_SIDE
from beltrami_cli.errors import UsageError
from beltrami_cli.flow import cuts
from beltrami_cli.flow.chunks import IN_ONE_PIECE, Chunking, Resources, in_turn
from beltrami_cli.flow.decoding import plan_on_canvas
from beltrami_cli.flow.manifolds.grid.patches import collaborate_on_canvas
from beltrami_cli.flow.manifolds.guides import Guide
from beltrami_cli.flow.manifolds.iteration import Step
from beltrami_cli.flow.manifolds.mesh.manifold import mean_samples_per_kernel
from beltrami_cli.flow.manifolds.moving_positions import PositionParameters
from beltrami_cli.flow.mixing import Mixing
from beltrami_cli.flow.parameters import KernelParameters, parameters_from
from beltrami_cli.layers.image_surface import ImageSurface, canvas_of_image
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import EMPTY, OWNED
from flow.split_surfaces import (
    FIXED,
    ON_GRIDS,
    SURFACE,
    image_plan,
    noisy,
    outcome,
    same_bits,
    smooth_mesh,
    textured_plan,
)
from properties.textured_planes import smoothed

ON_MESHES = {
    "segments": {"solver": "segments"},
    "marching": {"solver": "fast-marching"},
    "areas": {"solver": "segments", "weights": "area", "iterations": 3},
    "world": {"solver": "segments", "units": "world", "metric_steps": 0, "beta": 0.0},
    "cut short": {"solver": "segments", "max_samples": 15},
    "wide": {"solver": "segments", "t": 8.0, "iterations": 1},
    "patches": {"patches": "on"},
}


class Sent:
    """Works on chunks that were sent through a pickle, last first, and remembers how many there were."""

    def __init__(self):
        self.counts = []

    def __call__(self, cut, operation, stacks):
        self.counts.append(len(cut))
        for number, chunk in reversed([*enumerate(cut)]):
            part, work = pickle.loads(pickle.dumps((chunk.cut(), operation)))
            values, figures = work(part, [np.array(stack[chunk.around]) for stack in stacks], 2)
            yield number, values, figures
            for own in values:  # whose memory the next chunk takes, as it does in another process
                own.fill(np.nan)


@pytest.fixture(autouse=True, scope="module")
def small_chunks():
    """Cut surfaces however small they are."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cuts, "MIN_CELLS", 1)
        patch.setattr(cuts, "MIN_SAMPLES", 1)
        yield


def is_kept(one, other):
    """Whether colours differ by no more than is promised for any number of chunks."""
    steps = 255 * np.abs(one.astype(np.float64) - other).max(axis=1)
    return steps.max() <= 0.5 and np.count_nonzero(steps > 0.1) <= 1e-4 * len(steps)


# Half a second each, since the surface must have several blocks.
@pytest.mark.slow
@pytest.mark.parametrize(("name", "count"), [*zip(ON_MESHES, itertools.cycle([3, 2, 12])), ("patches", 2)])
def test_a_mesh_in_chunks_has_the_bits_of_the_whole(name, count):
    parameters = KernelParameters(**{**FIXED, **ON_MESHES[name]})
    guides = [Guide("guide", SURFACE.colours[:, ::-1].copy(), 2.0)]
    whole = smooth_mesh(SURFACE, parameters, guides=guides, metric_channels=[0, 1])
    assert not np.array_equal(whole.colours, SURFACE.colours)
    cut = Resources(Chunking(count, runner := Sent()))
    parts = smooth_mesh(SURFACE, parameters, guides=guides, metric_channels=[0, 1], resources=cut)
    assert runner.counts[0] == min(count, 3)  # blocks
    if name == "patches":  # sums in another order, and groups that reach further at a corner of the surface
        assert is_kept(parts.colours, whole.colours)
    else:
        assert np.array_equal(parts.colours, whole.colours)
    assert (parts.samples_per_kernel, parts.truncated) == (whole.samples_per_kernel, whole.truncated)


@pytest.mark.slow
@pytest.mark.parametrize("make", [textured_plan, image_plan])
@pytest.mark.parametrize(("name", "count"), [*zip(ON_GRIDS, itertools.cycle([2, 9, 5]))])
def test_a_grid_in_chunks_has_the_bits_of_the_whole(make, name, count):
    """The result and the gutter are the same as of the whole, and samples are counted exactly."""
    parameters = KernelParameters(**{**FIXED, **ON_GRIDS[name]})
    whole, runner = outcome(make(parameters)), Sent()
    parts = outcome(make(parameters, Resources(Chunking(count, runner))))
    assert runner.counts[0] > 1
    assert same_bits(parts, whole)


def picture(shape, parameters, relative=None, resources=IN_ONE_PIECE):
    """Plan pixels with holes, with patches; `relative`: noise that differs from place to place."""
    values = noisy(shape[0] * shape[1])
    valid = np.random.default_rng(6).random(shape) > 0.02
    surface = ImageSurface(valid=valid)
    canvas = canvas_of_image(surface, lambda pixels: values[pixels], parameters, deviations=relative)
    return plan_on_canvas(dataclasses.replace(canvas, resources=resources))


# Patches go tile by tile, so that a canvas of several chunks has some hundred thousand cells.
@pytest.mark.slow
@pytest.mark.parametrize(("differs", "count"), [(False, 2), (True, 7)])
def test_patches_and_their_coarse_levels_take_part(differs, count):
    shape = 520, 390
    relative = np.linspace(10, 30, shape[0] * shape[1])[:, None].astype(np.float32) / 255 if differs else None
    parameters = KernelParameters(**{**FIXED, "patches": "on"})
    whole = outcome(picture(shape, parameters, relative))
    cut = Resources(Chunking(count, runner := Sent()))
    parts = outcome(picture(shape, parameters, relative, cut))
    assert min(runner.counts) > 1
    assert len(runner.counts) > 2 * FIXED["iterations"] + 4  # the kernel, the patches, and levels
    assert same_bits(parts, whole)


# 4 s: parameters are chosen three times on a surface of several blocks.
@pytest.mark.slow
def test_parameters_are_chosen_on_the_whole():
    free = parameters_from({"threads": 1})
    whole = smooth_mesh(SURFACE, free)
    in_kernel = mean_samples_per_kernel(whole.manifold, 9, Step(1.0, 1.0, False))
    for cut in (Resources(Chunking(3, in_turn)), Resources(chunk_memory=1 << 20)):
        assert cut.chunking_of_mesh(len(SURFACE.positions), 1).count > 2
        parts = smooth_mesh(SURFACE, free, resources=cut)
        assert mean_samples_per_kernel(parts.manifold, 9, Step(1.0, 1.0, False)) == in_kernel
        assert parts.choice.chosen == whole.choice.chosen
        assert np.array_equal(parts.colours, whole.colours)


def test_vertices_are_not_moved_in_chunks():
    moving = PositionParameters(np.arange(len(SURFACE.positions), dtype=np.int32))
    cut = Resources(Chunking(2, in_turn))
    with pytest.raises(UsageError, match="not moved in pieces"):
        smooth_mesh(SURFACE, KernelParameters(**FIXED), moving=moving, resources=cut)


def test_cells_beyond_all_chunks_are_those_of_the_whole(monkeypatch):
    """The second of two chunks has no owned cell, since chunks begin at multiples of two tiles."""
    kind = np.full((2 * PATCH_TILE_SIDE, 6 * PATCH_TILE_SIDE), EMPTY, np.uint8)
    kind[8:-8, 8 : 2 * PATCH_TILE_SIDE] = OWNED
    planes = np.where(kind == OWNED, np.random.default_rng(2).random((1, *kind.shape)), 0).astype(np.float32)
    mixing = Mixing.of(np.zeros((1, 1), np.float32), np.eye(1))
    estimate = partial(collaborate_on_canvas, kind, [planes, planes], mixing, 1)
    whole = estimate()
    monkeypatch.setattr(large_arrays, "empty", lambda shape, dtype: np.full(shape, np.nan, dtype))
    assert same_bits([estimate(chunking=Chunking(2, in_turn))], [whole])


def test_nothing_to_do_is_nothing_in_chunks_too():
    nothing = KernelParameters(**{**FIXED, "iterations": 0})

    cut = Resources(Chunking(3, in_turn))

    def grid(valid, parameters):
        canvas = canvas_of_image(ImageSurface(valid=valid), lambda at: noisy(30)[at], parameters)
        return smoothed(plan_on_canvas(dataclasses.replace(canvas, resources=cut)))

    result = grid(np.ones((5, 6), bool), nothing)
    mesh = smooth_mesh(SURFACE, nothing, resources=cut)
    assert len(grid(np.zeros((5, 6), bool), KernelParameters(**FIXED))) == 0
    assert np.array_equal(result, noisy(30))
    assert np.array_equal(mesh.colours, SURFACE.colours)
