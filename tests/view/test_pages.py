"""All pages in a browser: they fit their window, bar nobody, fetch nothing, and show names as text."""

from __future__ import annotations

import numpy as np
import pytest

from cli.commands import beltrami
from formats.image_files import encode
from small_models import textured_squares
from view.browsing import WIDTHS, Page, Served, Viewer

pytestmark = pytest.mark.slow
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


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("name", ["report", "sweep", "view"])
def test_a_page_fits_bars_nobody_and_shows_names_as_text(browser, pages, name, width):
    kind = Page if name == "sweep" else Viewer
    shown = kind(browser, pages[name], width=width, color_scheme="dark" if width == 768 else "light")
    assert NAME in shown.page.locator("h1").inner_text()
    assert shown.page.locator("main b").count() == 0
    assert shown.page.locator("img[src=x]").count() == 0
    assert shown.overflow() <= 0
    assert shown.violations() == []
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
    assert shown.overflow() <= 0
    assert shown.violations() == []
    assert shown.errors == []
