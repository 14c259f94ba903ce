"""Surfaces to be smoothed as a whole and in chunks, and parameters that reach all that chunks could get wrong."""

import dataclasses
from types import SimpleNamespace

import numpy as np

from beltrami_cli.flow.beltrami_flow import smooth_in_place
from beltrami_cli.flow.chunks import IN_ONE_PIECE
from beltrami_cli.flow.corrections.clipping import clipped_on
from beltrami_cli.flow.decoding import plan_on_canvas
from beltrami_cli.flow.estimation import estimate_on_mesh
from beltrami_cli.flow.manifolds.guides import Guide
from beltrami_cli.flow.manifolds.mesh.manifold import ColouredMesh, mesh_manifold
from beltrami_cli.flow.plan import choose_parameters
from beltrami_cli.layers.image_surface import ImageSurface, canvas_of_image
from beltrami_cli.surface.atlas import build_atlas
from beltrami_cli.surface.records import SampledSurface
from oracles import surfaces
from properties.test_textures import SIDE, TEXELS, cut_plane
from properties.textured_planes import texel_plan

FIXED = {"iterations": 2, "t": 1.2, "beta": 6.0, "beta_growth": 1.5, "metric_steps": 1, "threads": 2}
ON_GRIDS = {
    "sweep": {},
    "regularised": {"metric_scale": 1.0, "metric_steps": 2},
    "paper": {"scheme": "metric", "metric_steps": 0},
    "march": {"window": 17, "threshold": 0.1},
    "world": {"units": "world", "beta": 0.0},
}


def noisy(count):
    random = np.random.default_rng(4)
    return (0.9 + 20 / 255 * random.standard_normal((count, 3))).clip(0, 1).astype(np.float32)


def textured_plan(parameters, resources=IN_ONE_PIECE):
    """Texels with seams, slits and a guide."""
    size = SIDE * TEXELS + 2
    atlas = build_atlas(cut_plane("aslant", True), [(size, 2 * size)], parameters.window // 2 + 3, 1)
    colours = noisy(len(atlas.owned_cells))
    guide = Guide("guide", colours[::-1, :1].copy(), 1.5)
    return texel_plan(atlas, colours, parameters, guides=[guide], metric_channels=[0, 2], resources=resources)


def image_plan(parameters, resources=IN_ONE_PIECE):
    """Pixels with holes."""
    random = np.random.default_rng(5)
    valid = random.random((70, 90)) > 0.03
    positions = np.dstack([*np.meshgrid(np.arange(90.0), np.arange(70.0)), 3 * random.random((70, 90))])
    values = noisy(valid.size)
    canvas = canvas_of_image(ImageSurface(None, positions, valid), lambda pixels: values[pixels], parameters)
    return plan_on_canvas(dataclasses.replace(canvas, resources=resources))


def wavy_surface(side):
    """Vertices in an order without meaning, with edges of many lengths, walls, and a fin of three sheets."""
    random = np.random.default_rng(0)
    flat, faces = surfaces.lattice(side, side)
    shaken = flat[:, :2] + 0.2 * random.standard_normal((len(flat), 2))
    positions = np.column_stack([shaken, 3 * np.sin(flat[:, 0] / 7)])
    positions[:, 0] *= np.exp(flat[:, 1] / side)
    colours = 0.5 + 0.5 * (flat[:, :1] > side / 2) + 20 / 255 * random.standard_normal((len(flat), 3))
    last = len(positions)
    # A fin stands on a row of edges, and a double of some vertices next to them, as at hard edges, is joined by walls.
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
    colours = colours[order].clip(0, 1).astype(np.float32)
    return SampledSurface(positions[order], rank[np.vstack([faces, fin])], rank[walls], colours)


SURFACE = wavy_surface(94)


def smooth_mesh(surface, parameters, progress=None, **others):
    """Return what comes of a mesh: its colours, and the result."""
    mesh = ColouredMesh.of(surface, parameters, **others)
    manifold = mesh_manifold(mesh, estimate_on_mesh(mesh))
    result = smooth_in_place(choose_parameters(manifold), progress)
    return SimpleNamespace(colours=result.manifold.new_colours().table(), **vars(result))


def outcome(plan):
    """Smooth a grid; return its colours, the gutter's, and the samples that a kernel held."""
    result = smooth_in_place(plan)
    new = result.manifold.new_colours()
    return new.table(), new.beyond, result.samples_per_kernel


def is_clipped(plan):
    return clipped_on(plan.manifold) is not None


def same_bits(one, other):
    return all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))
