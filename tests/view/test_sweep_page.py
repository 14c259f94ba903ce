"""The page of `beltrami sweep` in a browser: sorting, and views beside the input."""

from __future__ import annotations

import json

import pytest

from cli.commands import SAMPLES, beltrami
from view.browsing import WIDTHS, Page

pytestmark = pytest.mark.slow
NOISY, CLEAN = (SAMPLES / f"nonmanifold-{kind}.ply" for kind in ("noisy", "clean"))


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    pytest.importorskip("embreex")
    page = tmp_path_factory.mktemp("sweep") / "page.html"
    options = ("--beta", "2,4,12", "-n", "1,3", "--metric-steps", 1, "--reference", CLEAN, "--size", 120)
    run = beltrami("sweep", NOISY, page, *options)
    assert run.returncode == 0, run.stderr
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


@pytest.mark.parametrize("width", WIDTHS)
def test_the_page_fits_and_nothing_bars_anybody(browser, swept, width):
    sheet = Page(browser, swept, width=width, color_scheme="dark" if width == 768 else "light")
    assert sheet.overflow() <= 0
    assert sheet.violations() == []
    sheet.page.locator("#views button").nth(2).click()
    assert sheet.overflow() <= 0
    assert sheet.violations() == []
