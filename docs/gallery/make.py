"""Make the pictures of the gallery: ``make gallery``, or ``python docs/gallery/make.py [FOLDER]``.

Every command is read from docs/gallery.md and run as it stands there, so that the page shows what it says.
"""

from __future__ import annotations

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


def main(arguments: list[str]) -> int:
    """Run the commands of the page in a folder with the samples, and keep the pictures."""
    kept = Path(arguments[0]) if arguments else HERE
    text = PAGE.read_text(encoding="utf-8")
    kept.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        for sample in SAMPLES.iterdir():
            if sample.is_file() and sample.suffix not in {".py", ".md"}:
                shutil.copy(sample, folder)
        for command in commands(text):
            words = shlex.split(command, comments=True)
            print(command)
            subprocess.run([sys.executable, "-m", "beltrami_cli", *words[1:]], cwd=folder, check=True)
        for name in re.findall(r"\(gallery/([^)]+)\)", text):
            shutil.copy(Path(folder) / name, kept)
    return 0


def commands(page: str) -> list[str]:
    """Return the commands in the page's blocks of shell, with continued lines joined."""
    blocks = page.split("```sh\n")[1:]
    lines = "".join(block.split("```")[0] for block in blocks).replace("\\\n", " ").splitlines()
    return [line for line in lines if line.startswith("beltrami ")]


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
