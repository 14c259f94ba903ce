"""Pages in a browser: what a report and a sweep show, and how they are operated.

All pages fit their window, can be operated by everyone, fetch nothing, and show names as text.
"""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from beltrami_cli.formats.files.access import DEFAULT_ACCESS
from beltrami_cli.jobs.job import Job
from beltrami_cli.jobs.opening import open_input
from beltrami_cli.layers.settings import DEFAULTS
from beltrami_cli.surface.records import ColouredVertices
from beltrami_cli.view.pages.models import ModelWriter
from beltrami_cli.view.settings import RenderSettings
from beltrami_cli.view.sweep import sweep_file
from cli.commands import SAMPLES, beltrami
from cli.pictures import coloured_square, plain_image, textured_square
from formats.gltf_comparison import issues, needs_validator
from formats.image_files import encode
from oracles import surfaces
from small_models import textured_squares
from view.browsing import BLUE, NARROW, RED, WHITE, WIDE, Page, Served, Viewer

pytestmark = pytest.mark.slow


def reported(before, after, page, *options):
    beltrami("report", before, after, page, *options)
    return page.as_uri()


@pytest.fixture(scope="module")
def squares(tmp_path_factory):
    folder = tmp_path_factory.mktemp("squares")
    files = coloured_square(folder / "a.ply", (1, 0, 0)), coloured_square(folder / "b.ply", (0, 0, 1))
    return reported(*files, folder / "page.html")


def test_the_line_parts_both_models_and_one_camera_turns_them(browser, squares):
    viewer = Viewer(browser, squares, offline=True)
    for at, colours in ((0.5, (RED, BLUE)), (1, (RED, RED)), (0, (BLUE, BLUE)), (0.5, (RED, BLUE))):
        viewer.swipe_to(at)
        assert viewer.halves() == colours
    viewer.turn(90)  # seen from its edge, the square is gone
    assert viewer.halves() == (WHITE, WHITE)
    viewer.turn(90)  # from behind
    assert viewer.halves() == (RED, BLUE)
    assert viewer.errors == []
    assert viewer.fetched() == [squares]


@pytest.mark.parametrize(
    ("grey", "scheme", "stage"),
    [(0.9, "light", (128,) * 3), (0.4, "light", WHITE), (0.05, "dark", (128,) * 3), (0.4, "dark", (36, 39, 43))],
)  # fmt: skip
def test_models_stand_out_from_the_stage(browser, tmp_path, grey, scheme, stage):
    square = coloured_square(tmp_path / "a.ply", (grey,) * 3)
    viewer = Viewer(browser, reported(square, square, tmp_path / "page.html"), color_scheme=scheme)
    assert viewer.pixel(0.2, 0.1) == pytest.approx((255 * grey,) * 3, abs=1)
    viewer.turn(90)
    assert viewer.pixel(0.2, 0.1) == stage


def test_keys_move_the_line_turn_the_model_and_switch_the_sides(browser, squares):
    viewer = Viewer(browser, squares)
    keyboard = viewer.page.keyboard
    viewer.part("line").focus()
    keyboard.press("Home")
    assert viewer.halves() == (BLUE, BLUE)
    keyboard.press("End")
    assert viewer.halves() == (RED, RED)
    keyboard.press("b")
    assert viewer.halves() == (BLUE, BLUE)
    keyboard.press("b")
    assert viewer.halves() == (RED, RED)
    viewer.page.locator("canvas").focus()
    for _ in range(12):  # a quarter of a turn
        keyboard.press("ArrowRight")
    assert viewer.halves() == (WHITE, WHITE)
    keyboard.press("0")
    assert viewer.halves() == (RED, RED)


def test_a_finger_drags_the_line(browser, squares):
    viewer = Viewer(browser, squares, width=390, height=800, has_touch=True, is_mobile=True)
    line = viewer.part("line").bounding_box()
    assert line["width"] >= 44
    touch = viewer.page.context.new_cdp_session(viewer.page)
    x, y = line["x"] + line["width"] / 2, line["y"] + 20
    for kind, points in (
        ("touchStart", [(x, y)]), ("touchMove", [(x + 60, y)]), ("touchMove", [(x + 200, y)]), ("touchEnd", []),
    ):  # fmt: skip
        places = [{"x": across, "y": down} for across, down in points]
        touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": places})
    assert viewer.halves() == (RED, RED)


