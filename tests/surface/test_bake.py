"""Baking: exact where it can be, first order elsewhere, and the same as by trying every texel."""

from __future__ import annotations

import numpy as np
import pytest

from beltrami_cli.surface.baking import (
    bake,
    border_faces,
    cover,
    interpolated,
    look_up,
    overlap,
    texels_for_vertices,
)
from beltrami_cli.surface.unwrap import unwrap
from oracles import surfaces

CLAMP = ("clamp", "clamp")


def spread(uv, size, corners):
    """Bake values at corners as floats."""
    return bake(
        uv, size, lambda faces, weights: interpolated(corners, faces, weights), corners.shape[2], np.float32
    )


def random_triangles(seed, count=40):
    """Triangles of many sizes, some flat, some far over the border of the texture."""
    random = np.random.default_rng(seed)
    uv = random.uniform(-0.3, 1.3, (count, 1, 2)) + random.normal(
        size=(count, 3, 2)
    ) * 10.0 ** random.uniform(-3, 0, (count, 1, 1))
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


@pytest.mark.parametrize("seed", range(3))
def test_weights_lead_back_to_the_centre_and_reach_gives_all_neighbours(seed):
    uv, size = random_triangles(seed), (37, 23)
    texels = {0.0: set(), 1.0: set()}
    for reach, seen in texels.items():
        for part in cover(uv, size, reach):
            one, two = part.weights.T[:, :, None]
            corners = uv[part.faces] * size
            place = (
                corners[:, 0] + one * (corners[:, 1] - corners[:, 0]) + two * (corners[:, 2] - corners[:, 0])
            )
            row, column = np.divmod(part.texels, size[0])
            assert np.allclose(place, np.stack([column, row], axis=1) + 0.5, atol=1e-4)
            mine = part.inside if reach == 0 else slice(None)
            seen |= {*zip(part.faces[mine].tolist(), column[mine].tolist(), row[mine].tolist(), strict=True)}
    around = {
        (face, x + dx, y + dy)
        for face, x, y in texels[0.0]
        for dx in (-1, 0, 1)
        for dy in (-1, 0, 1)
        if 0 <= x + dx < size[0] and 0 <= y + dy < size[1]
    }
    assert around <= texels[1.0]


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
    colours = (positions @ np.array([[0.02, 0.1, -0.1], [0.1, 0.0, 0.05], [0, 0, 0]]) + 0.5).astype(
        np.float32
    )
    image = spread(uv, (41, 33), colours[faces])
    seen = look_up(image, uv.reshape(-1, 2), CLAMP).reshape(-1, 3, 3)
    assert np.abs(seen - colours[faces]).max() < 1e-6


def test_smooth_colours_survive_the_way_to_a_texture_and_back():
    positions, faces = surfaces.icosphere(3)
    colours = (0.5 + 0.4 * np.sin(2 * positions)).astype(np.float32)
    made = unwrap(positions, faces, 256, 4, "sphere")
    seen = look_up(spread(made.uv, made.size, colours[faces]), made.uv.reshape(-1, 2), CLAMP).reshape(
        -1, 3, 3
    )
    # Linear interpolation is off by h^2 / 8 times the second derivative, which is up to 0.4 * 2 * 2, and a texel or an
    # edge long; a triangle beyond the border of a chart goes on in its own plane for a texel, which is twice as far.
    edge = surfaces.mean_edge_length(positions, faces)
    assert np.abs(seen - colours[faces]).max() < 1.6 * edge**2 / 2
    assert np.abs(seen - colours[faces]).mean() < 1.6 * edge**2 / 16


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
