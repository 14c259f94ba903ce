"""Light, data and integers in any unit: what is noise, and what becomes of it, are the same."""

import numpy as np
import pytest

from beltrami_cli import MeshArrays, smooth, smooth_image, smooth_textured
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.jobs.inspect import inspect_file
from beltrami_cli.jobs.job import Job
from beltrami_cli.jobs.smooth import smooth_file
from beltrami_cli.layers.settings import SmoothSettings
from beltrami_cli.layers.units import value_unit
from formats.image_files import encode, stored
from oracles import surfaces

pytestmark = pytest.mark.uninstrumented

SIDE, SIGMA = 48, 0.05
DATA, LIGHT = {"space": "data"}, {"encoding": "linear"}
# Rounding decides which of two equally good schedules, and which patches, are chosen: where one in 1e7 is added to
# colours at random, results differ by up to 7e-4 (root mean square).
ROUNDING = SIGMA / 10


def truth(channels=3):
    """Return plain halves and a slope between 0.2 and 0.8, shape (SIDE, SIDE, channels)."""
    y, x = np.mgrid[:SIDE, :SIDE] / SIDE
    return np.repeat((np.where(x > 0.5, 0.65, 0.25) + 0.1 * y)[..., None], channels, axis=2)


def noisy(channels=3):
    return truth(channels) + SIGMA * np.random.default_rng(7).standard_normal((SIDE, SIDE, channels))


def on_image(colours, **options):
    return smooth_image(colours, **options).colours


def on_mesh(colours, **options):
    positions, faces = surfaces.plane(SIDE, SIDE)
    return smooth(positions, faces, colours.reshape(SIDE * SIDE, -1), **options).colours.reshape(
        colours.shape
    )


def on_points(colours, **options):
    positions, _ = surfaces.plane(SIDE, SIDE)
    return smooth(positions, None, colours.reshape(SIDE * SIDE, -1), **options).colours.reshape(colours.shape)


def on_texture(colours, **options):
    positions, faces, uv = (
        [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]],
        [[0, 1, 2], [0, 2, 3]],
        [[0, 0], [1, 0], [1, 1], [0, 1]],
    )
    mesh = MeshArrays(np.array(positions, float), np.array(faces), uv=np.array(uv, float))
    return smooth_textured(mesh, [colours], **options).images[0]


def error(result, factor=1.0):
    return float(np.sqrt(np.mean(np.square(result / factor - truth(result.shape[2])))))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("where", "options"),
    [
        (on_image, DATA), (on_image, LIGHT), (on_image, {**LIGHT, "space": "linear"}),
        (on_image, {**LIGHT, "space": "oklab"}), (on_mesh, DATA), (on_mesh, LIGHT), (on_points, DATA),
        (on_texture, LIGHT),
    ],
)  # fmt: skip
def test_floats_are_smoothed_alike_in_any_unit(where, options):
    colours = noisy().astype(np.float32)
    tiny, large = np.float32(2.0**-40), np.float32(2.0**9)  # by which no number is rounded
    result = where(tiny * colours, **options) / tiny
    assert error(result) < SIGMA / 2
    np.testing.assert_array_equal(where(large * colours, **options) / large, result)


@pytest.mark.slow
@pytest.mark.parametrize("space", ["srgb", "data"])
@pytest.mark.parametrize("largest", [3000, 1023])
def test_integers_that_use_a_part_of_their_range_are_smoothed_as_those_that_use_it_all(
    space, largest, tmp_path
):
    errors = []
    for full in (50_000, largest):
        (tmp_path / "in.tif").write_bytes(
            encode(np.rint(full * noisy().clip(0, 1)).astype(np.uint16), "tiff")
        )
        smooth_file(tmp_path / "in.tif", tmp_path / "out.tif", space=space, job=Job(overwrite=True))
        errors.append(error(stored(tmp_path / "out.tif"), full))
    assert errors[0] < SIGMA / 2
    assert errors[1] == pytest.approx(errors[0], rel=0.1, abs=1 / largest)  # their steps are coarser


@pytest.mark.slow
def test_16_bits_that_hold_those_of_8_become_what_these_become():
    levels = np.rint(255 * noisy().clip(0, 1))
    narrow, wide = (on_image(levels.astype(kind)) for kind in (np.uint8, np.uint16))
    assert np.abs(narrow.astype(int) - wide).max() <= 1
    dark = np.rint(levels / 8).astype(np.uint8)  # a photograph, whose full scale stays
    assert value_unit(dark / np.float32(255), 1 / 255, is_display=True) == 1


