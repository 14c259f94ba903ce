"""`beltrami_cli.smooth` takes arrays that fit, and refuses all others with one line."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

import beltrami_cli
from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.flow.choice.choice import tune
from oracles import surfaces

POSITIONS = [[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]
FACES = [[0, 1, 2], [1, 3, 2]]
COLOURS = np.array([[0, 10, 20], [30, 40, 50], [60, 70, 80], [255, 255, 255]], np.uint8)

SQUARE = beltrami_cli.MeshArrays(POSITIONS, FACES, uv=np.array(POSITIONS)[:, :2])  # shows all of an image
SPHERE, TRIANGLES = surfaces.icosphere(1)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"faces": [[0, 1, 2, 3]] * 3}, r"shape \(F, 3\)"),
        ({"faces": [[0, 1, 2**32 + 2]]}, "face 0 is .* 4 vertices"), ({"faces": [[0, 1, -1]]}, "face 0 is"),
        ({"faces": [[0, 1, 2**70]]}, "whole numbers"), ({"faces": [[0, 1, 2.5]]}, "whole numbers"),
        ({"faces": [[0, 1, 2], [1, 3]]}, "same length"),
        ({"positions": [["a", "b", "c"]] * 4}, "positions must be numbers"),
        ({"positions": [0.0, 1, 2, 3]}, r"shape \(V, M\)"),
        ({"positions": np.zeros((4, 3), complex)}, "positions must be numbers"),
        ({"positions": np.zeros((4, 0))}, r"shape \(V, M\)"), ({"colours": COLOURS.tolist()}, "uint8"),
        ({"colours": COLOURS.astype(np.uint64)}, "uint8"),
        ({"colours": COLOURS > 50}, "colours must be numbers"),
        ({"colours": np.zeros((4, 0))}, r"shape \(V, C\)"), ({"encoding": "foo"}, "encoding is foo"),
        ({"iterations": 2.5}, "iterations is 2.5"),
    ],
)  # fmt: skip
def test_arrays_and_parameters_that_do_not_fit_are_refused_by_one_line(change, said):
    arguments = {"positions": POSITIONS, "faces": FACES, "colours": COLOURS, **change}
    with pytest.raises(UsageError, match=said) as caught:
        beltrami_cli.smooth(**arguments)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("change", [{"colours": COLOURS[:3]}, {"colours": np.full((4, 3), 1e300)}])
def test_colours_that_are_too_few_or_not_finite_are_refused(change):
    with pytest.raises(InputError):
        beltrami_cli.smooth(**{"positions": POSITIONS, "faces": FACES, "colours": COLOURS, **change})


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.uint32])
def test_integer_colours_are_taken_by_the_full_scale_of_their_type(kind):
    scale = np.iinfo(kind).max // 255
    scaled = COLOURS.astype(kind) * kind(scale)
    result = beltrami_cli.smooth(POSITIONS, FACES, scaled, beta=3, iterations=2)
    floats = beltrami_cli.smooth(POSITIONS, FACES, COLOURS / 255, beta=3, iterations=2)
    assert result.colours.dtype == kind
    # Half a step from rounding, and a few units in the last place of float32.
    most = np.iinfo(kind).max
    assert np.abs(result.colours / most - floats.colours).max() <= 0.5 / most + 1e-6
    assert not np.allclose(floats.colours, COLOURS / 255, atol=1e-6)


@pytest.mark.parametrize("kind", [np.int8, np.uint8, np.uint16, np.int64, np.uint64])
def test_faces_may_be_of_any_integer_type(kind):
    expected = beltrami_cli.smooth(POSITIONS, FACES, COLOURS).colours
    assert np.array_equal(beltrami_cli.smooth(POSITIONS, np.array(FACES, kind), COLOURS).colours, expected)


def test_empty_arrays_give_empty_colours_and_no_warning():
    assert beltrami_cli.smooth([], [], []).colours.shape == (0, 3)
    assert beltrami_cli.smooth(np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 2))).colours.shape == (0, 2)
    lonely = beltrami_cli.smooth(POSITIONS, [], COLOURS)
    assert np.array_equal(lonely.colours, COLOURS)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.uint32, np.float16, np.float32, np.float64])
@pytest.mark.parametrize("function", ["smooth", "smooth_image", "smooth_textured"])
def test_colours_come_back_in_their_type_and_stay_bit_identical_where_nothing_changed(function, kind):
    given = np.random.default_rng(0).random((6, 7, 3))
    colours = (given * (np.iinfo(kind).max if np.dtype(kind).kind == "u" else 1)).astype(kind)
    settings = {"beta": 0.1, "iterations": 1, "channels": ("0",) if function == "smooth_image" else ("red",)}
    if function == "smooth":
        smoothed = beltrami_cli.smooth(SPHERE, TRIANGLES, colours.reshape(42, 3), **settings).colours
    elif function == "smooth_image":
        smoothed = beltrami_cli.smooth_image(colours, **settings).colours
    else:
        (smoothed,) = beltrami_cli.smooth_textured(SQUARE, [colours], **settings).images
    assert smoothed.dtype == kind
    smoothed = smoothed.reshape(colours.shape)
    assert (smoothed[..., 0] != colours[..., 0]).any()
    assert np.array_equal(smoothed[..., 1:], colours[..., 1:])


@pytest.mark.parametrize("faces", [TRIANGLES, None], ids=["mesh", "points"])
def test_vertices_without_a_finite_colour_stay_as_they_are_and_lend_nothing(faces):
    colours = np.random.default_rng(4).uniform(0.2, 0.8, (42, 3))
    colours[[3, 17]], colours[29, 1] = np.nan, np.inf
    known = np.isfinite(colours).all(axis=1)
    guide = np.arange(42.0)
    own = {"beta": 3, "iterations": 2, "noise": np.full(42, 0.1), "guide": guide, "guide_betas": (0.01,)}
    result = beltrami_cli.smooth(SPHERE, faces, colours, **own)
    number = np.cumsum(known) - 1
    left = None if faces is None else number[[face for face in TRIANGLES if known[face].all()]]
    own |= {"noise": np.full(known.sum(), 0.1), "guide": guide[known]}
    alone = beltrami_cli.smooth(SPHERE[known], left, colours[known], **own)
    assert np.array_equal(result.colours[~known], colours[~known], equal_nan=True)
    np.testing.assert_allclose(result.colours[known], alone.colours, rtol=1e-6)
    assert result.samples == known.sum()
    if faces is not None:
        moved = beltrami_cli.smooth(SPHERE, faces, colours, beta=3, iterations=2, smooth_geometry=True)
        assert np.array_equal(moved.positions[~known], SPHERE[~known])
        assert (moved.positions[known] != SPHERE[known]).any()


def as_trimesh(faces, colours):
    if faces is None:
        return trimesh.PointCloud(SPHERE, colors=colours)
    return trimesh.Trimesh(SPHERE, faces, vertex_colors=colours, process=False)


def as_open3d(faces, colours):
    names = ("points", "colors") if faces is None else ("vertices", "vertex_colors")
    return SimpleNamespace(**dict(zip(names, (SPHERE, colours[:, :3] / 255), strict=True)), triangles=faces)


class Tensor:
    """A tensor of Open3D, which NumPy takes only from the memory of the processor."""

    def __init__(self, values, *, is_on_host=False):
        self._values, self._is_on_host = values, is_on_host

    def cpu(self):
        return Tensor(self._values, is_on_host=True)

    def numpy(self):
        assert self._is_on_host
        return np.array(self._values)


def as_open3d_tensors(faces, colours):
    places = {"positions": Tensor(SPHERE), "colors": Tensor(colours[:, :3])}
    if faces is None:
        return SimpleNamespace(point=places)
    return SimpleNamespace(vertex=places, triangle={"indices": Tensor(faces)})


def as_pyvista(faces, colours):
    padded = [] if faces is None else np.insert(faces, 0, 3, axis=1).ravel()
    tables = {"Normals": SPHERE, "other": 255 - colours, "RGBA": colours}
    named = {"active_scalars_name": "RGBA", "point_data": tables}
    return SimpleNamespace(points=SPHERE, faces=padded, n_strips=0, **named)


@pytest.mark.parametrize("convert", [as_trimesh, as_open3d, as_open3d_tensors, as_pyvista])
@pytest.mark.parametrize("faces", [TRIANGLES, None], ids=["mesh", "points"])
def test_meshes_of_libraries_are_taken_with_their_colours_and_opacity(convert, faces):
    colours = np.random.default_rng(1).integers(0, 256, (42, 4)).astype(np.uint8)
    result = beltrami_cli.smooth(convert(faces, colours), beta=3, iterations=1).colours
    expected = beltrami_cli.smooth(SPHERE, faces, colours[:, :3], beta=3, iterations=1).colours
    if convert is as_open3d:  # floats, which are not rounded
        assert np.abs(255 * result - expected).max() <= 0.5 + 1e-3
    elif convert is as_open3d_tensors:
        assert np.array_equal(result, expected)
    else:
        assert np.array_equal(result, np.hstack([expected, colours[:, 3:]]))


@pytest.mark.parametrize(
    ("mesh", "said"),
    [
        (trimesh.creation.box(), "no colours of vertices"),
        (trimesh.creation.box(face_colors=[1, 2, 3]), "colours of faces"),
        (trimesh.Scene(trimesh.creation.box()), "one by one"),
        (SimpleNamespace(vertices=POSITIONS, triangles=FACES, vertex_colors=[]), "no colours of vertices"),
        (SimpleNamespace(point_data={}), "triangulate"),
        (SimpleNamespace(point_data={}, faces=[4, 0, 1, 3, 2], n_strips=0), "triangulate"),
        (SimpleNamespace(point_data={}, faces=[3, 0, 1, 3], n_strips=1), "triangulate"),
    ],
)
def test_meshes_without_colours_or_triangles_are_refused(mesh, said):
    with pytest.raises(UsageError, match=said):
        beltrami_cli.smooth(mesh)
    with pytest.raises(UsageError):
        beltrami_cli.smooth(mesh, FACES, COLOURS)


@pytest.mark.parametrize("wish", [{}, {"strength": "strong"}, {"noise": "15"}, {"iterations": 2}])
def test_colours_that_smoothing_is_estimated_to_make_worse_stay_unless_an_option_asks_for_it(
    wish, monkeypatch
):
    """The estimate is replaced, since no small mesh makes it negative."""

    def pessimistic(manifold, **options):
        parameters, choice = tune(manifold, **options)
        return parameters, None if choice is None else replace(choice, gain=-1.0)

    monkeypatch.setattr("beltrami_cli.flow.plan.tune", pessimistic)
    positions, faces = surfaces.plane(24, 24)
    colours = 0.5 + 0.06 * np.random.default_rng(3).standard_normal((len(positions), 3))
    found = beltrami_cli.smooth(positions, faces, colours, **wish).colours
    assert np.array_equal(found, colours) == (not wish)