def test_the_difference_has_the_colours_of_its_scale(browser, tmp_path):
    files = (
        coloured_square(tmp_path / "a.ply", (0.2, 0.2, 0.2)),
        coloured_square(tmp_path / "b.ply", (0.6, 0.2, 0.2)),
    )
    viewer = Viewer(browser, reported(*files, tmp_path / "page.html"))
    assert not viewer.part("legend").is_visible()
    viewer.page.get_by_label("difference", exact=True).check()
    assert viewer.part("legend").is_visible()
    assert viewer.part("limit").inner_text() == "102/255 or more"
    brightest = (253, 231, 37)  # of viridis, at its end
    assert viewer.pixel(0.1, 0.1) == pytest.approx(brightest, abs=2)


def test_textures_lie_the_right_way_up_in_their_own_colours(browser, tmp_path):
    colours = np.array([[[200, 100, 30], [20, 90, 160]], [[10, 20, 30], [250, 240, 60]]])
    before = textured_square(tmp_path / "a.obj", colours)
    after = textured_square(tmp_path / "b.obj", 255 - colours)
    viewer = Viewer(browser, reported(before, after, tmp_path / "page.html"))
    for side, shown in (("before", colours), ("after", 255 - colours)):
        viewer.page.get_by_label(side, exact=True).check()
        for flat in (False, True):
            viewer.part("flat").set_checked(flat)
            for row, up in ((0, 0.2), (1, -0.2)):
                for column, right in ((0, -0.2), (1, 0.2)):
                    # The browser computes with 8 bits, and decodes and encodes sRGB once.
                    assert viewer.pixel(right, up) == pytest.approx(tuple(shown[row, column]), abs=1)
    assert viewer.errors == []


def test_without_webgl_the_pictures_are_shown(browser, tmp_path):
    files = [plain_image(tmp_path / f"{name}.png", colour) for name, colour in (("a", RED), ("b", BLUE))]
    page = browser.new_context().new_page()
    page.add_init_script(
        "const context = HTMLCanvasElement.prototype.getContext;"
        "HTMLCanvasElement.prototype.getContext = function (kind, ...more) {"
        " return kind.startsWith('webgl') ? null : context.call(this, kind, ...more); };"
    )
    page.goto(reported(*files, tmp_path / "page.html"))
    page.wait_for_selector(".place[data-ready=no]", timeout=60_000)
    colours = page.evaluate(
        "() => [...document.querySelectorAll('.place canvas')]"
        ".map((canvas) => [...canvas.getContext('2d').getImageData(9, 9, 1, 1).data])"
    )
    assert colours == [[*RED, 255], [*BLUE, 255]]


def test_images_and_points_are_drawn(browser, tmp_path):
    images = plain_image(tmp_path / "a.png", RED), plain_image(tmp_path / "b.png", BLUE)
    viewer = Viewer(browser, reported(*images, tmp_path / "image.html"))
    assert viewer.halves() == (RED, BLUE)
    grid = np.stack(np.meshgrid(np.arange(20), np.arange(20)), axis=2).reshape(-1, 2)
    clouds = []
    for name, colour in (("a", "255 0 0"), ("b", "0 0 255")):
        clouds.append(tmp_path / f"{name}.xyz")
        clouds[-1].write_text("".join(f"{x} {y} {(x + y) % 2 / 50} {colour}\n" for x, y in grid))
    viewer = Viewer(browser, reported(*clouds, tmp_path / "page.html"))
    assert viewer.halves() == (RED, BLUE)
    assert not viewer.page.get_by_role(
        "group", name="Look"
    ).is_visible()  # points have nothing to choose there


RESTORED = """async (packed) => {
  const { scene } = await new THREE.GLTFLoader().parseAsync(await Unpacking.restored(packed), "");
  const { index, attributes } = scene.children[0].geometry;
  const rows = ({ count }, at) => Array.from({ length: count }, (_, row) => at(row));
  const places = (table, row) => [table.getX(row), table.getY(row), table.getZ(row)];
  const vectors = (name) => rows(attributes[name], (row) => places(attributes[name], row));
  return [rows(index, (row) => index.getX(row)), vectors("position"), vectors("_after")];
}"""


def scattered(side):
    """A bumpy mesh of noisy colours in bytes, whose vertices and triangles are in no order."""
    random = np.random.default_rng(5)
    positions, faces = surfaces.plane(side, side, 1 / (side - 1))
    positions[:, 2] = 0.1 * np.sin(9 * positions[:, :2]).prod(axis=1) + random.normal(0, 2e-4, side**2)
    order = random.permutation(len(positions))
    faces = random.permutation(np.argsort(order)[faces]).astype(np.int32)
    colours = (random.integers(90, 110, (len(positions), 3)) / 255).astype(np.float32)
    return ColouredVertices(
        positions[order], faces, colours[order], ("red", "green", "blue"), "srgb", "uint8"
    )


