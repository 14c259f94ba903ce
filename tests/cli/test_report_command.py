"""`beltrami report`: the contents of the page; its looks in a browser are tested in tests/view."""

import json
import os
import re
import shutil
import sys

import numpy as np
import pytest

from beltrami_cli.jobs.compare.measured import ComparedPart, measure
from beltrami_cli.view import report
from beltrami_cli.view.parameter_tables import used_parameters
from beltrami_cli.view.report import histogram
from cli.commands import SAMPLES, beltrami, colours_in
from cli.pictures import encode, textured_square


@pytest.mark.parametrize("largest", [5, 40, 70, 130, 200])
def test_changes_by_whole_numbers_are_counted_evenly(largest):
    """Each number of 255ths between two bounds occurs once: all bins within them are equally high."""
    change = np.arange(-largest, largest + 1)[:, None]
    before = np.where(change < 0, 250, 5)
    one, other = [(values / np.float32(255)).astype(np.float32) for values in (before, before + change)]
    about = {"name": "x", "kind": "vertices", "index": np.arange(len(change)), "space": "data"}
    part = ComparedPart(**about, read=lambda rows: (one[rows], other[rows]))
    (line,) = histogram([measure(part)], largest)["lines"]
    heights = [float(point.split(",")[1]) for point in line["points"].split()]
    assert len(set(heights[2:-2])) == 1


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere names are text")
def test_a_name_that_is_no_text_is_shown_as_far_as_it_goes(tmp_path):
    knot = tmp_path / os.fsdecode(b"kn\xfft.ply")
    shutil.copy(SAMPLES / "knot-clean.ply", knot)
    beltrami("report", knot, knot, tmp_path / "page.html")
    assert "kn?t.ply" in (tmp_path / "page.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_figures_and_parameters_are_those_of_the_other_commands(tmp_path):
    source, target, record = SAMPLES / "head-tex-noisy.glb", tmp_path / "a.glb", tmp_path / "run.json"
    beltrami("smooth", source, target, "-n", 1, "--beta", 7.25, "--report", record)
    page = tmp_path / "page.html"
    run = beltrami("report", source, target, page, "--parameters", record)
    text = page.read_text()
    assert "<td>beta</td><td>7.25</td>" in text
    compared = json.loads(beltrami("compare", source, target, "--json").stdout)
    assert f"{compared['overall']['psnr']:.2f} dB".encode() in run.stderr
    assert "<h2>Seams" in text
    assert "<svg" in text


def parameters_shown(source, tmp_path, *options):
    """Return the rows of the parameters on a page, and what the run says of its samples."""
    target, record, page = tmp_path / f"out{source.suffix}", tmp_path / "run.json", tmp_path / "page.html"
    beltrami("smooth", source, target, "--report", record, "--overwrite", *options)
    beltrami("report", source, target, page, "--parameters", record, "--overwrite")
    section = page.read_text().partition("<h2>Parameters</h2>")[2].partition("<script>")[0]
    rows = [re.findall(r"<td>(.*?)</td>", row) for row in re.findall(r"<tr>(.*?)</tr>", section)]
    return {row[0]: tuple(row[1:]) for row in rows if row}, colours_in(record)


@pytest.mark.slow
def test_parameters_are_shown_as_they_were_used_and_how_they_came_about(tmp_path):
    shown, done = parameters_shown(SAMPLES / "nonmanifold-noisy.ply", tmp_path, "--metric-scale", 0.7)
    assert shown["beta"] == (f"{done['beta']:.4g}", "chosen from the data")
    assert shown["iterations"] == (str(done["iterations"]), "chosen from the data")
    assert shown["metric scale"] == ("0.7", "given")
    assert shown["space"] == ("srgb", "default")
    assert not {"None", "True", "False"} & {value for row in shown.values() for value in row}
    shown, done = parameters_shown(SAMPLES / "nonmanifold-noisy.ply", tmp_path, "--fast", "-n", 5)
    assert shown["iterations"] == ("5", "given")  # though it is the default
    assert shown["beta"] == (f"{done['beta']:.4g}", "by the fixed rule")
    shown, done = parameters_shown(SAMPLES / "torus-two-noisy-dough.png", tmp_path, "--preset", "paper")
    assert shown["time step, t"] == ("0.5", "given")
    assert shown["beta"] == (f"{done['beta']:.4g}", "from the noise")
    shown, _ = parameters_shown(SAMPLES / "nonmanifold-clean.ply", tmp_path, "--on", "vertices")
    assert shown["iterations"] == ("0", "as no noise is removed")
    assert shown["smoothed, --on"] == ("vertices", "given")
    assert "beta" not in shown


@pytest.mark.parametrize("outliers", ["auto", "keep"])
def test_the_page_says_how_many_samples_were_wrong(outliers, tmp_path):
    clean = tmp_path / "clean.ppm"
    clean.write_bytes(
        encode(np.full((96, 96, 3), 90, np.uint8) + np.arange(96, dtype=np.uint8)[:, None], "ppm")
    )
    beltrami("noise", clean, tmp_path / "dots.png", "--kind", "salt-pepper", "--sigma", "2%")
    shown, done = parameters_shown(tmp_path / "dots.png", tmp_path, "--outliers", outliers)
    count = done["wrong_samples"]["count"]
    assert count > 100
    what = "kept" if outliers == "keep" else "replaced"
    assert re.fullmatch(rf"{count} \(\S+ %\) {what}", shown["wrong samples"][0])


@pytest.mark.slow
def test_parameters_were_chosen_also_where_no_error_can_be_estimated(tmp_path):
    record = tmp_path / "run.json"
    beltrami("smooth", SAMPLES / "knot-noisy.ply", tmp_path / "out.ply", "--report", record)
    run = json.loads(record.read_text())
    run["vertices"]["choice"] |= {"psnr": None, "error": None, "gain": None, "predicted": None}
    shown = str(used_parameters(run))
    assert "by the fixed rule" not in shown
    assert "chosen from the data" in shown


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["model", "image"])
def test_pictures_are_scaled_to_the_size_of_a_page_unless_full_size_is_wanted(kind, tmp_path, monkeypatch):
    """Noise of all bits is incompressible, so both pictures take 2.9 MB as text."""
    assert report._MAX_PAGE_BYTES <= 8e6
    monkeypatch.setattr(report, "_MAX_PAGE_BYTES", 2e6)
    pair = []
    for number, name in enumerate(("a", "b")):
        noise = np.random.default_rng(number).integers(0, 256, (600, 600, 3), np.uint8)
        model = textured_square(tmp_path / f"{name}.obj", noise[:2, :2])
        model.with_suffix(".png").write_bytes(encode(noise, "png"))
        pair.append(model if kind == "model" else model.with_suffix(".png"))
    run = beltrami("report", *pair, tmp_path / "small.html")
    assert 1.9e6 < (tmp_path / "small.html").stat().st_size <= 2e6
    (share,) = re.findall(rb"Pictures have (\d+) % of their width on the page; --full-size keeps", run.stderr)
    assert int(share) / 100 == pytest.approx(np.sqrt(1.7 / 2.9), abs=0.03)
    run = beltrami("report", *pair, tmp_path / "large.html", "--full-size")
    assert (tmp_path / "large.html").stat().st_size > 2.9e6
    assert b"--full-size" not in run.stderr
