"""`beltrami compare` as a user and a Makefile run it: its verdicts, its exit codes, what it prints and draws."""

import json
import re
import shlex
import shutil
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from beltrami_cli.cli.console import table_lines
from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.formats.changes import Naming
from beltrami_cli.formats.registry import open_document
from beltrami_cli.jobs.compare.files import compare_files
from beltrami_cli.jobs.compare.limits import check_limits
from beltrami_cli.jobs.noise.file import noise_file
from beltrami_cli.jobs.settings import Limits, NoiseSettings
from cli.commands import COMMAND, SAMPLES, beltrami
from formats.image_files import encode, stored
from formats.volume_files import sphere_file
from jobs.cut_boards import CHART, SIDE, cut, write_board

DOCS = Path(__file__).parents[2] / "docs"
CLEAN, NOISY = SAMPLES / "head-tex-clean.glb", SAMPLES / "head-tex-noisy.glb"


def picture(path, pixels):
    path.write_bytes(encode(pixels, "png"))
    return path


def board(path, change=0):
    """Write a board with a slope from texel to texel, and a change of it."""
    y, x = np.mgrid[:SIDE, :SIDE]
    phantom = 20000 + 300 * np.stack([x, y, x + y], axis=2) + change
    return write_board(path, cut(phantom.astype(np.uint16)))


def psnr_of(offset):
    return 20 * np.log10(1 / offset)


def test_an_offset_has_the_psnr_that_it_has(tmp_path):
    pixels = np.full((20, 30, 3), 100, np.uint8)
    one, other = picture(tmp_path / "a.png", pixels), picture(tmp_path / "b.png", pixels + 5)
    assert compare_files(one, other).overall["psnr"] == pytest.approx(psnr_of(5 / 255), abs=1e-4)
    one, other = board(tmp_path / "a.obj"), board(tmp_path / "b.obj", 655)
    compared = compare_files(one, other)
    assert compared.overall["psnr"] == pytest.approx(psnr_of(655 / 65535), abs=1e-4)
    assert compared.overall["near_seams"]["psnr"] == pytest.approx(compared.overall["psnr"], abs=1e-4)
    assert compared.overall["seam_jump"]["change"] == pytest.approx(0, abs=1e-6)


def test_one_wrong_vertex_is_found_and_counts_by_its_area(tmp_path):
    document = open_document(str(SAMPLES / "terrain-clean.ply"))
    colours = document.coloured_vertices().colours.copy()
    colours[77, 1] = 1 - colours[77, 1]
    (tmp_path / "t.ply").write_bytes(b"".join(document.patch(colours, Naming("t", in_place=True)).main))
    compared = compare_files(SAMPLES / "terrain-clean.ply", tmp_path / "t.ply")
    error = compared.overall["worst"]["error"]
    assert compared.overall["worst"]["vertex"] == 77
    assert compared.overall["psnr"] == pytest.approx(psnr_of(error / (3 * len(colours)) ** 0.5), abs=1e-3)
    positions, faces = document.coloured_vertices().positions, document.coloured_vertices().faces
    sides = positions[faces[:, 1:]] - positions[faces[:, :1]]
    areas = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    share = areas[(faces == 77).any(axis=1)].sum() / 3 / areas.sum()
    by_area = compare_files(SAMPLES / "terrain-clean.ply", tmp_path / "t.ply", weights="area")
    assert by_area.overall["psnr"] == pytest.approx(psnr_of(error * (share / 3) ** 0.5), abs=1e-3)


def test_texels_that_faces_look_up_around_charts_have_figures_of_their_own(tmp_path):
    one, other = board(tmp_path / "a.obj"), board(tmp_path / "b.obj")
    pixels = stored(one.with_suffix(".png"))
    equal = compare_files(one, other).overall["around_charts"]
    assert equal["psnr"] is None
    assert equal["worst"] == 0
    uncovered = cut(np.ones((SIDE, SIDE, 3), np.uint16)) == 0
    changed = np.where(uncovered, pixels + 6554, pixels)
    picture(other.with_suffix(".png"), changed)
    compared = compare_files(one, other).overall
    assert (compared["psnr"], compared["samples"]) == (None, SIDE**2)  # in which they do not count
    around = compared["around_charts"]
    assert 0 < around["samples"] < uncovered[..., 0].sum()
    assert around["psnr"] == pytest.approx(psnr_of(0.1), abs=1e-3)
    assert around["worst"] == pytest.approx(0.1, abs=1e-4)
    shown = beltrami("compare", one, other).stdout.decode()
    said = f"in the gutter: {around['samples']} texels that faces look up, PSNR 20.00, off by up to 25.5/255"
    assert said in shown