def test_what_is_packed_is_restored_and_takes_little_space(browser, squares):
    vertices, writer = scattered(81), ModelWriter()
    document = SimpleNamespace(kind="mesh", coloured_vertices=lambda: vertices)
    row_of = writer.add((document, document), None).row_of
    packed, _ = writer.packed(8)
    # A report of 400,000 triangles shall take at most 2 MB, including 0.3 MB of scripts.
    assert len(packed["data"]) < 1.7e6 * len(vertices.faces) / 400_000
    page = Viewer(browser, squares).page
    index, positions, colours = page.evaluate(RESTORED, packed)
    order = np.argsort(row_of)
    assert np.abs(positions - (vertices.positions - vertices.positions.min(axis=0))[order]).max() < 1e-5
    assert np.abs(colours - vertices.colours[order]).max() < 1e-6
    assert {tuple(face) for face in np.sort(np.reshape(index, (-1, 3))).tolist()} == {
        tuple(face) for face in np.sort(row_of[vertices.faces]).tolist()
    }


@needs_validator
def test_models_of_pages_are_valid_gltf(tmp_path):
    cloud = tmp_path / "cloud.xyz"
    cloud.write_text(
        "".join(f"{x} {y} 0 200 30 30\n" for x in range(9) for y in range(9))
        + "900 0 0 200 30 30\n1e60 0 0 200 30 30\n"
    )
    files = []
    for source in (
        cloud,
        *(SAMPLES / each for each in ("knot-noisy.ply", "torus-two-noisy.gltf", "scan-clean.jpg")),
    ):
        document = open_input(str(source), DEFAULTS, DEFAULT_ACCESS)
        writer, is_image = ModelWriter(), document.kind == "image"
        writer.add((document, document), None if is_image else next(iter(document.slots()), None))
        files.append(tmp_path / f"{source.stem}.glb")
        files[-1].write_bytes(writer.glb(8))
    for path, found in zip(files, issues(*files), strict=True):
        assert [each for each in found if each[0] < 2] == [], path.name  # errors and warnings


NOISY, CLEAN = (SAMPLES / f"nonmanifold-{kind}.ply" for kind in ("noisy", "clean"))


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    pytest.importorskip("embreex")
    page = tmp_path_factory.mktemp("sweep") / "page.html"
    options = ("--beta", "2,4,12", "-n", "1,3", "--metric-steps", 1, "--reference", CLEAN, "--size", 120)
    beltrami("sweep", NOISY, page, *options)
    return page.as_uri()


def test_results_are_sorted_and_open_beside_the_input(browser, swept):
    sheet = Page(browser, swept, offline=True)
    trials = json.loads(sheet.page.locator("#trials").text_content())
    worth = sorted((trial["figures"]["psnr"] for trial in trials), reverse=True)
    sheet.page.get_by_label("Sort by").select_option("psnr")
    views, rows = sheet.page.locator("#views li"), sheet.page.locator("main tr")
    assert "reference" in views.nth(0).inner_text()
    assert "before" in views.nth(1).inner_text()
    for number, psnr in enumerate(worth):
        assert f"{psnr:.3f}" in views.nth(2 + number).inner_text()
        assert f"{psnr:.3f}" in rows.nth(1 + number).inner_text()
    assert "best" in views.nth(2).inner_text()
    views.nth(2).get_by_role("button").click()
    dialog = sheet.page.get_by_role("dialog")
    assert f"{worth[0]:.2f} dB" in dialog.inner_text()
    pictures = [picture.get_attribute("src") for picture in dialog.locator("img").all()]
    assert pictures == [views.nth(number).locator("img").get_attribute("src") for number in (1, 2)]
    sheet.page.keyboard.press("ArrowRight")
    assert f"{worth[1]:.2f} dB" in dialog.inner_text()
    sheet.page.keyboard.press("Escape")
    assert not dialog.is_visible()
    assert sheet.errors == []
    assert sheet.fetched() == [swept]


def sweep_watched(target, watch, count=4):
    """Sweep in this process; `watch` is called with the number of results before each trial and after the last."""
    pytest.importorskip("embreex")

    def progress(label, done, total):
        trials = done * count / total
        if label.startswith(f"{trials + 1:g} of") or trials == count:
            watch(int(trials))

    kernel = replace(DEFAULTS.kernel, iterations=1, t=1.0, free=())
    trials = [
        ({"beta": beta}, replace(DEFAULTS, kernel=replace(kernel, beta=beta))) for beta in range(1, count + 1)
    ]
    sweep_file(
        str(NOISY), str(target), trials, RenderSettings(size=(90, 90)), columns=2, job=Job(progress=progress)
    )


