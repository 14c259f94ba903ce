"""The command `level`, and `smooth --level`: what they write, say and refuse."""

import json
from functools import cache, partial
from types import SimpleNamespace

import numpy as np
import pytest

import beltrami_cli
from beltrami_cli.flow.manifolds.grid.canvas import canvas_colours, on_canvas
from beltrami_cli.formats.registry import open_document
from beltrami_cli.jobs.check import check_files
from beltrami_cli.jobs.job import PLAIN_JOB
from beltrami_cli.jobs.recolour import ColourFilter, recolour
from beltrami_cli.layers.settings import DEFAULTS
from beltrami_cli.layers.storing import dithered
from cli.commands import SAMPLES
from cli.commands import beltrami as run_beltrami
from levelling.exposure_scene import ExposureScene, stored_colours
from oracles import surfaces
from small_models import COLOURED, ply

HEAD = SAMPLES / "head-tex-clean.glb"
PLAIN = beltrami_cli.SmoothSettings(kernel=beltrami_cli.KernelParameters())
beltrami = partial(run_beltrami, text=True)


class Exposing(ColourFilter):
    """A filter that gives charts known exposures."""

    def apply(self, layer, job):
        _, colours = ExposureScene(layer, stored_colours(layer).astype(float)).exposed(1)
        planes = on_canvas(layer.atlas, colours.astype(np.float32))
        return SimpleNamespace(stored=layer.encode(canvas_colours(layer.atlas, planes)), warnings=())


@pytest.fixture(scope="module")
def exposed(tmp_path_factory):
    return exposed_as(tmp_path_factory.mktemp("exposed") / "exposed.glb", HEAD)


def exposed_as(path, source):
    recolour(str(source), str(path), DEFAULTS, Exposing(), PLAIN_JOB, {})
    return path


@cache
def step(path):
    job = beltrami_cli.Job(dry_run=True)
    return beltrami_cli.level_file(path, "none.glb", job=job).levelled[0].before


@pytest.mark.slow
def test_level_takes_steps_out_and_changes_nothing_but_colours(exposed, tmp_path):
    target, run = tmp_path / "level.glb", tmp_path / "run.json"
    done = beltrami("level", exposed, target, "--report", run)
    assert "median step" in done.stderr
    assert check_files(str(exposed), str(target)).faithful
    assert step(target) < 0.1 * step(exposed)
    (report,) = json.loads(run.read_text())["levelled"]
    assert report["levelled"]
    assert {each["chart"] for each in report["exposures"]} == set(range(report["charts"]))


@pytest.mark.slow
def test_a_model_without_exposure_steps_stays_and_is_said_to(tmp_path):
    done = beltrami("level", HEAD, tmp_path / "same.glb")
    assert "left as they are; the seam steps do not agree" in done.stderr
    beltrami("smooth", HEAD, tmp_path / "smooth.glb", "--level", "-n", 0)
    for name in ("same.glb", "smooth.glb"):  # also around charts
        assert (tmp_path / name).read_bytes() == HEAD.read_bytes()


@pytest.mark.slow
def test_smooth_levels_first(exposed, tmp_path):
    target = tmp_path / "smooth.glb"
    done = beltrami("smooth", "--level", exposed, target, "-n", 1, "--beta", 10, "--fast")
    assert "median step" in done.stderr
    assert "1 baseColor texture" in done.stderr
    assert step(target) < 0.1 * step(exposed)


# Takes 4 s with the scan: no smaller sample has seams where colours differ.
@pytest.mark.slow
def test_smooth_without_iterations_only_levels_also_around_charts_on_any_number_of_threads(tmp_path):
    source = exposed_as(tmp_path / "exposed.glb", SAMPLES / "scan-clean.glb")
    beltrami("level", source, tmp_path / "level.glb", "--threads", 1)
    beltrami("smooth", source, tmp_path / "smooth.glb", "--level", "-n", 0, "--threads", 3)
    assert (tmp_path / "smooth.glb").read_bytes() == (tmp_path / "level.glb").read_bytes()


def test_texels_at_several_places_are_not_said_to_be_smoothed(tmp_path):
    done = beltrami("level", SAMPLES / "mirrored-clean.obj", tmp_path / "out.obj", "--dry-run")
    assert "overlapping charts); each is taken at one of them" in done.stderr


@pytest.mark.slow
def test_no_strength_is_not_said_of_the_steps(exposed, tmp_path):
    done = beltrami("level", exposed, tmp_path / "same.glb", "--exposure-strength", 0)
    assert "change would be too small" in done.stderr
    assert (tmp_path / "same.glb").read_bytes() == exposed.read_bytes()


def photographed(path, *, exposed):
    """Write a plane of vertices with a smooth pattern, of three photographs."""
    positions, faces = surfaces.plane(40, 40)
    column, row, _ = positions.T
    photograph = (column > 12).astype(int) + (column + row // 3 > 32)
    colours = 130 + 30 * np.sin(row / 6)[:, None] + 30 * np.cos(column / 5 + row / 9)[:, None] * [1, 0.8, 0.6]
    if exposed:
        colours = colours * np.array([[0.9, 1, 1], [1.1, 1, 0.85], [1, 0.9, 1.1]])[photograph]
    table = np.column_stack([positions, np.rint(colours), photograph]).astype(int)
    path.write_bytes(ply(f"{COLOURED}, int camera", table.tolist(), faces.tolist()))
    return open_document(str(path)).coloured_vertices().colours


@pytest.mark.slow
def test_vertices_are_levelled_by_the_photographs_that_an_attribute_names(tmp_path):
    truth = photographed(tmp_path / "truth.ply", exposed=False)
    before = photographed(tmp_path / "exposed.ply", exposed=True)
    known = beltrami_cli.inspect_file(tmp_path / "exposed.ply", PLAIN)["exposure"]
    assert known["is_exposure"]
    assert known["seams"] == 2
    beltrami("level", tmp_path / "exposed.ply", tmp_path / "out.ply")
    after = open_document(str(tmp_path / "out.ply")).coloured_vertices().colours

    def off(colours):
        return np.std(colours - truth * colours.mean(axis=0) / truth.mean(axis=0))

    assert off(after) < 0.3 * off(before)
    done = beltrami("level", tmp_path / "truth.ply", tmp_path / "same.ply", "--photographs", "camera")
    assert "left as they are" in done.stderr


def test_rounding_spreads_fractions_over_the_two_nearest_steps_and_keeps_whole_ones():
    texels = np.arange(64 * 64)
    for value in (100.0, 100.3, 100.5):
        values = np.full((len(texels), 1), value / 255, np.float32)
        rounded = np.rint(255 * dithered(values, texels, 64))
        assert set(np.unique(rounded)) <= {np.floor(value), np.ceil(value)}
        assert rounded.mean() == pytest.approx(value, abs=0.02)


@pytest.mark.slow
def test_the_function_in_python_takes_parameters_of_both_records(exposed, tmp_path):
    report = beltrami_cli.level_file(
        exposed, tmp_path / "out.glb", exposure_strength=0.5, slots=("baseColor",)
    )
    assert report.levelled[0].after == pytest.approx(report.levelled[0].before / 2, rel=0.1)
    with pytest.raises(beltrami_cli.UsageError):
        beltrami_cli.level_file(exposed, tmp_path / "out.glb", exposure_strength=2.0)
