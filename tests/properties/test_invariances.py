"""What no kind of layer depends on: threads, instruction sets, frame, unit, order of samples and of channels."""

from __future__ import annotations

import functools
from itertools import combinations, cycle
from typing import Any, NamedTuple

import numpy as np
import pytest

import beltrami_cli
from beltrami_cli._native import sweep_instruction_set
from beltrami_cli.flow.parameters import PRESETS
from beltrami_cli.jobs.noise.kinds import NumberedSamples, add_grain
from beltrami_cli.jobs.settings import NoiseSettings
from beltrami_cli.layers.image_surface import ImageSurface
from oracles import surfaces
from properties import textured_planes
from properties.manifolds import require_same
from properties.textured_planes import Board

ROWS, COLUMNS = 20, 26
TURN = np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))[0]
# Given, so that they are not chosen from the data, which differ between the two sides of a comparison.
FIXED = {"iterations": 3, "t": 2.0, "beta": 8.0, "beta_growth": 2.0, "metric_steps": 2}
# Turned, mirrored, and each in another corner of the image.
BOARD = Board(8, 6, 4, 32, 2, [(1, 1, 1, False), (0, 0, 2, True), (0, 1, 3, False), (1, 0, 1, False)])


class Scene(NamedTuple):
    """Colours on a surface, and a way to smooth them; only `changed` samples may change."""

    smooth: Any
    positions: np.ndarray
    faces: np.ndarray | None
    colours: np.ndarray
    changed: Any = slice(None)


def mesh(with_grain=False, faces=True, **parameters):
    # The correlation of grain is found on more vertices than other noise.
    rows, columns = (30, 40) if with_grain else (ROWS, COLUMNS)
    positions, triangles = surfaces.terrain(rows, columns, 0.3, 1)
    colours = np.where(positions[:, :1] > 15, [[0.8, 0.3, 0.2]], [[0.2, 0.4, 0.7]])
    if with_grain:
        noise = NoiseSettings(kind="grain", sigma=20 / 255, grain_size=2.0)
        targets = NumberedSamples(colours.astype(np.float32), np.arange(len(colours)))
        colours = add_grain(targets, positions, np.ones(len(colours)), noise)
    else:
        colours = colours + np.random.default_rng(8).normal(0, 20 / 255, colours.shape)

    def smooth(positions, faces, colours, **others):
        result = beltrami_cli.smooth(positions, faces, colours, **{**parameters, **others})
        return result.colours if result.positions is None else np.hstack([result.colours, result.positions])

    return Scene(smooth, positions, triangles if faces else None, colours.clip(0, 1).astype(np.float32))


def image(**parameters):
    y, x = np.mgrid[:ROWS, :COLUMNS]
    places = np.dstack([x, y, 3 * np.sin(x / 3) * np.cos(y / 4)])
    measured = np.ones((ROWS, COLUMNS), bool)
    measured[10:14, 20:30] = False

    def smooth(positions, _, colours, **others):
        surface = ImageSurface(positions=positions.reshape(ROWS, COLUMNS, -1), valid=measured)
        pixels = colours.reshape(ROWS, COLUMNS, -1)
        result = beltrami_cli.smooth_image(pixels, surface=surface, **{**parameters, **others})
        return result.colours.reshape(colours.shape)

    colours = textured_planes.phantom(COLUMNS)[:ROWS].clip(0, 1).astype(np.float32)
    return Scene(smooth, places.reshape(-1, 3), None, colours.reshape(-1, 3), measured.ravel())


def texture(**parameters):
    surface, size = BOARD.surface(), BOARD.size

    def smooth(positions, faces, colours, space=None, **others):
        own = textured_planes.textured(positions, faces, surface.uv)
        pixels = colours.reshape(size, size, -1)
        smoothed, _ = textured_planes.smooth_image(own, pixels, **{**parameters, **others})
        return smoothed.reshape(colours.shape)

    colours = BOARD.image_of(textured_planes.phantom(48)).astype(np.float32)
    covered = np.zeros((size, size), bool)
    covered[BOARD.texel_places()] = True
    return Scene(smooth, surface.positions, surface.faces, colours.reshape(-1, 3), covered.ravel())


SCENES = {
    "mesh": mesh, "mesh with segments": functools.partial(mesh, **FIXED, solver="segments"),
    "mesh with fast marching": functools.partial(mesh, **FIXED, solver="fast-marching"),
    "mesh with patches": functools.partial(mesh, **FIXED, patches="on"),
    "mesh with grain": functools.partial(mesh, with_grain=True),
    "cloud": functools.partial(mesh, faces=False), "image": image,
    "image with sweeps": functools.partial(image, **FIXED),
    "image with marches": functools.partial(image, **{**FIXED, "window": 17, "t": 5.0}),
    "image with patches": functools.partial(image, **FIXED, patches="on"),
    "image of the paper": functools.partial(image, **{**PRESETS["paper"], "beta": 8.0}),
    "texture": functools.partial(texture, **FIXED),
    "texture with patches": functools.partial(texture, **FIXED, patches="on"),
}  # fmt: skip


MOVING = {"geometry": functools.partial(mesh, **FIXED, smooth_geometry=True)}
ON_TRIANGLES = [kind for kind in SCENES if "mesh" in kind]
CHOSEN = (
    "mesh",
    "mesh with grain",
    "cloud",
    "image",
)  # whose parameters are chosen, which takes most of the time


def each(*kinds):
    marks = dict.fromkeys(CHOSEN, pytest.mark.slow)
    return pytest.mark.parametrize("kind", [pytest.param(kind, marks=marks.get(kind, ())) for kind in kinds])