@pytest.mark.slow
def test_thickness_in_metres_is_smoothed_as_in_millimetres(tmp_path):
    positions, faces = surfaces.plane(SIDE, SIDE)
    results = []
    for factor in (1.0, 1e-3):
        table = np.column_stack([positions, np.repeat(factor * noisy(1).reshape(-1, 1), 3, axis=1)])
        head = ["ply", "format ascii 1.0", f"element vertex {len(table)}"]
        head += [f"property float {name}" for name in ("x", "y", "z", "red", "green", "blue")]
        head += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
        rows = [" ".join(f"{value:.9g}" for value in row) for row in table] + [
            f"3 {a} {b} {c}" for a, b, c in faces
        ]
        (tmp_path / "in.ply").write_text("\n".join([*head, *rows, ""]))
        smooth_file(tmp_path / "in.ply", tmp_path / "out.ply", space="data", job=Job(overwrite=True))
        lines = (tmp_path / "out.ply").read_text().splitlines()[len(head) :][: len(table)]
        results.append(np.array([line.split()[3] for line in lines], float) / factor)
    assert error(results[0].reshape(SIDE, SIDE, 1)) < SIGMA / 2
    assert np.sqrt(np.mean(np.square(results[1] - results[0]))) < ROUNDING


@pytest.mark.parametrize(
    "parameters",
    [{"noise": "4%"}, {"beta": 20.0}, {"noise": "4%", "beta": 20.0}, {"noise": "shot:0.01,read:0.02"}],
)
def test_noise_and_beta_are_in_the_unit_of_the_values(parameters):
    # Integers of 8 bits keep their full scale; the same numbers as floats have a unit of their own.
    levels = np.rint(255 * noisy().clip(0, 1)).astype(np.uint8)
    kernel = KernelParameters(
        iterations=2, t=1.5, metric_steps=1, beta_growth=1.5, free=("beta",), clipping="keep"
    )
    kernel = kernel.with_values(**parameters)
    options = {} if "shot" in str(parameters) else DATA
    nominal = smooth_image(levels, SmoothSettings(kernel=kernel), **options)
    floats = (levels / np.float32(255)) if options else (levels / np.float32(255) * np.float32(0.9999))
    own = smooth_image(floats, SmoothSettings(kernel=kernel), **options)
    exact = 3e-3 if options else 0.05  # the table of a camera's noise ends at full scale
    assert own.beta == pytest.approx(nominal.beta, rel=exact)
    np.testing.assert_allclose(own.noise, nominal.noise, rtol=exact)
    assert np.abs(own.colours - nominal.colours / 255).max() < 1.5 / 255  # rounding


@pytest.mark.slow
def test_noise_is_reported_in_the_unit_of_the_values(tmp_path):
    found = []
    for factor in (1.0, 1e-3):
        (tmp_path / "in.exr").write_bytes(encode((factor * noisy()).astype(np.float32), "openexr", "float"))
        report = smooth_file(
            tmp_path / "in.exr", tmp_path / "out.exr", space="linear", job=Job(overwrite=True)
        )
        info = inspect_file(tmp_path / "in.exr", SmoothSettings(space="linear"))
        assert info["noise"] == pytest.approx(report.image.noise)
        assert info["smooth"]["beta"] == pytest.approx(report.image.beta)
        scaled = np.array([*report.image.noise.values(), 1 / report.image.beta, report.image.change["rms"]])
        found.append([*(scaled / factor), report.image.choice["psnr"] + 20 * np.log10(factor)])
    np.testing.assert_allclose(found[1], found[0], rtol=1e-3)
    assert found[0][0] == pytest.approx(SIGMA, rel=0.2)


@pytest.mark.parametrize(
    "values",
    [
        noisy(1), np.where(np.random.default_rng(1).random((SIDE, SIDE, 1)) < 0.003, 1e4, noisy(1)), -noisy(1),
        noisy(1) - 0.5, np.where(noisy(1) > 0.7, np.nan, noisy(1)), 20 + noisy(1), np.full((SIDE, SIDE, 1), 0.3),
    ],
    ids=["usual", "fireflies", "negative", "both signs", "holes", "far from 0", "constant"],
)  # fmt: skip
def test_units_are_proportional_to_values_and_as_large_as_most_of_them(values):
    values = values.astype(np.float32)
    unit = value_unit(values, 0.0, is_display=False)
    for factor in (1e-12, 1e-3, 700.0):
        assert value_unit(values * np.float32(factor), 0.0, is_display=False) == pytest.approx(
            factor * unit, rel=1e-3
        )
    spread = np.nanquantile(values, 0.95) - np.nanquantile(values, 0.05)
    assert 0.2 <= unit / spread <= 5 if spread else unit == pytest.approx(0.3)


def test_zeros_have_the_nominal_unit():
    assert value_unit(np.zeros((4, 3), np.float32), 0.0, is_display=False) == 1
    assert value_unit(np.full((4, 3), np.nan, np.float32), 0.0, is_display=False) == 1