def test_a_step_at_seams_is_found_where_the_psnr_is_high(tmp_path):
    """Charts 2/255 too bright and too dark by turns are 42 dB, more than mild noise has; but every seam is seen."""
    parity = np.add.outer(np.arange(SIDE) // CHART, np.arange(SIDE) // CHART) % 2
    step = 514 * (2 * parity - 1)[..., None]
    one, other = board(tmp_path / "a.obj"), board(tmp_path / "b.obj", step)
    limits = Limits(min_psnr=40, max_delta_e=2, max_seam_jump=2 / 255)
    compared = compare_files(one, other, limits)
    assert compared.overall["psnr"] == pytest.approx(psnr_of(2 / 255), abs=1e-3)
    assert compared.overall["seam_jump"]["change"] == pytest.approx(4 / 255, rel=1e-3)
    assert [verdict.limit for verdict in compared.limits if not verdict.kept] == ["max_seam_jump"]
    assert not compared.passed


@pytest.mark.slow
def test_the_exit_code_and_each_broken_limit_are_reported():
    kept = beltrami("compare", CLEAN, NOISY, "--min-psnr", 20, "--max-seam-jump", 40)
    assert kept.stdout.startswith(b"part ")
    assert b"worst sample" in kept.stdout
    limits = ("--min-psnr", 25, "--max-delta-e", 50, "--max-seam-jump", 2)
    broken = beltrami("compare", CLEAN, NOISY, *limits, "-q", code=1)
    assert broken.stdout == b""
    assert [line.split()[3] for line in broken.stderr.splitlines()[:1]] == [b"skin:"]
    assert len(broken.stderr.splitlines()) == 2


def test_json_and_map(tmp_path):
    drawn = tmp_path / "map.png"
    limits = ("--max-delta-e", 1, "--min-ssim", 0.1)
    run = beltrami("compare", CLEAN, NOISY, "--json", "--map", drawn, *limits, code=1)
    compared = json.loads(run.stdout)
    assert set(compared["parts"][0]) == {"name", "kind", "identical", *compared["overall"]}
    kept = {limit["limit"]: limit["kept"] for limit in compared["limits"]}
    assert kept == {"min_ssim": True, "max_delta_e": False, "max_move": True}
    pixels = stored(drawn).astype(int)
    assert pixels.shape == (416, 416, 3)
    coloured = np.ptp(pixels, axis=2) > 0
    assert np.count_nonzero(coloured) == pytest.approx(compared["overall"]["samples"], rel=0.01)
    worst = compared["overall"]["delta_e"]["worst"]
    assert compared["map_scale"] == pytest.approx(worst)


def test_vertices_are_drawn_as_a_mesh_with_their_differences(tmp_path):
    noise_file(SAMPLES / "knot-clean.ply", tmp_path / "n.ply", NoiseSettings(0.1))
    drawn = tmp_path / "map.ply"
    compared = compare_files(SAMPLES / "knot-clean.ply", tmp_path / "n.ply", map_to=drawn)
    document = open_document(str(drawn))
    found = document.attribute("delta_e")[:, 0]
    assert found.mean() == pytest.approx(compared.overall["delta_e"]["mean"], rel=1e-5)
    lightness = document.coloured_vertices().colours.sum(axis=1)
    assert lightness[found.argmax()] > lightness[found.argmin()] + 0.5
    with pytest.raises(UsageError, match=r"\.ply"):
        compare_files(SAMPLES / "knot-clean.ply", tmp_path / "n.ply", map_to=tmp_path / "map.png")
    assert not (tmp_path / "map.png").exists()


def test_where_no_seam_is_nothing_jumps_and_a_seam_that_cannot_be_measured_is_no_success(tmp_path):
    one = picture(tmp_path / "a.png", np.full((20, 20, 3), 9, np.uint8))
    compared = compare_files(one, one, Limits(max_seam_jump=0.0))
    assert compared.passed
    assert "--max-seam-jump is kept" in compared.notices[0]
    part = {
        "name": "narrow",
        "samples": 4,
        "identical": False,
        "near_seams": {"samples": 4},
        "seam_jump": None,
    }
    with pytest.raises(InputError, match="--max-seam-jump cannot be tested"):
        check_limits([part], Limits(max_seam_jump=1.0), "t.obj")


@pytest.mark.slow
def test_the_makefile_of_the_page_passes_good_results_and_fails_on_bad_ones(tmp_path):
    (block,) = re.findall(r"```make\n(.*?)```", (DOCS / "ci.md").read_text(), re.DOTALL)
    (tmp_path / "Makefile").write_text(block)
    for folder, kind in (("incoming", "noisy"), ("reference", "clean")):
        (tmp_path / folder).mkdir()
        shutil.copy(SAMPLES / f"knot-{kind}.ply", tmp_path / folder / "knot.ply")

    def make(limits):
        words = ["make", f"BELTRAMI={shlex.join(COMMAND)}", f"LIMITS={limits}", "check"]
        return subprocess.run(words, cwd=tmp_path, capture_output=True, timeout=120, check=False)

    run = make("--min-psnr 60")
    assert run.returncode == 2, run.stderr
    assert b"PSNR" in run.stderr
    figures = tmp_path / "build" / "knot.ply.json"
    assert not json.loads(figures.read_text())["passed"]  # kept, so that the failure can be looked at
    run = make("--min-psnr 25 --max-delta-e 8")
    assert run.returncode == 0, run.stderr
    assert json.loads(figures.read_text())["passed"]
    assert b"smooth" not in run.stdout  # what was made by the first run is kept


def test_junit_has_a_case_for_each_limit_and_part(tmp_path):
    one = picture(tmp_path / "a & b.png", np.full((8, 8, 3), 100, np.uint8))
    other = picture(tmp_path / "c.png", np.full((8, 8, 3), 110, np.uint8))
    report = tmp_path / "report.xml"
    beltrami("compare", one, other, "--min-psnr", 60, "--max-delta-e", 50, "--junit", report, code=1)
    suite = ElementTree.parse(report).getroot()
    assert (suite.tag, suite.get("tests"), suite.get("failures")) == ("testsuite", "2", "1")
    assert [case.find("failure") is None for case in suite] == [False, True]
    beltrami("compare", one, one, "--junit", report, code=4)  # nothing is replaced without --overwrite
    beltrami("compare", one, one, "--min-psnr", 60, "--junit", report, "--overwrite")
    assert ElementTree.parse(report).getroot().get("failures") == "0"


@pytest.mark.parametrize(
    ("name", "suffix", "similarity"),
    [
        ("head-clean.ply", ".ply", None), ("torus-two-clean.gltf", ".gltf", 1), ("sphere-exr-clean.obj", ".obj", 1),
        ("head-tex-clean.png", ".png", 1), ("head-tex-clean.obj", ".glb", 1), ("scan-clean.ply", ".glb", 1),
        ("torus-two-clean.gltf", ".obj", 1), ],
)  # fmt: skip
def test_a_file_is_equal_to_itself_and_to_its_conversion(name, suffix, similarity, tmp_path):
    """Conversion splits and renumbers vertices, and of several textures may change the order."""
    copy = tmp_path / f"c{suffix}"
    noise_file(SAMPLES / name, copy, NoiseSettings(0.0))
    limits = Limits(min_psnr=200, min_ssim=similarity, max_delta_e=0, max_seam_jump=0)
    comparison = compare_files(SAMPLES / name, copy, limits)
    assert comparison.passed
    for compared in (*comparison.parts, comparison.overall):
        assert compared["samples"] > 0
        assert compared["psnr"] is None
        assert compared["delta_e"] == {"mean": 0, "p95": 0, "worst": 0}
        assert compared["worst"]["error"] == 0


@pytest.mark.parametrize(("name", "noise", "psnr"), [("knot-clean.ply", 0.0, 60), ("volume", 0.1, 19)])
def test_formats_and_encodings_may_differ(name, noise, psnr, tmp_path):
    """8-bit display values become linear light of 16 bits and come back; a level set becomes a mesh."""
    source = sphere_file(tmp_path, 0.25) if name == "volume" else SAMPLES / name
    noise_file(source, tmp_path / "c.glb", NoiseSettings(noise))
    assert compare_files(source, tmp_path / "c.glb", Limits(min_psnr=psnr)).passed


@pytest.mark.parametrize("width", [30, 60, 70, 80, 100, 200, None])
def test_a_table_breaks_no_number_and_no_name(width):
    head = ("part", "samples", "PSNR dB", "dE 95 %", *["jump /255"] * 5)
    first = ["baseColor a-very-long-name.png", "1234567", "33.44", "12.50", *["+21.87"] * 5]
    rows = [first, ["all", *"12345678"]]
    lines = [*table_lines(head, rows, width)]
    words = [word for line in lines for word in line.split()]
    for row in rows:
        assert row[0] in "\n".join(lines)
        assert all(words.count(cell) >= row.count(cell) for cell in row[1:])
    names = [row[0] for row in rows]
    assert width is None or all(len(line) <= width for line in lines if line not in names)
