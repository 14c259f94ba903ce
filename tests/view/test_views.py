"""Views have the geometry, the brightness by the law of the lamp, and the colours of the model."""

import dataclasses

import numpy as np
import pytest

from beltrami_cli.surface.colour_values import linear_to_srgb
from beltrami_cli.surface.geometry import triangle_areas
from beltrami_cli.surface.records import Texture, TexturedSurface
from beltrami_cli.view.drawing.arranging import Panel, arranged, displayed
from beltrami_cli.view.drawing.cameras import fitted, framed, orientation, within_reach
from beltrami_cli.view.drawing.cloud_view import CloudView, draw_discs
from beltrami_cli.view.drawing.image_view import ImageView
from beltrami_cli.view.drawing.panels import draw_views, is_lost_on_white, most_detailed_window
from beltrami_cli.view.drawing.surface_colours import InterpolatedColours, TextureColours
from beltrami_cli.view.drawing.surface_view import AMBIENT, LAMP, SurfaceView
from beltrami_cli.view.render import distinct_labels
from beltrami_cli.view.settings import DEFAULT_RENDER, RenderSettings
from oracles import surfaces

pytest.importorskip("embreex")

FRONT = orientation(0, 0)
FILLED = 0.92  # of a view
WHOLE, INSIDE = (0.0, 0.0, 1.0, 1.0), (0.2, 0.2, 0.8, 0.8)


def square(z=0.0):
    corners = np.array([[-1.0, -1, z], [1, -1, z], [1, 1, z], [-1, 1, z]])
    return corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32)


def textured_square(sheet, alpha_hides=True, is_backed=False):
    """Return a view of a square, perhaps with one behind it that has no texture."""
    corners, faces = square()
    if is_backed:
        corners, faces = np.concatenate([corners, square(-1.0)[0]]), np.concatenate([faces, faces + 4])
    uv = ((corners[:, :2] * (1, -1) + 1) / 2)[faces]
    texture = Texture("0", "a.png", b"", wrap=("clamp", "clamp"), alpha_hides=alpha_hides)
    surface = TexturedSurface(corners, faces, uv, np.int32([0, 0, -1, -1])[: len(faces)], (texture,))
    colours = TextureColours(surface, [sheet.astype(np.float32)], triangle_areas(corners, faces))
    return SurfaceView(corners, faces, colours)


def front_camera(view, field=0.0):
    return fitted(view.positions, FRONT, field, 1.0)


def seen_from_the_front(view, side, window=INSIDE):
    return view.draw(front_camera(view), (side, side), window, lit=False)


def sphere(colour=1.0):
    positions, faces = surfaces.icosphere(5)
    colours = InterpolatedColours(faces, np.full((len(positions), 3), colour))
    return SurfaceView(positions, faces, colours), surfaces.mean_edge_length(positions, faces)


@pytest.mark.slow
@pytest.mark.parametrize("field", [0.0, 40.0])
def test_the_silhouette_of_a_sphere_has_the_area_of_its_disc(field):
    view, edge = sphere()
    camera = front_camera(view, field)
    image = view.draw(camera, (200, 200), WHOLE, lit=False)
    # Lines from the eye at distance d touch the unit sphere under the angle asin(1 / d).
    radius = 1.0 if field == 0 else np.tan(np.arcsin(1 / camera.place[2]))
    area = np.pi * radius**2 / (4 * camera.reach[0] * camera.reach[1])
    # Chords lie inside the sphere by up to edge^2 / 8, its outline is cut by some 500 pixels of 9 rays each.
    assert image[..., 3].mean() == pytest.approx(area, rel=edge**2 / 4 + 1e-3)
    assert image[..., :3] == pytest.approx(np.repeat(image[..., 3:], 3, axis=2))  # unlit, so white all over


def test_a_sphere_is_shaded_as_the_law_of_the_lamp_says():
    view, edge = sphere(0.5)
    camera = front_camera(view)
    image = view.draw(camera, (101, 101), WHOLE, lit=True)
    at = (np.arange(101) + 0.5) / 101 * 2 - 1
    x, y = np.meshgrid(at * camera.reach[0], -at * camera.reach[1])
    inside = x**2 + y**2 < 0.8  # further out a pixel covers a wide range of normals
    normals = np.stack([x, y, np.sqrt(np.where(inside, 1 - x**2 - y**2, 1))], axis=2)
    law = 0.5 * (AMBIENT + (1 - AMBIENT) * np.maximum(normals @ LAMP, 0))
    # Normals are interpolated linearly between exact ones; where the law has its kink, n . l = 0, the mean over a pixel
    # is off by an eighth of what n changes across it.
    kink = 0.5 * (1 - AMBIENT) * 2 * camera.reach[0] / 101 / np.sqrt(1 - 0.8) / 8
    assert np.abs(image[..., 0] - law)[inside].max() < kink + 0.5 * edge**2 < 0.003
    assert law[inside].min() < 0.2 < 0.45 < law[inside].max()


