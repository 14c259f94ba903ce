"""Baking and looking up agree with a renderer and with trying every texel; gutters take the nearest covered colour."""

from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from beltrami_cli import _native
from beltrami_cli.surface.baking import bake, interpolated, texels_for_vertices
from beltrami_cli.surface.coverage import border_faces, cover, overlap
from beltrami_cli.surface.gutters import fill_gutter
from beltrami_cli.surface.lookups import look_up, noise_around
from beltrami_cli.surface.unwrap import unwrap
from oracles import surfaces

CLAMP = ("clamp", "clamp")


def spread(uv, size, corners):
    """Bake values at corners as floats."""
    return bake(uv, size, partial(interpolated, corners), corners.shape[2], np.float32)


def random_triangles(seed, count=40):
    """Triangles of many sizes, some flat, some far over the border of the texture."""
    random = np.random.default_rng(seed)
    middle, size = random.uniform(-0.3, 1.3, (count, 1, 2)), 10.0 ** random.uniform(-3, 0, (count, 1, 1))
    uv = middle + size * random.normal(size=(count, 3, 2))
    uv[0, 2] = uv[0, 0]
    return uv


@pytest.mark.parametrize("seed", range(5))
def test_a_triangle_covers_exactly_the_texels_whose_centres_it_holds(seed):
    uv, (width, height) = random_triangles(seed), (37, 23)
    found = {
        (int(face), int(texel))
        for part in cover(uv, (width, height))
        for face, texel in zip(part.faces[part.inside], part.texels[part.inside], strict=True)
    }
    y, x = np.divmod(np.arange(width * height), width)
    points = np.stack([x + 0.5, y + 0.5], axis=1)
    for face, (a, b, c) in enumerate(uv * [width, height]):
        area = np.linalg.det([b - a, c - a])
        if area == 0:
            assert not any(f == face for f, _ in found)
            continue
        weights = [
            ((q - p)[0] * (points - p)[:, 1] - (q - p)[1] * (points - p)[:, 0]) / area
            for p, q in ((a, b), (b, c), (c, a))
        ]
        least = np.min(weights, axis=0)
        mine = np.array([(face, texel) in found for texel in range(width * height)])
        assert mine[least > 1e-6].all()
        assert not mine[least < -1e-6].any()


def test_border_faces_are_those_at_the_edge_of_a_chart():
    positions, faces = surfaces.plane(5, 5)
    uv = positions[faces][:, :, :2] / 4
    on_border = ((uv == 0) | (uv == 1)).any(axis=2).sum(axis=1) >= 2
    assert set(border_faces(uv)) <= set(np.flatnonzero(on_border))
    assert len(border_faces(uv)) == 14  # 16 edges around; the triangles of two corners have two each
    mirrored = np.concatenate([uv, uv[:, :, ::-1] + 2])
    assert len(border_faces(mirrored)) == 28


def test_a_constant_stays_exactly_what_it_is_everywhere():
    positions, faces = surfaces.icosphere(2)
    made = unwrap(positions, faces, 128, 4, "sphere")
    value = np.float32([0.1, 1 / 3, 0.7])
    image = spread(made.uv, made.size, np.tile(value, (len(faces), 3, 1)))
    assert (image == value).all()
    places = np.random.default_rng(0).uniform(-3, 3, (1000, 2))
    for wrap in (CLAMP, ("repeat", "mirror")):
        assert (look_up(image, places, wrap).astype(np.float32) == value).all()


def test_linear_colours_of_a_flat_chart_come_back_exactly_also_on_its_border():
    positions, faces = surfaces.plane(6, 6)
    uv = positions[faces][:, :, :2] / 5 * 0.5 + 0.25
    slopes = np.array([[0.02, 0.1, -0.1], [0.1, 0.0, 0.05], [0, 0, 0]])
    colours = (positions @ slopes + 0.5).astype(np.float32)
    image = spread(uv, (41, 33), colours[faces])
    seen = look_up(image, uv.reshape(-1, 2), CLAMP).reshape(-1, 3, 3)
    assert np.abs(seen - colours[faces]).max() < 1e-6


def test_slivers_do_not_throw_colours_far_beyond_their_corners():
    sliver = np.array([[[0.2, 0.5], [0.8, 0.5], [0.5, 0.5001]]])
    corners = np.array([[[0.4], [0.4], [0.6]]], np.float32)
    image = spread(sliver, (32, 32), corners)
    assert image.min() >= 0.2 - 1e-6
    assert image.max() <= 0.8 + 1e-6


def test_overlap_is_the_share_of_texels_at_several_places():
    positions, faces = surfaces.plane(5, 5)
    uv = positions[faces][:, :, :2] / 4
    assert overlap(uv, (64, 64)) == 0
    half = np.concatenate([uv * [0.5, 1], uv[:, :, ::-1] * [1, 1]])
    assert overlap(half, (64, 64)) == pytest.approx(0.5, abs=0.06)  # without the texels on edges


def test_texels_half_as_long_as_edges_are_asked_for_in_any_unit():
    positions, faces = surfaces.lattice(60, 60)  # triangles of side 1
    expected = 4 * len(faces) * 3**0.5 / 4
    for unit in (1, 1e300, 1e-300):
        assert texels_for_vertices(unit * positions, faces) == pytest.approx(expected)


