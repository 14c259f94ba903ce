"""Noisy colours of vertices for training: images sampled at the vertices of flat meshes and point clouds."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Literal

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.spatial import Delaunay, cKDTree

from beltrami_cli.flow.noise.clusters import VertexClusters
from beltrami_cli.flow.vertex_graph import Graph
from clean_images import MakeImage, random_image
from noises import ONE_CHANNEL, NoisyColours, degrade, of_one_channel
from observations import NoisyChannels, cut_into
from recipes import DrawRecipe, Recipe

SIZES = 250, 20_000  # range of samples per surface
SURFACES = 96  # number of surfaces that images are sampled on
DENSITIES = 0.1, 3.0  # range of samples per texel
SIDES = 12, 280  # range of texels per side of an image
STRETCHED, MOST_STRETCHED = 0.4, 5.0  # share of surfaces, and the ratio of the densities along their axes
ON_VERTICES = 0.6  # share of surfaces whose noise was added to samples instead of images
SEED = 51


@cache
def surface(number: int) -> tuple[VertexClusters, np.ndarray]:
    """Return a surface, and the positions of its samples in the unit square, ascending along the first axis."""
    rng = np.random.default_rng([SEED, number])
    count = int(np.exp(rng.uniform(*np.log(SIZES))))
    kind = str(rng.choice(["jittered", "jittered", "random", "triangles", "squares", "cloud"]))
    side = int(np.sqrt(count)) + 1
    positions = _positions(rng, kind, side)
    if kind == "cloud":
        nearest = np.asarray(cKDTree(positions).query(positions, k=int(rng.integers(6, 11)))[1])
        pairs = np.stack([np.repeat(nearest[:, 0], nearest.shape[1] - 1), nearest[:, 1:].ravel()], axis=1)
    else:
        corners = Delaunay(positions).simplices
        pairs = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    edges = np.unique(np.sort(pairs, axis=1), axis=0).astype(np.int32)
    priorities = rng.integers(0, 2**63, len(positions), dtype=np.uint64)
    in_space = np.column_stack([positions, np.zeros(len(positions))])
    return VertexClusters.of(Graph(in_space, edges, priorities)), (positions / side).clip(0, 1)


def _positions(rng: np.random.Generator, kind: str, side: int) -> np.ndarray:
    """Draw positions in a square of a side, one per unit of area, ascending along the first axis."""
    positions = np.moveaxis(np.mgrid[:side, :side], 0, -1).reshape(-1, 2).astype(float)
    if kind in ("random", "cloud"):
        positions = rng.uniform(0, side, positions.shape)
    elif kind == "triangles":
        positions[:, 1] += positions[:, 0] % 2 / 2
    elif kind == "jittered":
        positions += rng.uniform(-1, 1, positions.shape) * rng.uniform(0.05, 0.5)
    positions += rng.normal(0, 1e-6, positions.shape)
    if kind != "triangles" and rng.random() < 0.3:  # denser on one side
        positions[:, 1] = side * (positions[:, 1].clip(0) / side) ** rng.uniform(1, 2)
    return positions[np.argsort(positions[:, 0], kind="stable")]


def random_channels(
    rng: np.random.Generator, crops: list[np.ndarray], draw: DrawRecipe, make_image: MakeImage = random_image
) -> NoisyChannels | None:
    """Draw noisy colours at vertices."""
    clusters, positions = surface(int(rng.integers(SURFACES)))
    density = np.exp(rng.uniform(*np.log(DENSITIES)))
    pixels = crops[rng.integers(len(crops))]
    side = np.clip(np.sqrt(len(positions) / density), SIDES[0], min(SIDES[1], *pixels.shape[:2]))
    recipe, is_on_vertices = draw(rng), rng.random() < ON_VERTICES
    # Samples may be denser along one axis than along the other, as on tubes and planks.
    stretch = np.exp(rng.uniform(-1, 1) * np.log(MOST_STRETCHED)) if rng.random() < STRETCHED else 1.0
    sides = np.ceil(
        side * np.array([stretch, 1 / stretch]) ** 0.5 / min(1, recipe.resampled * recipe.after_codec)
    )
    height, width = (int(each) for each in np.minimum(sides + 8, pixels.shape[:2]))
    top, left = int(rng.integers(len(pixels) - height + 1)), int(rng.integers(pixels.shape[1] - width + 1))
    clean = make_image(rng, pixels[top : top + height, left : left + width])
    if rng.random() < ONE_CHANNEL:
        clean, recipe = of_one_channel(clean, recipe)
    colours = degrade_at_vertices(rng, clean, positions, recipe, is_on_vertices=is_on_vertices)
    return cut_into(clusters, colours.mapped(lambda planes: planes.reshape(-1, 3)))


def degrade_at_vertices(
    rng: np.random.Generator,
    image: np.ndarray,
    positions: np.ndarray,
    recipe: Recipe,
    *,
    is_on_vertices: bool,
) -> NoisyColours:
    """Degrade an image and sample it by nearest or bilinear lookups, or add the noise to the samples."""
    of_image = replace(recipe, sigma=0.0, impulses=0.0) if is_on_vertices else recipe
    colours = degrade(rng, image, of_image)
    order: Literal[0, 1] = 1 if rng.integers(2) else 0
    at = positions.T * (np.array(colours.noisy.shape[:2])[:, None] - 1)
    colours = colours.mapped(lambda planes: _looked_up(planes, at, order))
    if is_on_vertices:
        return degrade(rng, colours.noisy[:, None], without_filters(recipe))
    return replace(colours, noisy=np.rint(colours.noisy * 255) / np.float32(255)) if recipe.bits else colours


def _looked_up(image: np.ndarray, at: np.ndarray, order: Literal[0, 1]) -> np.ndarray:
    if not image.any():
        return np.zeros((at.shape[1], 3), np.float32)
    planes = np.moveaxis(image, 2, 0)
    return np.stack([map_coordinates(each, at, order=order, mode="nearest") for each in planes], axis=-1)


def without_filters(recipe: Recipe) -> Recipe:
    """Return a recipe of only those steps that do not need a grid."""
    return Recipe(
        sigma=recipe.sigma, power=recipe.power, floor=recipe.floor, correlation=recipe.correlation, gains=recipe.gains,
        tail=recipe.tail, shape=recipe.shape, is_linear=recipe.is_linear, places=recipe.places,
        place_gain=recipe.place_gain, impulses=recipe.impulses, are_impulses_bright=recipe.are_impulses_bright,
        bits=recipe.bits,
    )  # fmt: skip