@pytest.mark.parametrize("field", [0.0, 30.0])
def test_a_texture_that_faces_the_camera_is_reproduced_pixel_by_pixel(field):
    rng = np.random.default_rng(1)
    light = rng.random((64, 64, 3))
    view = textured_square(np.dstack([light, np.ones((64, 64))]))
    edge = (1 - FILLED) / 2
    image = view.draw(front_camera(view, field), (64, 64), (edge, edge, 1 - edge, 1 - edge), lit=False)
    # Bilinear lookups a third of a texel apart weigh the texel with 7/9, and its neighbours with 1/9, on each axis.
    expected = light
    for axis in (0, 1):
        near = np.pad(expected, [(1, 1) if k == axis else (0, 0) for k in range(3)], mode="edge")
        low, high = (np.take(near, np.arange(64) + step, axis=axis) for step in (0, 2))
        expected = (low + 7 * expected + high) / 9
    assert image[..., :3] == pytest.approx(expected, abs=2e-5)  # single precision of rays


def test_a_texture_seen_from_afar_is_averaged_and_not_sampled():
    checks = np.indices((256, 256)).sum(axis=0) % 2
    sheet = np.dstack([checks] * 3 + [np.ones_like(checks)])
    image = seen_from_the_front(textured_square(sheet), 16, (0.1, 0.1, 0.9, 0.9))
    assert image[..., 0] == pytest.approx(np.full((16, 16), 0.5), abs=0.02)


def test_what_is_transparent_shows_what_is_behind():
    half = np.full((4, 4, 4), 0.5)
    half[..., :3] = (1.0, 0, 0)
    front = textured_square(half)
    alone = seen_from_the_front(front, 9)
    assert alone == pytest.approx(np.broadcast_to([0.5, 0, 0, 0.5], (9, 9, 4)), abs=1e-6)
    backed = textured_square(half, is_backed=True)
    seen = backed.draw(front_camera(front), (9, 9), INSIDE, lit=False)
    grey = seen[4, 4, 1] / 0.5  # of what has no texture
    assert seen == pytest.approx(
        np.broadcast_to([0.5 + grey / 2, grey / 2, grey / 2, 1], (9, 9, 4)), abs=1e-6
    )
    opaque = textured_square(half, alpha_hides=False)
    assert seen_from_the_front(opaque, 4)[..., 3].min() == 1


def test_half_covered_pixels_are_mixed_in_light_and_whole_ones_keep_every_byte():
    greys = np.arange(256) / 255
    light = np.where(greys <= 0.04045, greys / 12.92, ((greys + 0.055) / 1.055) ** 2.4)
    view = np.dstack([np.tile(light, (4, 1))] * 3 + [np.ones((4, 256))]).astype(np.float32)
    shown = arranged([[Panel(view)]], DEFAULT_RENDER.background_colour())
    assert (shown == np.tile(np.arange(256)[None, :, None], (4, 1, 3))).all()
    half = np.zeros((1, 1, 4), np.float32)
    half[..., 3] = 0.5
    assert displayed(half, DEFAULT_RENDER.background_colour())[0, 0, 0] == pytest.approx(linear_to_srgb(0.5))
    clear = displayed(half, (1.0, 1.0, 1.0, 0.0))
    assert clear[0, 0].tolist() == [0, 0, 0, 0.5]


@pytest.mark.parametrize("field", [0.0, 30.0, 90.0])
@pytest.mark.parametrize("aspect", [0.5, 1.0, 2.0])
def test_a_fitted_camera_sees_all_points_and_they_fill_its_view(field, aspect):
    rng = np.random.default_rng(7)
    for up in "xyz":
        points = rng.normal(size=(200, 3)) * rng.uniform(0.1, 5, 3) + 1e4
        camera = fitted(points, orientation(33, -20, up), field, aspect)
        places, depths = camera.project(points)
        assert depths.min() > 0
        reach = np.abs(places - 0.5).max(axis=0) * 2
        assert reach.max() == pytest.approx(FILLED, abs=1e-6)
        starts, directions = camera.rays(places[:, 0], places[:, 1])
        along = np.einsum("kx,kx->k", points - starts, directions)
        assert starts + along[:, None] * directions == pytest.approx(points, abs=1e-7)