@functools.cache
def scene(kind):
    return (SCENES | MOVING)[kind]()


@functools.cache
def smoothed(kind):
    own = scene(kind)
    result = own.smooth(own.positions, own.faces, own.colours, threads=1)
    assert np.abs(result[:, :3] - own.colours)[own.changed].max() > 0.01
    return result


@each(*SCENES, *MOVING)
def test_the_result_is_the_same_to_the_last_bit_on_any_threads_and_instruction_set(kind, monkeypatch):
    own = scene(kind)
    sets = []
    for name in ("x86-64-v4", "x86-64-v3", "baseline"):
        monkeypatch.setenv("BELTRAMI_SIMD", name)
        try:
            sets.append(sweep_instruction_set())
        except ValueError:
            continue  # this machine does not have it
    # Against one thread with the first set.
    for threads, name in zip((2, 5), cycle(sets[1:] or sets)):
        monkeypatch.setenv("BELTRAMI_SIMD", name)
        result = own.smooth(own.positions, own.faces, own.colours, threads=threads)
        assert np.array_equal(result, smoothed(kind)), (threads, name)


FRAMES = {
    "turned, mirrored and tiny": lambda positions: 1e-9 * positions * [1, 1, -1] @ TURN,
    "large and far away": lambda positions: 1000 * positions + [1e6, -1e5, 7],
}


@pytest.mark.uninstrumented
@pytest.mark.parametrize("frame", FRAMES)
@each(*SCENES)
def test_frame_and_unit_of_length_make_no_difference(kind, frame):
    own, move = scene(kind), FRAMES[frame]
    result = own.smooth(move(own.positions), own.faces, own.colours, threads=2)
    require_same(result, smoothed(kind))


@pytest.mark.uninstrumented
@each(*(kind for kind in SCENES if kind != "cloud" and "texture" not in kind))
def test_meshes_and_images_may_lie_in_more_dimensions(kind):
    own = scene(kind)
    five = own.positions @ np.linalg.qr(np.ones((5, 5)) + np.eye(5))[0][:3]
    require_same(own.smooth(five, own.faces, own.colours, threads=2), smoothed(kind))


@each(*ON_TRIANGLES, "cloud")
def test_the_order_of_vertices_and_faces_makes_no_difference(kind):
    own, random = scene(kind), np.random.default_rng(0)
    order = random.permutation(len(own.positions))
    faces = own.faces
    if faces is not None:
        faces = random.permutation(np.roll(np.argsort(order)[faces], 1, axis=1))
    result = own.smooth(own.positions[order], faces, own.colours[order], threads=2)
    require_same(result, smoothed(kind)[order])


@each(*ON_TRIANGLES)
def test_vertices_that_a_format_splits_make_no_difference(kind):
    """Although copies differ by rounding, as numbers in single precision that were turned or read from text."""
    own = scene(kind)
    corners = own.faces.ravel()
    apart = np.arange(len(corners)).reshape(-1, 3)
    places = own.positions[corners].astype(np.float32)
    places += np.spacing(places.max()) / 2 * np.random.default_rng(8).integers(-1, 2, places.shape)
    result = own.smooth(places, apart, own.colours[corners], threads=2)
    require_same(result, smoothed(kind)[corners])


# With patches on grids, what the blend is perturbed by is drawn channel by channel.
ON_GRIDS = ["image with sweeps", "image of the paper", "texture"]


@pytest.mark.uninstrumented
@each(*ON_TRIANGLES, "cloud", *ON_GRIDS)
def test_the_order_of_channels_makes_no_difference(kind):
    own = scene(kind)
    result = own.smooth(own.positions, own.faces, own.colours[:, [2, 0, 1]], threads=2)
    require_same(result, smoothed(kind)[:, [2, 0, 1]])


@each(*SCENES)
def test_constants_stay_and_colours_stay_within_the_range_around_them(kind):
    own = scene(kind)
    constant = np.broadcast_to(np.float32([0.2, 0.4, 0.9]), own.colours.shape)
    assert np.array_equal(own.smooth(own.positions, own.faces, constant), constant)
    # Without linear light, and without what restores colours that were cut off.
    result = own.smooth(own.positions, own.faces, own.colours, space="data", clipping="keep", patches="off")
    seen, before = result[own.changed], own.colours[own.changed]
    assert (seen >= before.min(axis=0) - 1e-6).all()
    assert (seen <= before.max(axis=0) + 1e-6).all()
    kept = np.delete(np.arange(len(result)), np.arange(len(result))[own.changed])
    assert np.array_equal(result[kept], own.colours[kept])


@each(*(kind for kind in SCENES if "patches" not in kind))
def test_without_beta_the_kernel_is_linear(kind):
    """A Gaussian on the surface that colours have no part in, however large their jumps are, also at seams."""
    own, random = scene(kind), np.random.default_rng(4)
    a, b = random.random((2, *own.colours.shape), np.float32)
    a[len(a) // 2 :] += 2
    b[::2] -= 3
    linear = {"beta": 0.0, "iterations": 3, "space": "data"}
    total, of_a, of_b = (own.smooth(own.positions, own.faces, each, **linear) for each in (2 * a - b, a, b))
    # Float32 sums of some 50 terms up to 7, over three iterations.
    np.testing.assert_allclose(total, 2 * of_a - of_b, atol=2e-5)


@pytest.mark.slow
def test_every_setting_counts():
    """Or that nothing depends on threads, frame or order would show little."""
    for surface in ("mesh", "image", "texture"):
        for one, other in combinations([kind for kind in SCENES if surface in kind], 2):
            assert not np.array_equal(smoothed(one), smoothed(other)), (one, other)
