"""`beltrami sweep`: every combination, smoothed and measured as the other commands do it."""

import csv
import json
import re

import pytest

from cli.commands import SAMPLES, beltrami
from cli.pictures import pixels

pytest.importorskip("embreex")
NOISY, CLEAN = (SAMPLES / f"nonmanifold-{kind}.ply" for kind in ("noisy", "clean"))


@pytest.mark.slow
def test_a_page_has_all_combinations_with_the_figures_of_smooth_and_compare(tmp_path):
    page = tmp_path / "sheet.html"
    lists = ("--beta", "4,12", "-n", "1,3", "--metric-steps", "1")
    run = beltrami("sweep", NOISY, page, *lists, "--reference", CLEAN, "--size", 60)
    text = page.read_text()
    trials = json.loads(re.search(r'id="trials">(.*?)</script>', text, re.DOTALL)[1])
    assert trials[0]["parameters"] == {}
    names = ("beta", "n", "metric steps")
    swept = [tuple(trial["parameters"].get(name) for name in names) for trial in trials]
    assert sorted(swept[1:]) == [(4, 1, 1), (4, 3, 1), (12, 1, 1), (12, 3, 1)]
    assert text.count("data:image/png;base64,") == 7  # with the reference, the input and the default
    assert not re.search(r'(src|href)="(?!data:)', text)  # nothing is fetched
    by_hand = tmp_path / "by-hand.ply"
    for number, words in ((0, ()), (swept.index((12, 3, 1)), ("--beta", 12, "-n", 3, "--metric-steps", 1))):
        beltrami("smooth", NOISY, by_hand, *words, "--overwrite")
        compared = json.loads(beltrami("compare", CLEAN, by_hand, "--json").stdout)
        assert trials[number]["figures"]["psnr"] == pytest.approx(compared["overall"]["psnr"])
    best = max(trials, key=lambda trial: trial["figures"]["psnr"])["parameters"]
    named = f"beta {best['beta']:g}, n {best['n']:g}" if best else "default"
    assert f"best {named}".encode() in run.stderr


@pytest.mark.slow
@pytest.mark.parametrize("name", ["nonmanifold-noisy.ply", "mirrored-noisy.obj"])
def test_figures_alone_are_those_of_compare_without_files_in_between(name, tmp_path):
    table, source = tmp_path / "table.csv", SAMPLES / name
    reference = SAMPLES / name.replace("noisy", "clean")
    fixed = ("-t", 1, "--beta", 5)
    beltrami("sweep", source, table, "--format", "csv", "-n", "1,2", *fixed, "--reference", reference)
    rows = list(csv.DictReader(table.read_text().splitlines()))
    assert [row["n"] for row in rows] == ["", "1", "2"]
    smooth = tmp_path / name
    beltrami("smooth", source, smooth, "-n", 2, *fixed)
    overall = json.loads(beltrami("compare", reference, smooth, "--json").stdout)["overall"]
    assert float(rows[2]["psnr"]) == pytest.approx(overall["psnr"])
    assert float(rows[2]["delta_e"]) == pytest.approx(overall["delta_e"]["mean"])


@pytest.mark.slow
def test_without_a_reference_the_gain_is_estimated_and_goes_to_a_pipe():
    run = beltrami("sweep", NOISY, "-", "--format", "json", "-n", "1,3")
    trials = json.loads(run.stdout)
    assert [trial["parameters"] for trial in trials] == [{}, {"n": 1}, {"n": 3}]
    assert all(trial["figures"]["estimated_gain"] > 0 for trial in trials)


@pytest.mark.slow
def test_a_picture_begins_the_trials_in_a_row_of_their_own(tmp_path):
    sheet, default, one = (tmp_path / f"{name}.png" for name in ("sheet", "default", "one"))
    smooth = tmp_path / "smooth.ply"
    beltrami("sweep", NOISY, sheet, "-t", "1,2,4", "--fast", "--size", 64)
    for words, picture in (((), default), (("-t", 1), one)):
        beltrami("smooth", NOISY, smooth, *words, "--fast", "--overwrite")
        beltrami("render", smooth, picture, "--size", 64)
    image = pixels(sheet)
    strip, gap = 20, 2
    assert image.shape == (2 * (strip + 64) + gap, 3 * 64 + 2 * gap, 3)
    assert (image[: strip + 64, 2 * 66 :] == 255).all()
    assert (image[strip : strip + 64, 66 : 66 + 64] == pixels(default)).all()
    assert (image[-64:, :64] == pixels(one)).all()
