"""The page of `beltrami sweep` in a browser: sorting, and views next to the input."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from beltrami_cli.jobs.job import Job
from beltrami_cli.layers.settings import DEFAULTS
from beltrami_cli.view.settings import RenderSettings
from beltrami_cli.view.sweep import sweep_file
from cli.commands import SAMPLES, beltrami
from view.browsing import Page

pytestmark = pytest.mark.slow
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
    monkeypatch.setattr("beltrami_cli.view.sweep._REST", 0)
    target, seen = tmp_path / "page.html", []

    def watch(done):
        if not done:
            assert not target.exists()
            return
        if not seen:
            seen.append(Page(browser, target.as_uri(), offline=True))
            page = seen[0].page
            assert page.locator("#views .missing", has_text="pending").count() == 3
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
