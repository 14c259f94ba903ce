"""`beltrami view`: a page that smooths, and what it saves."""

import re
import shlex
import shutil
import signal
import subprocess
import time

import numpy as np
import pytest

from beltrami_cli.formats.image.reading import read_image
from cli.commands import COMMAND, SAMPLES, beltrami
from cli.pictures import textured_square
from view.browsing import Served, Viewer

NOISY = SAMPLES / "nonmanifold-noisy.ply"


@pytest.fixture
def served(tmp_path):
    running = []

    def start(source, *arguments):
        running.append(Served(source, tmp_path, *arguments))
        return running[-1]

    yield start
    for each in running:
        if each.process.poll() is None:
            each.process.kill()
            each.process.wait()
        each.process.stderr.close()


class LiveViewer(Viewer):
    """The page in a browser."""

    def data(self, name):
        return self.page.locator("#viewer").get_attribute(f"data-{name}")

    def wait_for(self, name, before=None):
        """Wait until something of the page is there, or another than before."""
        end = time.monotonic() + 60
        while self.data(name) in (None, before):
            assert time.monotonic() < end, self.page.locator("#state").inner_text()
            self.page.wait_for_timeout(20)
        return self.data(name)

    def slide(self, name, value):
        self.page.locator(f"#{name}").fill(str(value))

    def roughness(self):
        """How much neighbouring pixels in the middle of the view differ."""
        shot = read_image(self.part("place").screenshot(), "").pixels.astype(float)
        height, width = shot.shape[:2]
        middle = shot[height // 2 - 40 : height // 2 + 40, width // 2 - 40 : width // 2 + 40, :3]
        return float(np.abs(np.diff(middle, axis=1)).mean())


# Threads of the core that do not end in time would make Python abort as it ends.
NEVER_ENDS = (
    "from beltrami_cli.view.live.live import Live; Live.close = lambda self: False; "
    "from beltrami_cli.__main__ import main; main()"
)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_a_signal_ends_it_in_one_line_with_its_code_while_work_goes_on(name):
    number = getattr(signal, name)
    command = [*COMMAND[:2], "-c", NEVER_ENDS, "view", NOISY, "--no-open"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        assert "shown at" in process.stderr.readline()
        process.send_signal(number)
        said = process.stderr.read().splitlines()
    assert said[-1] == "beltrami: interrupted; files are as they were, or complete"
    assert process.returncode == 128 + number


@pytest.mark.slow
def test_a_change_arrives_and_closing_the_page_ends_the_program(browser, served):
    live = served(NOISY, "--strength", "gentle")
    viewer = LiveViewer(browser, live.address)
    assert viewer.page.locator("#strength").input_value() == "0.7"
    assert "--strength gentle" in viewer.page.locator("#command").inner_text()
    viewer.slide("strength", 1)
    viewer.page.get_by_label("after", exact=True).check()
    first = viewer.wait_for("whole")
    smooth_one = viewer.roughness()
    viewer.slide("iterations", 1)
    viewer.slide("beta", 40)
    viewer.wait_for("whole", first)
    rough = viewer.roughness()
    assert smooth_one < 0.8 * rough
    viewer.page.keyboard.press("b")
    assert viewer.roughness() > rough
    command = viewer.page.locator("#command").inner_text()
    assert all(words in command for words in ("-n 1", "--beta 40", "--fast"))
    assert viewer.errors == []
    viewer.page.close()
    assert live.process.wait(timeout=15) == 0


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".obj", ".png"])
def test_previews_of_textures_and_images_come_before_the_whole(browser, served, tmp_path, suffix):
    noise = np.random.default_rng(1).integers(60, 200, (12, 12, 3))
    source = textured_square(tmp_path / "square.obj", noise).with_suffix(suffix)
    viewer = LiveViewer(browser, served(source.name).address)
    viewer.page.get_by_label("after", exact=True).check()
    viewer.wait_for("whole")
    rough = viewer.roughness()
    before = viewer.data("previews")
    for name, value in (("iterations", 8), ("time step", 10), ("beta", 0)):
        viewer.page.get_by_label(name, exact=True).fill(str(value))
    viewer.wait_for("previews", before)
    viewer.wait_for("whole", viewer.data("whole"))
    assert viewer.roughness() < rough
    assert viewer.errors == []


