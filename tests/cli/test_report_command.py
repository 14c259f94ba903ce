"""`beltrami report`: the page shows both models as they are, in a browser, without a network."""

from __future__ import annotations

import json
import os
import re
import shutil
import sys

import numpy as np
import pytest

from beltrami_cli.formats.image import read_image
from beltrami_cli.jobs.compare.figures import ComparedColours
from beltrami_cli.view.charts import histogram
from cli.commands import SAMPLES, beltrami
from cli.pictures import painted_square, plain_image, textured_square

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FLAGS = [
    "--no-sandbox",  # which root has none of
    "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
]  # fmt: skip
RED, BLUE, WHITE = (255, 0, 0), (0, 0, 255), (255, 255, 255)


@pytest.fixture(scope="module")
def browser():
    if CHROMIUM is None:
        pytest.skip("there is no Chromium; on Debian, install it with: apt install chromium")
    playwright = pytest.importorskip("playwright.sync_api")
    with playwright.sync_playwright() as running:
        started = running.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield started
        started.close()


def reported(before, after, page):
    run = beltrami("report", before, after, page)
    assert run.returncode == 0, run.stderr
    return page


class Viewer:
    """A page with its models drawn."""

    def __init__(self, browser, path):
        context = browser.new_context(viewport={"width": 900, "height": 700}, offline=True)
        self.page, self.errors, self.requests = context.new_page(), [], []
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.goto(path.as_uri())
        self.page.wait_for_selector("#viewer[data-ready=yes]", timeout=60_000)
        self.box = self.page.locator("#viewer").bounding_box()

    def halves(self):
        """The colours to the left and to the right of the middle."""
        return self.pixel(-0.2, 0.1), self.pixel(0.2, 0.1)

    def pixel(self, right, up):
        """The colour at a place from the middle, in heights of the view."""
        shot = read_image(self.page.locator("#viewer").screenshot(), "").pixels
        height, width = shot.shape[:2]
        at = shot[round(height * (0.5 - up)), round(width / 2 + right * height)]
        return tuple(int(value) for value in at[:3])

    def swipe_to(self, value):
        self.page.locator("#swipe").fill(str(value))

    def turn(self, degrees):
        """Drag: a whole turn is as long as the view is high."""
        x, y = self.box["x"] + self.box["width"] / 2, self.box["y"] + self.box["height"] / 2
        self.page.mouse.move(x, y)
        self.page.mouse.down()
        self.page.mouse.move(x + self.box["height"] * degrees / 360, y, steps=8)
        self.page.mouse.up()


@pytest.mark.slow
def test_the_swipe_parts_both_models_and_one_camera_turns_them(browser, tmp_path):
    files = painted_square(tmp_path / "a.ply", (1, 0, 0)), painted_square(tmp_path / "b.ply", (0, 0, 1))
    page = reported(*files, tmp_path / "page.html")
    viewer = Viewer(browser, page)
    for at, colours in ((50, (RED, BLUE)), (100, (RED, RED)), (0, (BLUE, BLUE)), (50, (RED, BLUE))):
        viewer.swipe_to(at)
        assert viewer.halves() == colours
    viewer.turn(90)  # seen from its edge, the square is gone
    assert viewer.halves() == (WHITE, WHITE)
    viewer.turn(90)  # from behind
    assert viewer.halves() == (RED, BLUE)
    assert viewer.errors == []
    assert [url for url in viewer.requests if not url.startswith(("data:", "blob:"))] == [page.as_uri()]


@pytest.mark.slow
def test_textures_lie_the_right_way_up_in_their_own_colours(browser, tmp_path):
    colours = np.array([[[200, 100, 30], [20, 90, 160]], [[10, 20, 30], [250, 240, 60]]])
    before = textured_square(tmp_path / "a.obj", colours)
    after = textured_square(tmp_path / "b.obj", 255 - colours)
    viewer = Viewer(browser, reported(before, after, tmp_path / "page.html"))
    for end, shown in ((100, colours), (0, 255 - colours)):
        viewer.swipe_to(end)
        for row, up in ((0, 0.2), (1, -0.2)):
            for column, right in ((0, -0.2), (1, 0.2)):
                # The browser computes with 8 bits, and decodes and encodes sRGB once.
                assert viewer.pixel(right, up) == pytest.approx(tuple(shown[row, column]), abs=1)
    crop = viewer.page.locator(".swipe")
    slider = viewer.page.locator("figure input[type=range]")
    for at, expected in ((0, 255 - colours[0, 0]), (100, colours[0, 0])):
        slider.fill(str(at))
        shot = read_image(crop.screenshot(), "").pixels
        assert tuple(shot[20, 20, :3].astype(int)) == pytest.approx(tuple(expected), abs=1)
    assert viewer.errors == []


@pytest.mark.slow
def test_points_are_drawn(browser, tmp_path):
    grid = np.stack(np.meshgrid(np.arange(20), np.arange(20)), axis=2).reshape(-1, 2)
    clouds = []
    for name, colour in (("a", "255 0 0"), ("b", "0 0 255")):
        clouds.append(tmp_path / f"{name}.xyz")
        clouds[-1].write_text("".join(f"{x} {y} {(x + y) % 2 / 50} {colour}\n" for x, y in grid))
    assert Viewer(browser, reported(*clouds, tmp_path / "page.html")).halves() == (RED, BLUE)


def test_images_have_a_swipe_without_models(tmp_path):
    images = plain_image(tmp_path / "a.png", RED), plain_image(tmp_path / "b.png", BLUE)
    text = reported(*images, tmp_path / "page.html").read_text()
    assert 'id="viewer"' not in text
    assert text.count('class="swipe"') == 1