@pytest.mark.parametrize("wrap", [CLAMP, ("repeat", "repeat"), ("mirror", "mirror"), ("repeat", "clamp")])
def test_lookups_beyond_the_image_follow_the_wrap_mode(wrap):
    random = np.random.default_rng(1)
    image = random.random((5, 7, 2)).astype(np.float32)
    modes = {"clamp": "edge", "repeat": "wrap", "mirror": "symmetric"}
    padded = np.pad(image, ((15, 15), (0, 0), (0, 0)), modes[wrap[1]])
    padded = np.pad(padded, ((0, 0), (21, 21), (0, 0)), modes[wrap[0]])
    uv = random.uniform(-2.4, 3.4, (500, 2))
    repeated = (uv + 3) / 7  # the same place in the image that is continued
    assert np.allclose(look_up(image, uv, wrap), look_up(padded, repeated, CLAMP), atol=1e-6)


def test_a_lookup_at_a_centre_gives_that_texel():
    image = np.random.default_rng(2).random((4, 6, 3)).astype(np.float32)
    y, x = np.mgrid[:4, :6]
    uv = np.stack([(x + 0.5) / 6, (y + 0.5) / 4], axis=-1).reshape(-1, 2)
    assert np.allclose(look_up(image, uv, CLAMP).reshape(image.shape), image, atol=1e-6)


def test_invisible_texels_lend_no_colour():
    image = np.array([[[0.2, 0.4, 0.6, 1.0], [9.0, 9.0, 9.0, 0.0]]], np.float32)
    halfway = look_up(image, np.array([[0.5, 0.5]]), CLAMP, alpha=3)[0]
    assert np.allclose(halfway, [0.2, 0.4, 0.6, 0.5])


def test_noise_is_found_and_planes_have_none():
    y, x = np.mgrid[:64, :64] / 64
    plane = np.stack([x, y, x + y], axis=-1).astype(np.float32)
    uv = np.random.default_rng(3).uniform(0.1, 0.9, (2000, 2))
    assert np.abs(noise_around(plane, uv, CLAMP)).max() < 1e-5
    noisy = plane + np.random.default_rng(4).normal(0, 0.05, plane.shape).astype(np.float32)
    assert noise_around(noisy, uv, CLAMP).std() == pytest.approx(0.05, rel=0.1)


@pytest.mark.slow
@given(
    st.integers(0, 2**32 - 1), st.integers(1, 40), st.integers(1, 40), st.floats(0.001, 1), st.floats(0.01, 1),
    st.integers(0, 80),
)  # fmt: skip
@settings(max_examples=300, deadline=None)
def test_the_nearest_mark_is_the_nearest(seed, height, width, density, wish, reach):
    random = np.random.default_rng(seed)
    marked, wanted = random.random((height, width)) < density, random.random((height, width)) < wish
    texels, marks = _native.nearest_marked(marked, wanted, reach, 2)
    distance = ndimage.distance_transform_edt(~marked) if marked.any() else np.full(marked.shape, np.inf)
    assert np.array_equal(texels, np.flatnonzero(wanted & (distance <= reach)))
    assert marked.ravel()[marks].all()
    (y, x), (rows, columns) = np.divmod(texels, width), np.divmod(marks, width)
    assert np.array_equal((rows - y) ** 2 + (columns - x) ** 2, np.rint(distance.ravel()[texels] ** 2))


def filled_gutter(pixels, *arguments, **options):
    filled = pixels.copy()
    fill_gutter(filled, *arguments, **options)
    return filled


@pytest.fixture
def picture():
    pixels = np.random.default_rng(3).integers(0, 256, (30, 40, 3), dtype=np.uint8)
    covered = np.zeros((30, 40), bool)
    covered[10:20, 5:15] = True
    return pixels, covered


def test_only_texels_within_the_width_are_filled(picture):
    pixels, covered = picture
    filled = filled_gutter(pixels, covered, 3)
    distance, (rows, columns) = ndimage.distance_transform_edt(~covered, return_indices=True)
    assert filled.dtype == pixels.dtype
    assert np.array_equal(filled[distance <= 3], pixels[rows, columns][distance <= 3])
    assert np.array_equal(filled[distance > 3], pixels[distance > 3])


def test_without_a_width_all_texels_are_filled_whatever_is_not_known(picture):
    pixels, covered = picture
    known = np.ones_like(covered)
    known[:, :25] = False
    filled = filled_gutter(pixels, covered, None, known)
    assert np.array_equal(filled[:, 25:], pixels[:, 25:])
    assert np.array_equal(filled[0, 0], pixels[10, 5])
    assert np.array_equal(filled[29, 24], pixels[19, 14])


def test_known_texels_keep_their_colours_and_lend_none(picture):
    pixels, covered = picture
    known = np.zeros_like(covered)
    known[10:20, 15] = True
    filled = filled_gutter(pixels, covered, 4, known)
    assert np.array_equal(filled[known], pixels[known])
    assert np.array_equal(filled[12, 16], pixels[12, 14])


@pytest.mark.parametrize("width", [3, 40])
def test_bands_of_rows_give_what_their_surroundings_give_alone(width):
    """A texture of more rows than are looked at together, and the rows where one band ends and another begins."""
    random = np.random.default_rng(7)
    pixels = random.integers(0, 256, (1200, 40, 3), dtype=np.uint8)
    covered = random.random((1200, 40)) > 0.97
    whole = filled_gutter(pixels, covered, width, channels=[0, 2])
    assert np.array_equal(whole[..., 1], pixels[..., 1])
    assert not np.array_equal(whole, pixels)
    for first in range(0, 1200, 50):
        around = slice(max(0, first - width), first + 50 + width)
        alone = filled_gutter(pixels[around], covered[around], width, channels=[0, 2])
        inside = slice(first - around.start, first - around.start + 50)
        assert np.array_equal(alone[inside], whole[first : first + 50])
