"""Make the pictures of the gallery: ``make gallery``, or ``python docs/gallery/make.py [FOLDER]``.

Every command is read from docs/gallery.md and run as it stands there, so that the page shows what it says. The statue
is looked for in the folder that the environment variable BELTRAMI_EXTRA_MESHES names; without it its pictures stay.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
PAGE = HERE.parent / "gallery.md"
SAMPLES = HERE.parents[1] / "sample_data"
EXTRA = "statue.glb"  # from the examples of PlayCanvas
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


def main(arguments: list[str]) -> int:
    """Run the commands of the page in a folder with the samples, and keep the pictures."""
    kept = Path(arguments[0]) if arguments else HERE
    text = PAGE.read_text(encoding="utf-8")
    kept.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        for sample in SAMPLES.iterdir():
            if sample.is_file() and sample.suffix not in {".py", ".md"}:
                shutil.copy(sample, folder)
        extra = next(Path(os.environ.get("BELTRAMI_EXTRA_MESHES") or folder).rglob(EXTRA), None)
        if extra is not None:
            shutil.copyfile(extra, Path(folder) / EXTRA)
        missing = {EXTRA} if extra is None else set()
        for command in commands(text):
            words = shlex.split(command, comments=True)
            print(command)
            if missing & {*words}:
                print("is left out, since BELTRAMI_EXTRA_MESHES has no such model")
                missing |= {word for word in words if Path(word).suffix in {".glb", ".ply", ".png"}}
                continue
            call = [sys.executable, "-m", "beltrami_cli", *words[1:]]
            if words[1] == "view":
                take_live(call, folder)
                continue
            subprocess.run(call, cwd=folder, check=True)
            for page in (Path(folder) / word for word in words if word.endswith(".html")):
                take(page.as_uri(), page.with_suffix(".png"), "main")
        for name in re.findall(r"\(gallery/([^)]+)\)", text):
            if name not in missing and ((Path(folder) / name).exists() or CHROMIUM):
                shutil.copy(Path(folder) / name, kept)
    return 0


def take_live(call: list[str], folder: str) -> None:
    """Take a picture of the live view, when all is smoothed."""
    running = subprocess.Popen([*call, "--no-open"], cwd=folder, stderr=subprocess.PIPE, text=True)
    try:
        address = re.search(r"http://\S+", running.stderr.readline())
        take(address[0], Path(folder) / "view.png", "#viewer[data-whole]")
    finally:
        running.terminate()
        running.wait()


def take(address: str, picture: Path, ready: str) -> None:
    """Take a picture of a page in Chromium, when a part of it is there; without Chromium the old one is kept."""
    if CHROMIUM is None:
        print(f"there is no Chromium, so {picture.name} stays as it is")
        return
    from playwright.sync_api import sync_playwright

    flags = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    with sync_playwright() as running:
        browser = running.chromium.launch(executable_path=CHROMIUM, args=flags)
        page = browser.new_page(viewport={"width": 1280, "height": 900})
        page.goto(address)
        page.wait_for_selector(ready, timeout=120_000)
        page.wait_for_timeout(1000)  # until the models are drawn
        page.screenshot(path=picture)
        browser.close()


def commands(page: str) -> list[str]:
    """Return the commands in the page's blocks of shell, with continued lines joined."""
    blocks = page.split("```sh\n")[1:]
    lines = "".join(block.split("```")[0] for block in blocks).replace("\\\n", " ").splitlines()
    return [line for line in lines if line.startswith("beltrami ")]


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