@pytest.mark.parametrize("largest", [5, 40, 70, 130, 200])
def test_changes_by_whole_numbers_are_counted_evenly(largest):
    """Each number of 255ths between two bounds occurs once: all bins within them are equally high."""
    change = np.arange(-largest, largest + 1)[:, None]
    before = np.where(change < 0, 250, 5)
    colours = [(values / np.float32(255)).astype(np.float32) for values in (before, before + change)]
    flat = np.zeros(len(change))
    drawn = histogram([ComparedColours("x", "vertices", *colours, flat.astype(np.int64), flat + 1, None)])
    (points,) = re.findall(r'<polyline [^>]*points="([^"]*)"', drawn)
    heights = [float(point.split(",")[1]) for point in points.split()]
    assert len(set(heights[2:-2])) == 1


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere names are text")
def test_a_name_that_is_no_text_is_shown_as_far_as_it_goes(tmp_path):
    knot = tmp_path / os.fsdecode(b"kn\xfft.ply")
    shutil.copy(SAMPLES / "knot-clean.ply", knot)
    page = reported(knot, knot, tmp_path / "page.html")
    assert "kn?t.ply" in page.read_text(encoding="utf-8")


def test_equal_colours_are_called_equal(tmp_path):
    knot = SAMPLES / "knot-clean.ply"
    assert "<td>equal</td>" in reported(knot, knot, tmp_path / "page.html").read_text()


@pytest.mark.slow
def test_figures_and_parameters_are_those_of_the_other_commands(tmp_path):
    source, target, record = SAMPLES / "head-tex-noisy.glb", tmp_path / "a.glb", tmp_path / "run.json"
    assert beltrami("smooth", source, target, "-n", 1, "--beta", 7.25, "--report", record).returncode == 0
    page = tmp_path / "page.html"
    run = beltrami("report", source, target, page, "--parameters", record)
    assert run.returncode == 0, run.stderr
    text = page.read_text()
    assert "<td>beta</td><td>7.25</td>" in text
    compared = json.loads(beltrami("compare", source, target, "--json").stdout)
    assert f"{compared['overall']['psnr']:.2f} dB".encode() in run.stderr
    assert "<h2>Seams" in text
    assert "<svg" in text


def parameters_shown(source, tmp_path, *options):
    """Return the rows of the parameters on a page, and what the run says of its samples."""
    target, record, page = tmp_path / f"out{source.suffix}", tmp_path / "run.json", tmp_path / "page.html"
    run = beltrami("smooth", source, target, "--report", record, "--overwrite", *options)
    assert run.returncode == 0, run.stderr
    made = beltrami("report", source, target, page, "--parameters", record, "--overwrite")
    assert made.returncode == 0, made.stderr
    section = page.read_text().partition("<h2>Parameters</h2>")[2].partition("<script>")[0]
    rows = [re.findall(r"<td>(.*?)</td>", row) for row in re.findall(r"<tr>(.*?)</tr>", section)]
    found = {row[0]: tuple(row[1:]) for row in rows if row}
    done = json.loads(record.read_text())
    return found, done["vertices"] or done["image"] or done["textures"][0]


@pytest.mark.slow
def test_parameters_are_shown_as_they_were_used_and_how_they_came_about(tmp_path):
    shown, done = parameters_shown(SAMPLES / "knot-noisy.ply", tmp_path, "--metric-scale", 0.7)
    assert shown["beta"] == (f"{done['beta']:.4g}", "chosen from the data")
    assert shown["iterations"] == (str(done["iterations"]), "chosen from the data")
    assert shown["metric scale"] == ("0.7", "given")
    assert shown["space"] == ("srgb", "default")
    assert not {"None", "True", "False"} & {value for row in shown.values() for value in row}
    shown, done = parameters_shown(SAMPLES / "knot-noisy.ply", tmp_path, "--fast", "-n", 5)
    assert shown["iterations"] == ("5", "given")  # though it is the default
    assert shown["beta"] == (f"{done['beta']:.4g}", "by the fixed rule")
    shown, done = parameters_shown(SAMPLES / "scan-noisy.jpg", tmp_path, "--preset", "paper")
    assert shown["time step, t"] == ("0.5", "given")
    assert shown["beta"] == (f"{done['beta']:.4g}", "from the noise")
    shown, _ = parameters_shown(SAMPLES / "head-clean.ply", tmp_path, "--on", "vertices")
    assert shown["iterations"] == ("0", "no more noise than rounding makes")
    assert shown["smoothed, --on"] == ("vertices", "given")
    assert "beta" not in shown


@pytest.mark.slow
def test_what_cannot_be_shown_is_said_and_nothing_written(tmp_path):
    plain = tmp_path / "run.json"
    plain.write_text("[]")
    page = tmp_path / "page.html"
    pair = SAMPLES / "knot-noisy.ply", SAMPLES / "knot-clean.ply"
    for arguments, code in (
        ((*pair, page, "--parameters", plain), 3),
        ((pair[0], SAMPLES / "head-clean.ply", page), 3),
        ((pair[0], SAMPLES / "scan-clean.jpg", page), 3),
        (("-", pair[1], page), 2),
        ((*pair, tmp_path / "page.txt"), 2),
        ((pair[0], pair[1], pair[1], "--overwrite"), 4),
    ):
        run = beltrami("report", *arguments)
        assert run.returncode == code, run.stderr
        assert run.stderr.count(b"\n") == 1
        assert not page.exists()


def test_help_does_not_promise_to_smooth():
    run = beltrami("report", "--help")
    assert b"Smooth the" not in run.stdout
