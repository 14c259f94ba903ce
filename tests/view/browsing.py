"""Pages in Chromium, as a user sees and operates them."""

import re
import signal
import subprocess

import pytest

from beltrami_cli.formats.image.reading import read_image
from cli.commands import COMMAND

RED, BLUE, WHITE = (255, 0, 0), (0, 0, 255), (255, 255, 255)
NARROW, WIDE = 320, 1280  # on either side of the width at which pages are laid out otherwise


class Served:
    """A running `beltrami view`, with the address of its page."""

    def __init__(self, source, folder, *arguments):
        # The choice of parameters is not the point here.
        command = [*COMMAND, "view", source, "--no-open", "--fast", *arguments]
        self.process = subprocess.Popen(command, cwd=folder, stderr=subprocess.PIPE, text=True)
        self.address = re.search(r"http://\S+", self.process.stderr.readline())[0]

    def end(self):
        """End it as Ctrl-C does; return its exit code."""
        self.process.send_signal(signal.SIGINT)
        try:
            return self.process.wait(timeout=20)
        finally:
            self.process.stderr.close()


class Page:
    """A page in a window of its own, with what went wrong in it and what it asked for."""

    def __init__(self, browser, address, width=900, height=700, **options):
        context = browser.new_context(viewport={"width": width, "height": height}, **options)
        self.page, self.errors, self.requests = context.new_page(), [], []
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.on("console", lambda said: self.errors.append(said.text) if said.type == "error" else None)
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.goto(address)

    def fetched(self):
        """What was asked for besides what the page holds itself."""
        return [url for url in self.requests if not url.startswith(("data:", "blob:"))]

    def part(self, name):
        return self.page.locator(f"[data-viewer={name}]")

    def overflow(self):
        """By how many pixels the page is wider than its window."""
        return self.page.evaluate("document.documentElement.scrollWidth - window.innerWidth")

    def violations(self):
        """What axe-core finds against the accessibility guidelines, WCAG 2.2 AA and best practice."""
        axe = pytest.importorskip("axe_playwright_python.sync_playwright")
        found = axe.Axe().run(self.page).response["violations"]
        return [(each["id"], [node["html"] for node in each["nodes"]]) for each in found]


class Viewer(Page):
    """A page with its models drawn."""

    def __init__(self, browser, address, **options):
        super().__init__(browser, address, **options)
        self.page.wait_for_selector(".place[data-ready=yes]", timeout=60_000)
        self.box = self.part("place").bounding_box()

    def halves(self):
        """The colours to the left and to the right of the middle."""
        return self.pixel(-0.2, 0.1), self.pixel(0.2, 0.1)

    def pixel(self, right, up):
        """The colour at a place from the middle, in heights of the view."""
        self.page.evaluate(
            "() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
        )
        shot = read_image(self.part("place").screenshot(), "").pixels
        height, width = shot.shape[:2]
        at = shot[round(height * (0.5 - up)), round(width / 2 + right * height)]
        return tuple(int(value) for value in at[:3])

    def drag(self, start, end):
        """Drag from one place to another, in shares of the view."""
        places = [
            (self.box["x"] + self.box["width"] * x, self.box["y"] + self.box["height"] * y)
            for x, y in (start, end)
        ]
        self.page.mouse.move(*places[0])
        self.page.mouse.down()
        self.page.mouse.move(*places[1], steps=8)
        self.page.mouse.up()

    def swipe_to(self, share):
        """Drag the line, to the side that nothing else lies on."""
        at = min(max(float(self.part("line").get_attribute("aria-valuenow")) / 100, 0.01), 0.99)
        self.drag((at, 0.95), (share, 0.95))

    def turn(self, degrees):
        """Drag the model: a whole turn is as long as the view is high."""
        share = self.box["height"] * degrees / 360 / self.box["width"]
        self.drag((0.1, 0.9), (0.1 + share, 0.9))