def with_outlier(positions, faces, gap, is_connected=False):
    """Add a triangle of a hundredth of the width of a model, beyond its right border by a share of its width."""
    low, high = positions.min(axis=0), positions.max(axis=0)
    width = high[0] - low[0]
    right = high + np.array([gap, -0.5, -0.5]) * width
    corners = right + np.array([[0, 0, 0], [0.01, 0, 0], [0, 0.01, 0]]) * width
    faces = np.concatenate([faces, len(positions) + np.array([[0, 1, 2]])])
    if is_connected:
        faces = np.concatenate([faces, [[0, len(positions), len(positions) + 1]]])
    return np.concatenate([positions, corners]), faces


@pytest.mark.parametrize("scale", [1.0, 1e198])
@pytest.mark.parametrize(
    ("gap", "is_connected", "is_framed"),
    [(100.0, False, False), (0.6, False, False), (0.3, False, True), (3.0, True, True)],
)
def test_views_frame_the_surface_and_not_its_outliers(scale, gap, is_connected, is_framed):
    positions, faces = surfaces.icosphere(3)
    farther, more = with_outlier(positions, faces, gap, is_connected)
    shown = framed(farther * scale, more.astype(np.int32)) / scale
    assert np.allclose(shown, farther if is_framed else positions)


def test_points_that_nothing_is_near_are_outliers_unless_they_are_many():
    cloud = np.random.default_rng(3).uniform(0, 1, (1000, 3))
    no_faces = np.zeros((0, 3), np.int32)
    for count in (4, 20):
        shown = framed(np.concatenate([cloud, np.full((count, 3), 9.0), [[np.nan, 0, 0]]]), no_faces)
        assert len(shown) == 1000 + count * (count == 20)
    assert len(framed(np.zeros((3, 3)), np.array([[0, 1, 2]], np.int32))) == 3


def test_presets_look_where_they_say():
    assert orientation(0, 0)[2].tolist() == [0, 0, 1]  # the eye of the front is on +z
    assert orientation(90, 0)[2] == pytest.approx([1, 0, 0], abs=1e-12)
    assert orientation(0, 90)[2] == pytest.approx([0, 1, 0], abs=1e-12)
    assert orientation(0, 0, "z")[1].tolist() == [0, 0, 1]
    for up in "xyz":
        turned = orientation(25, 40, up)
        assert turned @ turned.T == pytest.approx(np.eye(3), abs=1e-12)
        assert np.linalg.det(turned) == pytest.approx(1)


def test_an_image_at_its_own_size_is_passed_through_and_enlarged_in_squares():
    sheet = np.random.default_rng(3).random((12, 20, 4)).astype(np.float32)
    sheet[..., 3] = 1
    view = ImageView(sheet)
    framed = view.draw((20, 20), WHOLE)
    assert framed[4:16] == pytest.approx(sheet, abs=1e-6)
    assert framed[:4].max() == 0
    large = view.draw((80, 80), WHOLE)
    assert large[16:64] == pytest.approx(sheet.repeat(4, axis=0).repeat(4, axis=1), abs=1e-6)


@pytest.mark.parametrize("shape", [(30, 90), (90, 30), (50, 50)])
def test_an_image_fills_a_view_of_the_size_within_another(shape):
    view = ImageView(np.ones((*shape, 4), np.float32))
    size = view.size_within((60, 60))
    assert max(size) == 60
    assert view.draw(size, WHOLE)[..., 3].min() == 1


def test_a_detail_shows_what_its_frame_holds_in_more_pixels():
    rng = np.random.default_rng(5)
    view = textured_square(np.dstack([rng.random((40, 40, 3)), np.ones((40, 40))]))
    camera = front_camera(view, 30.0)
    large = view.draw(camera, (120, 120), WHOLE, lit=True)
    detail = view.draw(camera, (30, 30), (0.25, 0.5, 0.5, 0.75), lit=True)
    assert detail == pytest.approx(large[60:90, 30:60], abs=1e-4)


def test_windows_beyond_the_model_are_empty_and_an_eye_within_it_sees_all_around():
    view, _ = sphere()
    camera = front_camera(view, 30.0)
    assert not view.draw(camera, (20, 20), (1.5, 0.0, 2.5, 1.0), lit=False).any()
    left = view.draw(camera, (20, 20), (-0.5, 0.0, 0.5, 1.0), lit=False)
    right = view.draw(camera, (20, 20), (0.5, 0.0, 1.5, 1.0), lit=False)
    assert np.array_equal(left[..., 3], right[:, ::-1, 3])
    assert 0.2 < left[..., 3].mean() < 0.5
    within = dataclasses.replace(camera, place=np.zeros(3))
    assert (view.draw(within, (20, 20), WHOLE, lit=False) == 1).all()