def test_the_page_grows_while_it_is_open_and_keeps_what_was_set(browser, tmp_path, monkeypatch):
    monkeypatch.setattr("beltrami_cli.view.sheet._REWRITE_FACTOR", 0)
    target, seen = tmp_path / "page.html", []

    def watch(done):
        if not done:
            assert not target.exists()
            return
        if not seen:
            seen.append(Page(browser, target.as_uri(), offline=True))
            page = seen[0].page
            pending = page.locator("#views .missing", has_text="pending")
            pending.nth(2).wait_for(timeout=20_000)
            assert pending.count() == 3
            assert "1 of 4 trials so far" in page.locator("main").inner_text()
            assert seen[0].overflow() <= 0
            page.get_by_label("Sort by").focus()
        if done == 3:
            seen[0].page.locator("img[alt='beta 3']").wait_for(timeout=20_000)

    sweep_watched(target, watch)
    page = seen[0].page
    page.locator("main", has_text="4 trials.").wait_for(timeout=20_000)
    page.locator("main[data-state='']").wait_for(timeout=20_000)
    assert page.locator("#views li").count() == 5
    assert page.evaluate("document.activeElement.id") == "sort"
    assert seen[0].errors == []


@pytest.mark.parametrize("error", [KeyboardInterrupt, MemoryError])
def test_a_sweep_that_ends_early_leaves_what_it_has_and_says_so(browser, tmp_path, error):
    target = tmp_path / "page.html"

    def end_at(last):
        def watch(done):
            if done == last:
                raise error

        return watch

    with pytest.raises(error):
        sweep_watched(target, end_at(0))
    assert not list(tmp_path.iterdir())
    with pytest.raises(error):
        sweep_watched(target, end_at(2))
    assert list(tmp_path.iterdir()) == [target]
    sheet = Page(browser, target.as_uri())
    assert "2 of 4 trials before the sweep ended early" in sheet.page.locator("main").inner_text()
    assert sheet.page.locator("#views .missing", has_text="not tried").count() == 2
    assert sheet.page.locator("#views img").count() == 3
    assert not sheet.page.get_by_label("load results").is_visible()


NAME = "<img src=x onerror=alert(1)>&amp;'\"<-script>.obj"


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """The address of each page on a model whose names are markup; its two charts meet in a seam."""
    pytest.importorskip("embreex")
    folder, random = tmp_path_factory.mktemp("pages"), np.random.default_rng(0)
    for image in ("<b>one.png", "two.png"):
        (folder / image).write_bytes(encode(random.integers(90, 110, (32, 32, 3), np.uint8), "png"))
    model = textured_squares(folder / "a.obj", ("<b>one.png", 0, (0.1, 0.9)), ("two.png", 1, (0.1, 0.9)))
    model = model.rename(folder / NAME)
    addresses = {
        "view": "",
        "report": (folder / "report.html").as_uri(),
        "sweep": (folder / "sweep.html").as_uri(),
    }
    beltrami("report", model, model, folder / "report.html")
    beltrami("sweep", model, folder / "sweep.html", "--beta", "2,4", "-n", 1, "--size", 120)
    live = Served(model.name, folder)
    yield addresses | {"view": live.address}
    live.end()


@pytest.mark.parametrize("name", ["report", "sweep", "view"])
def test_a_page_fits_bars_nobody_and_shows_names_as_text(browser, pages, name):
    shown = (Page if name == "sweep" else Viewer)(browser, pages[name])
    assert NAME in shown.page.locator("h1").inner_text()
    assert shown.page.locator("main b").count() == 0
    assert shown.page.locator("img[src=x]").count() == 0
    for width, scheme in ((NARROW, "dark"), (WIDE, "light")):
        shown.page.emulate_media(color_scheme=scheme)
        shown.page.set_viewport_size({"width": width, "height": 700})
        assert_operable(shown)
        open_all_of(name, shown, width)
        assert_operable(shown)
        shown.page.keyboard.press("Escape")  # closes the dialog of a sweep
    assert shown.errors == []


def assert_operable(shown):
    assert shown.overflow() <= 0
    assert shown.violations() == []


def open_all_of(name, shown, width):
    """Show what a page shows only when it is asked for."""
    if name == "report":
        assert 0.6 * width < shown.part("place").bounding_box()["width"] <= width
        for part in ("lit", "wires", "charts", "seams", "texels"):
            shown.part(part).check()
        shown.page.get_by_label("difference", exact=True).check()
    elif name == "sweep":
        shown.page.locator("#views button").nth(1).click()
    else:
        save = shown.page.get_by_role("button", name="Save", exact=True)
        assert 0 <= save.bounding_box()["x"] <= width - save.bounding_box()["width"]
