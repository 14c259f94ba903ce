"""A surface that is smoothed in pieces has the bits of one that is smoothed as a whole."""

from __future__ import annotations

import pickle
from types import SimpleNamespace

import numpy as np
import pytest

from beltrami_cli.errors import UsageError
from beltrami_cli.flow import mesh_partitions
from beltrami_cli.flow.beltrami_flow import BeltramiFlow
from beltrami_cli.flow.embedding import Guide
from beltrami_cli.flow.geometry import GeometryParameters
from beltrami_cli.flow.grid_manifold import GridManifold
from beltrami_cli.flow.mesh_manifold import MeshManifold
from beltrami_cli.flow.mesh_partitions import Neighbours
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.flow.partitions import InTurn, collect, in_partitions, plan_loans
from beltrami_cli.samples.image_surface import ImageSurface
from beltrami_cli.samples.pixel_samples import grid_flow
from beltrami_cli.surface.atlas import build_atlas
from beltrami_cli.surface.records import SampledSurface
from oracles import surfaces
from properties.test_slits import SIDE, TEXELS, cut_plane
from properties.textured_planes import smoothed, texel_flow


class Sent:
    """Runs pieces in turn after they were sent through a pickle, as to other machines, and counts them."""

    def __init__(self):
        self.counts = []

    def run(self, pieces, values, iterations, progress):
        self.counts.append(len(pieces))
        assert sorted(np.concatenate([piece.owned for piece in pieces])) == list(range(len(values)))
        return InTurn(2).run(pickle.loads(pickle.dumps(pieces)), values, iterations, progress)