@pytest.mark.slow
def test_what_is_saved_is_what_smooth_writes_with_its_refusals(browser, served, tmp_path):
    for name in ("mirrored-noisy.obj", "mirrored-noisy.mtl", "mirrored-noisy.png"):
        shutil.copy(SAMPLES / name, tmp_path)
    live = served("mirrored-noisy.obj")
    viewer = LiveViewer(browser, live.address)
    viewer.slide("iterations", 2)
    viewer.slide("beta", 9)
    target, save = viewer.page.locator("#target"), viewer.page.get_by_role("button", name="Save", exact=True)
    target.fill("saved.obj")
    target.press("Tab")
    save.click()
    viewer.page.wait_for_selector("#saved:has-text('Written')", timeout=60_000)
    words = shlex.split(viewer.page.locator("#command").inner_text())
    assert words[:4] == ["beltrami", "smooth", "mirrored-noisy.obj", "saved.obj"]
    other = tmp_path / "other"
    other.mkdir()
    for name in ("mirrored-noisy.obj", "mirrored-noisy.mtl", "mirrored-noisy.png"):
        shutil.copy(SAMPLES / name, other)
    beltrami(*words[1:], cwd=other)
    written = sorted(path.name for path in other.iterdir())
    assert written == sorted(path.name for path in tmp_path.iterdir() if path.is_file())
    assert all((other / name).read_bytes() == (tmp_path / name).read_bytes() for name in written)
    save.click()
    refused = beltrami(*words[1:], code=4, cwd=other).stderr.decode().strip().removeprefix("beltrami: ")
    viewer.page.locator("#saved", has_text=refused).wait_for(timeout=30_000)


@pytest.mark.slow
def test_noise_is_given_or_shown_as_estimated_and_refused_in_the_words_of_the_program(
    browser, served, tmp_path
):
    viewer = LiveViewer(browser, served(NOISY).address)
    first, noise = viewer.wait_for("whole"), viewer.page.get_by_label("noise", exact=True)
    estimated = re.fullmatch(r"estimated: (?:about )?([\d.]+/255).*", noise.get_attribute("placeholder"))[1]
    assert re.search(r"noise\s+.*[\d.]+/255", viewer.page.locator("#used").inner_text())
    command = viewer.page.locator("#command").inner_text()
    assert "--noise" not in command
    noise.fill("a lot")
    noise.press("Enter")
    refused = (
        beltrami("smooth", NOISY, tmp_path / "out.ply", "--noise", "a lot", code=2).stderr.decode().strip()
    )
    said = refused.rpartition("must be")[2]
    viewer.page.locator("#state", has_text=said).wait_for(timeout=30_000)
    assert viewer.page.locator("#command").inner_text() == command
    noise.fill(estimated)
    noise.press("Enter")
    viewer.wait_for("whole", first)
    assert f"--noise {estimated} " in viewer.page.locator("#command").inner_text() + " "
    assert f"given as {estimated}" in viewer.page.locator("#used").inner_text()


@pytest.mark.slow
def test_two_pages_are_apart_and_learn_that_the_program_was_killed(browser, served):
    live = served(NOISY)
    one, other = LiveViewer(browser, live.address), LiveViewer(browser, live.address)
    one.wait_for("whole")
    shown = other.wait_for("whole")
    one.slide("beta", 3)
    one.wait_for("whole", one.data("whole"))
    assert "--beta 3" in one.page.locator("#command").inner_text()
    assert "--beta" not in other.page.locator("#command").inner_text()
    assert other.data("whole") == shown
    one.page.close()
    other.slide("beta", 5)
    other.wait_for("whole", shown)
    live.process.kill()
    other.page.locator("#state", has_text="has ended").wait_for(timeout=15_000)
    assert other.page.locator("#beta").is_disabled()


@pytest.mark.slow
def test_a_page_says_why_there_is_no_preview(browser, served):
    viewer = LiveViewer(browser, served(SAMPLES / "torus-two-noisy.gltf", "--level", "-n", "1").address)
    viewer.page.locator("#state", has_text="No preview: exposure steps are levelled").wait_for(timeout=30_000)
    viewer.wait_for("whole")
    assert viewer.page.locator("#state").inner_text() == "Done."
    assert viewer.data("previews") is None
    assert viewer.errors == []
