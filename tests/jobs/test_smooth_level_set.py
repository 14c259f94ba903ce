"""Level sets as documents: the same from every source, facing outwards, and refused with the cause."""

import dataclasses
import json

import numpy as np
import pytest

from beltrami_cli import InputError, SmoothSettings, smooth
from beltrami_cli.formats.files.access import DEFAULT_ACCESS, Access
from beltrami_cli.jobs.opening import open_input
from beltrami_cli.layers.settings import LevelSetSettings
from cli.commands import beltrami
from formats.volume_files import lattice_fields, npz, nrrd_file, sphere_file, write
from oracles.level_sets import CENTRE, directions, pattern, places, sphere
from small_models import ply

RANDOM = np.random.default_rng(9)
DEFAULTS = SmoothSettings()


def opened(path, settings=DEFAULTS, access=DEFAULT_ACCESS):
    return open_input(str(path), settings, access)


@pytest.mark.parametrize("source", ["points", "nrrd", "ply"])
def test_colours_come_from_another_file_alike(source, tmp_path):
    values, steps, origin = sphere(np.array([0.1, 0.08, 0.1]))
    volume = write(tmp_path / "values.npz", npz(values=values, spacing=steps, origin=origin))
    points = CENTRE + directions(RANDOM.standard_normal((20000, 3)), 0)
    if source == "nrrd":  # on a grid of its own, twice as fine and turned
        turned = np.array([[0, 0.05, 0], [0, 0, 0.05], [0.05, 0, 0]])
        cells = np.stack(np.meshgrid(*[np.arange(52)] * 3, indexing="ij"), axis=-1)
        fine = pattern(directions(cells @ turned - 1.31 + CENTRE))
        fields = lattice_fields(turned, CENTRE - 1.31, 0)
        other = write(tmp_path / "colours.nrrd", nrrd_file(np.moveaxis(fine, -1, 0), **fields))
    elif source == "points":
        arrays = {"points": points, "point_colours": pattern(directions(points))}
        other = write(tmp_path / "points.npz", npz(**arrays))
    else:
        colours = np.round(255 * pattern(directions(points))).astype(int)
        rows = [[*place, *shade] for place, shade in zip(points.tolist(), colours.tolist(), strict=True)]
        other = write(tmp_path / "points.ply", ply("double x y z, uchar red green blue", rows))
    settings = SmoothSettings(level_set=LevelSetSettings(colours=str(other)))
    vertices = opened(volume, settings).coloured_vertices()
    # Linear colours are exact; the pattern bends by less than 6 and points are some 0.05 away.
    np.testing.assert_allclose(vertices.colours, pattern(directions(vertices.positions)), atol=0.05)
    with pytest.raises(InputError, match="--colours"):
        opened(volume)


def test_archives_and_nrrd_files_give_the_same_mesh(tmp_path):
    values, steps, origin = sphere(0.3)
    colours = (255 * pattern(directions(places(values.shape, steps, origin)))).astype(np.uint8)
    archive = npz(values=values, colours=colours, spacing=steps, origin=origin)
    first = opened(write(tmp_path / "a.npz", archive))
    axes = np.diag(steps)
    volume = write(tmp_path / "v.nrrd", nrrd_file(values, "gzip", **lattice_fields(axes, origin)))
    shades = nrrd_file(np.moveaxis(colours, -1, 0), **lattice_fields(axes, origin, 0))
    settings = SmoothSettings(level_set=LevelSetSettings(colours=str(write(tmp_path / "c.nrrd", shades))))
    second = opened(volume, settings)
    for field in ("positions", "faces", "colours"):
        np.testing.assert_array_equal(
            getattr(first.coloured_vertices(), field), getattr(second.coloured_vertices(), field)
        )
    assert first.coloured_vertices().stored == second.coloured_vertices().stored == "uint8"
    assert first.facts() == second.facts()


def test_vertices_without_a_colour_stay_white_and_do_not_count(tmp_path):
    def partly(at):
        return np.where(at[..., :1] > 0.3, np.nan, 0.2 + 0.1 * RANDOM.random((*at.shape[:3], 3)))

    document = opened(sphere_file(tmp_path, 0.2, partly))
    vertices = document.coloured_vertices()
    bare = (vertices.colours == 1).all(axis=1)
    assert f"{bare.sum()} of {len(bare)} vertices have no colour" in vertices.notices[0]
    assert document.vertex_mesh().notices == vertices.notices  # whatever is made of it
    assert vertices.positions[bare, 0].min() > 0.1
    after = smooth(vertices.positions, vertices.faces, vertices.colours).colours
    assert (after[bare] == 1).all()
    assert after[~bare].max() <= 0.3
    assert len(document.contents().offsets) - 1 > len(vertices.faces)  # the surface itself has no hole


def outward(document):
    contents = document.contents()
    corners = contents.positions[contents.corners.reshape(-1, 3)]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return bool(((corners.mean(axis=1) - contents.positions.mean(axis=0)) * normals).sum(axis=1).min() > 0)


def test_surfaces_face_outwards_whatever_way_the_axes_point(tmp_path):
    values, steps, _ = sphere(0.3)
    both = np.concatenate([values[None], RANDOM.random((3, *values.shape))])
    for axes in (np.eye(3), np.diag([1.0, 1.0, -1.0]), np.eye(3)[[1, 0, 2]]):
        fields = lattice_fields(axes * steps[0], np.zeros(3), 0)
        assert outward(opened(write(tmp_path / "v.nrrd", nrrd_file(both, **fields))))