def test_the_richest_window_is_where_the_contrast_is():
    view = np.full((80, 100, 4), 0.5, np.float32)
    view[..., 3] = 1
    view[30:46, 60:76, :3] = np.indices((16, 16)).sum(axis=0)[..., None] % 2
    left, upper, right, lower = most_detailed_window(view, 0.2)
    assert (left * 100, upper * 80, right * 100, lower * 80) == pytest.approx((60, 30, 76, 46))
    view[30:46, 60:76, 3] = 0  # where nothing is, nothing is to be seen
    view[..., :3] *= view[..., 3:]
    left, upper, right, lower = np.array(most_detailed_window(view, 0.2)) * [100, 80, 100, 80]
    assert not (left < 76 and right > 60 and upper < 46 and lower > 30)


@pytest.mark.slow
@pytest.mark.parametrize("scale", [1e-198, 1e198, 1e300])
@pytest.mark.parametrize("with_faces", [True, False])
def test_models_of_any_size_look_alike(scale, with_faces):
    power = 2.0 ** round(np.log2(scale))  # so that no coordinate is rounded in another way
    looks = RenderSettings(size=(48, 48), lit=True)
    pictures = []
    for factor in (1.0, power):
        positions, faces = surfaces.icosphere(2)
        places = within_reach(positions * factor)
        grey = np.repeat(np.linspace(0, 1, len(positions))[:, None], 3, axis=1)
        view = (
            SurfaceView(places, faces, InterpolatedColours(faces, grey))
            if with_faces
            else CloudView(places, grey)
        )
        pictures.append(draw_views([view], [""], looks))
    assert np.ptp(pictures[0]) > 200
    assert np.array_equal(pictures[0], pictures[1])


@pytest.mark.parametrize("place", [0.0, 5.0, 1e198])
@pytest.mark.parametrize("field", [0.0, 30.0])
def test_a_single_point_is_seen_in_the_middle(place, field):
    view = CloudView(np.full((3, 3), place), np.zeros((3, 3)))
    looks = RenderSettings(size=(51, 51), fov=field)
    picture = draw_views([view], [""], looks)
    assert picture[25, 25].max() == 0
    assert (picture == 255).mean() > 0.9


def test_what_would_be_lost_on_white_is_shown_on_grey():
    settings = RenderSettings(size=(64, 64))
    grey, white = [128] * 3, [255] * 3

    def behind(view, **looks):
        return draw_views([view], [""], dataclasses.replace(settings, **looks))[0, 0].tolist()

    bright, pale, dim = sphere()[0], sphere(0.8)[0], sphere(0.5)[0]
    assert behind(bright) == behind(pale) == grey
    assert behind(dim) == white
    assert behind(bright, background="white") == white
    # A picture that fills its view has no outline that could be lost, however white it is.
    assert not is_lost_on_white([np.ones((8, 8, 4), np.float32)])


@pytest.mark.parametrize(
    ("paths", "labels"),
    [
        (["a/scan.ply", "b/other.ply"], ["scan.ply", "other.ply"]),
        (["a/scan.ply", "b/scan.ply", "c/other.ply"], ["a/scan.ply", "b/scan.ply", "other.ply"]),
        (["runs/1/out/scan.ply", "runs/2/out/scan.ply"], ["1/.../scan.ply", "2/.../scan.ply"]),
        (["scan.ply", "clean/scan.ply"], ["scan.ply", "clean/scan.ply"]),
        (["/data/scan.ply", "scan.ply"], ["/data/scan.ply", "scan.ply"]),
        (["a/scan.ply", "a/scan.ply"], ["scan.ply", "scan.ply"]),
    ],
)
def test_files_of_one_name_are_labelled_by_what_differs_in_their_paths(paths, labels):
    assert distinct_labels(paths) == labels


def test_discs_of_any_size_cover_the_samples_within_their_radius():
    random = np.random.default_rng(8)
    at, radii = random.uniform(-10, 90, (60, 2)), np.geomspace(0.75, 40, 60)[random.permutation(60)]
    colours = random.random((60, 3)).astype(np.float32)
    y, x = np.mgrid[:70, :80] + 0.5
    expected = np.zeros((70, 80, 4), np.float32)
    for place, radius, colour in zip(at, radii, colours, strict=True):
        expected[(x - place[0]) ** 2 + (y - place[1]) ** 2 <= radius**2] = [*colour, 1]
    assert np.array_equal(draw_discs(at, radii, colours, (80, 70)), expected)