def wavy_surface(side, seed=0):
    """Vertices in an order without meaning, with edges of many lengths, walls, and a fin of three sheets."""
    random = np.random.default_rng(seed)
    flat, faces = surfaces.lattice(side, side)
    positions = np.column_stack(
        [flat[:, :2] + 0.2 * random.standard_normal((len(flat), 2)), 3 * np.sin(flat[:, 0] / 7)]
    )
    positions[:, 0] *= np.exp(flat[:, 1] / side)
    colours = 0.5 + 0.5 * (flat[:, :1] > side / 2) + 20 / 255 * random.standard_normal((len(flat), 3))
    last = len(positions)
    # A fin stands on a row of edges, and a double of some vertices beside them, as at hard edges, is joined by walls.
    foot = faces[:: side // 2]
    fin = np.column_stack([foot[:, 0], foot[:, 1], last + np.arange(len(foot))])
    positions = np.vstack([positions, positions[foot[:, 0]] + [0, 0, 1.0]])
    colours = np.vstack([colours, 1 - colours[foot[:, 0]]])
    doubles = np.arange(40)
    walls = np.column_stack([foot[doubles, 0], foot[doubles, 0], len(positions) + doubles])
    positions = np.vstack([positions, positions[foot[doubles, 0]]])
    colours = np.vstack([colours, colours[foot[doubles, 0]] + 0.3])
    order = random.permutation(len(positions))
    rank = np.argsort(order).astype(np.int32)
    return SampledSurface(
        np.ascontiguousarray(positions[order]),
        rank[np.vstack([faces, fin])],
        rank[walls],
        colours[order].clip(0, 1).astype(np.float32),
    )


def smooth_mesh(surface, parameters, progress=None, **others):
    """Return what comes of a mesh: its colours, and the result."""
    flow = BeltramiFlow(MeshManifold(surface, parameters, **others), parameters)
    result = flow.run(progress)
    return SimpleNamespace(colours=flow.values(), **vars(result))


SURFACE = wavy_surface(94)
FIXED = {"iterations": 2, "t": 1.2, "beta": 6.0, "beta_growth": 1.5, "metric_steps": 1, "threads": 2}
ON_MESHES = {
    "segments": {"solver": "segments"},
    "marching": {"solver": "fast-marching"},
    "areas": {"solver": "segments", "weights": "area", "iterations": 3},
    "world": {"solver": "segments", "units": "world", "metric_steps": 0, "beta": 0.0},
    "cut short": {"solver": "segments", "max_samples": 15},
}


@pytest.mark.parametrize("name", ON_MESHES)
def test_a_mesh_in_partitions_has_the_bits_of_the_whole(name):
    parameters = KernelParameters(**{**FIXED, **ON_MESHES[name]})
    random = np.random.default_rng(1)
    guides = [Guide("guide", random.random((len(SURFACE.positions), 2)).astype(np.float32), 2.0)]
    whole = smooth_mesh(SURFACE, parameters, guides=guides, metric_channels=[0, 1])
    assert not np.array_equal(whole.colours, SURFACE.colours)
    for count, made in ((2, 2), (9, 3)):  # three blocks, so not more pieces
        runner = Sent()
        with in_partitions(count, runner):
            parts = smooth_mesh(SURFACE, parameters, guides=guides, metric_channels=[0, 1])
        assert runner.counts[-1] == made
        assert np.array_equal(parts.colours, whole.colours)
        assert parts.samples_per_kernel == pytest.approx(whole.samples_per_kernel, rel=0.1)
        assert (parts.truncated > 0) == (whole.truncated > 0)


def test_kernels_that_are_too_large_for_groups_have_the_bits_of_the_whole_too():
    surface = wavy_surface(65)
    large = {"solver": "segments", "t": 32.0, "max_samples": 20, "iterations": 1}
    parameters = KernelParameters(**{**FIXED, **large})
    whole = smooth_mesh(surface, parameters)
    with in_partitions(2, InTurn(2)):
        parts = smooth_mesh(surface, parameters)
    assert np.array_equal(parts.colours, whole.colours)


@pytest.mark.parametrize("name", ["segments", "marching", "areas", "cut short"])
def test_pieces_that_are_too_narrow_are_found_out_and_cut_anew(name, monkeypatch):
    parameters = KernelParameters(**{**FIXED, **ON_MESHES[name]})
    whole = smooth_mesh(SURFACE, parameters)
    monkeypatch.setattr(mesh_partitions, "_EDGES_PER_SPACING", 0.5)  # the first guess is four edges
    runner = Sent()
    with in_partitions(3, runner):
        parts = smooth_mesh(SURFACE, parameters)
    assert len(runner.counts) > 1
    assert np.array_equal(parts.colours, whole.colours)


def test_parameters_are_chosen_on_the_whole():
    parameters = KernelParameters(free=("iterations", "t", "beta", "beta_growth", "metric_steps"), threads=2)
    whole = smooth_mesh(SURFACE, parameters)
    with in_partitions(4, InTurn(2)):
        parts = smooth_mesh(SURFACE, parameters)
    assert parts.choice == whole.choice
    assert np.array_equal(parts.colours, whole.colours)


def test_vertices_are_not_moved_in_partitions():
    geometry = GeometryParameters(np.arange(len(SURFACE.positions), dtype=np.int32))
    with in_partitions(2, InTurn(1)), pytest.raises(UsageError, match="not moved in pieces"):
        smooth_mesh(SURFACE, KernelParameters(**FIXED), geometry=geometry)


ON_GRIDS = {
    "sweep": {},
    "regularised": {"metric_scale": 1.0, "metric_steps": 2},
    "paper": {"scheme": "metric", "metric_steps": 0},
    "march": {"window": 17, "threshold": 0.1},
    "world": {"units": "world", "beta": 0.0},
}


@pytest.mark.parametrize("name", ON_GRIDS)
def test_a_texture_with_seams_and_slits_in_partitions_has_the_bits_of_the_whole(name):
    parameters = KernelParameters(**{**FIXED, **ON_GRIDS[name]})
    size = SIDE * TEXELS + 2
    atlas = build_atlas(cut_plane("aslant", True), [(size, size)], parameters.window // 2 + 3, 1)
    check_grid(lambda: texel_flow(atlas, noisy(len(atlas.owned_cells)), parameters), name)


@pytest.mark.parametrize("name", ON_GRIDS)
def test_an_image_with_holes_in_partitions_has_the_bits_of_the_whole(name):
    random = np.random.default_rng(5)
    valid = random.random((70, 90)) > 0.03
    positions = np.dstack([*np.meshgrid(np.arange(90.0), np.arange(70.0)), 3 * random.random((70, 90))])
    parameters = KernelParameters(**{**FIXED, **ON_GRIDS[name]})
    values = noisy(valid.size)
    check_grid(
        lambda: grid_flow(ImageSurface(None, positions, valid), lambda pixels: values[pixels], parameters),
        name,
    )


def noisy(count):
    random = np.random.default_rng(4)
    return (0.9 + 20 / 255 * random.standard_normal((count, 3))).clip(0, 1).astype(np.float32)


def check_grid(make, name):
    """The result and the gutter are those of the whole, and samples are counted exactly."""
    flow = make()
    whole, colours, gutter = flow.run(), flow.values(), flow.manifold.new_colours().beyond
    assert flow._clipped is not None or name == "world"
    for count in (1, 2, 5):
        runner = Sent()
        with in_partitions(count, runner):
            flow = make()
            parts = flow.run()
        assert runner.counts == [count]
        assert np.array_equal(flow.values(), colours)
        assert np.array_equal(flow.manifold.new_colours().beyond, gutter)
        assert parts.samples_per_kernel == whole.samples_per_kernel


def test_a_margin_that_is_one_cell_too_narrow_is_not_enough(monkeypatch):
    """So the test above would see it."""
    parameters = KernelParameters(**{**FIXED, "metric_scale": 1.0, "beta": 1.0})
    valid, values = np.ones((70, 90), bool), noisy(70 * 90)
    whole = smoothed(grid_flow(ImageSurface(valid=valid), lambda pixels: values[pixels], parameters))
    margin = GridManifold.margin.fget
    monkeypatch.setattr(GridManifold, "margin", property(lambda manifold: margin(manifold) - 2))
    with in_partitions(4, InTurn(2)):
        parts = smoothed(grid_flow(ImageSurface(valid=valid), lambda pixels: values[pixels], parameters))
    assert not np.array_equal(parts, whole)


def test_nothing_to_do_is_nothing_in_partitions_too():
    nothing = KernelParameters(**{**FIXED, "iterations": 0})
    values = noisy(30)
    with in_partitions(3, InTurn(1)):
        result = smoothed(
            grid_flow(ImageSurface(valid=np.ones((5, 6), bool)), lambda pixels: values[pixels], nothing)
        )
        mesh = smooth_mesh(SURFACE, nothing)
        empty = smoothed(
            grid_flow(
                ImageSurface(valid=np.zeros((5, 6), bool)),
                lambda pixels: values[pixels],
                KernelParameters(**FIXED),
            )
        )
    assert np.array_equal(result, values)
    assert np.array_equal(mesh.colours, SURFACE.colours)
    assert len(empty) == 0


class Share:
    """A piece that only owns and borrows."""

    threads = None

    def __init__(self, owned, borrowed):
        self.owned, self.borrowed = np.array(owned, np.int64), np.array(borrowed, np.int64)


def test_every_piece_is_lent_what_it_needs():
    shares = [Share([0, 3, 4], [1, 2, 7]), Share([1, 2], []), Share([5, 6, 7], [0, 2, 4])]
    values = np.random.default_rng(0).random((8, 2)).astype(np.float32)
    for share, loans in zip(shares, plan_loans(shares, 8), strict=True):
        lent = [values[shares[loan.lender].owned][loan.rows] for loan in loans]
        assert np.array_equal(collect(loans, lent, 2), values[share.borrowed])


def test_rings_are_numbers_of_edges():
    path = np.array([[0, 1], [1, 2], [2, 3], [3, 4], [5, 6]], np.int32)
    assert Neighbours(7, path).rings(0, 2, 2).tolist() == [0, 0, 1, 2, -1, -1, -1]
    assert Neighbours(3, np.zeros((0, 2), np.int32)).rings(1, 2, 5).tolist() == [-1, 0, -1]