def test_densities_have_their_inside_above_the_level(tmp_path):
    values, _, _ = sphere(0.25)
    path = write(tmp_path / "v.npz", npz(values=1 - values, colours=np.full((*values.shape, 1), 0.5)))
    above = LevelSetSettings(iso=1.2, inside="above")
    for level_set, faces_outwards in ((above, True), (dataclasses.replace(above, inside="below"), False)):
        document = opened(path, SmoothSettings(level_set=level_set))
        assert outward(document) == faces_outwards
        positions = document.contents().positions
        radii = np.linalg.norm(positions - positions.mean(axis=0), axis=1) * 0.25
        np.testing.assert_allclose(radii, 0.8, atol=0.5 * 0.25**2 / 0.8 + 0.01)


def test_opacity_is_kept_and_scaled_like_the_colours(tmp_path):
    values, _, _ = sphere(0.3)
    samples = np.full((*values.shape, 4), [255, 128, 0, 51], np.uint8)
    contents = opened(write(tmp_path / "v.npz", npz(values=values, colours=samples))).contents()
    np.testing.assert_allclose(contents.alpha, 0.2, rtol=1e-6)
    assert contents.colours == pytest.approx(np.tile([1, 128 / 255, 0], (len(contents.colours), 1)))


@pytest.mark.parametrize(
    ("arrays", "level_set", "cause"),
    [
        ({}, {"iso": 7.0}, "no surface at level 7"),
        ({"values": np.full((4, 4, 4), np.nan)}, {}, "no surface"),
        ({}, {"max_voxels": 63}, "63 are allowed"),
        ({"colours": np.full((4, 4, 4, 3), np.nan)}, {}, "none of its colours"),
        ({"colours": np.full((4, 4, 4, 3), 1000.0)}, {}, "full scale"),
        ({"colours": np.full((4, 4, 4, 2), 0)}, {}, "none of its colours"),
    ],
)
def test_volumes_without_a_coloured_surface_are_refused_with_the_cause(arrays, level_set, cause, tmp_path):
    values = np.indices((4, 4, 4))[0] - 1.3
    arrays = {"values": values, "colours": np.full((4, 4, 4, 3), 9, np.uint8)} | arrays
    path = write(tmp_path / "v.npz", npz(**arrays))
    with pytest.raises(InputError, match=cause):
        opened(path, SmoothSettings(level_set=LevelSetSettings(**level_set)))


def test_noise_in_place_of_a_level_set_is_refused_before_it_becomes_triangles(tmp_path, monkeypatch):
    monkeypatch.setattr("beltrami_cli.layers.level_set_document.MAX_CROSSINGS", 1000)
    values = RANDOM.standard_normal((12, 12, 12))
    path = write(tmp_path / "v.npz", npz(values=values, colours=np.zeros((12, 12, 12, 3), np.uint8)))
    with pytest.raises(InputError, match="as noise does"):
        opened(path)


def test_a_grid_is_held_to_the_memory_that_may_be_taken(tmp_path):
    path = sphere_file(tmp_path, 0.2)
    with pytest.raises(InputError, match="are allowed"):
        opened(path, access=Access(memory=2 * path.stat().st_size))


def test_info_describes_the_grid_and_its_surface_by_the_level_that_is_given(tmp_path):
    source = sphere_file(tmp_path, 0.15, values=0.5 - sphere(0.15)[0])
    facts = json.loads(beltrami("info", source, "--json", "--iso", 0.5, "--inside", "above").stdout)
    assert facts["file"]["format"] == "level set"
    assert facts["file"]["level"] == 0.5
    assert facts["surface"]["boundary_edges"] == facts["surface"]["degenerate_faces"] == 0


def any_numbers(shape):
    """Return an array of one of the kinds of numbers that a file may hold."""
    numbers = RANDOM.standard_normal(shape)
    odd = RANDOM.choice([np.nan, np.inf, -np.inf, 1e308, -1e308, 5e-324, 0.0], shape)
    return [
        lambda: numbers.astype(RANDOM.choice(["f2", "f4", "f8"])),
        lambda: RANDOM.integers(-3, 3, shape).astype(RANDOM.choice(["i1", "i4", "i8"])),
        lambda: RANDOM.integers(0, 256, shape).astype("u1"),
        lambda: numbers > 0,
        lambda: np.where(RANDOM.random(shape) < 0.3, odd, numbers),
        lambda: np.sign(numbers) * 10.0 ** RANDOM.uniform(-300, 300, shape),
    ][RANDOM.integers(6)]()


@pytest.mark.slow
def test_whatever_the_numbers_are_there_is_a_finite_coloured_surface_or_a_refusal(tmp_path):
    surfaces = 0
    for _ in range(200):  # with warnings as errors
        shape = tuple(RANDOM.integers(2, 8, 3))
        steps = 10.0 ** RANDOM.integers(-20, 20, RANDOM.choice([1, 3]))
        arrays = {"values": any_numbers(shape), "spacing": steps}
        if RANDOM.random() < 0.5:
            count, scale = RANDOM.integers(0, 20), 10.0 ** RANDOM.integers(-200, 200)
            arrays["points"] = scale * RANDOM.standard_normal((count, 3))
            arrays["point_colours"] = any_numbers((count, RANDOM.integers(1, 5)))
        else:
            arrays["colours"] = any_numbers((*shape, RANDOM.integers(1, 5)))
        if RANDOM.random() < 0.7:
            del arrays["spacing"]
        try:
            contents = opened(write(tmp_path / "v.npz", npz(**arrays))).contents()
        except InputError:
            continue
        surfaces += 1
        assert np.isfinite(contents.positions).all()
        assert np.isfinite(contents.colours).all()
        assert contents.corners.max() < len(contents.positions)
    assert surfaces > 20
