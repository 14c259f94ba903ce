"""Writes models for the survey that are not to be had as files.

    python benchmarks/survey_models.py OUT FOLDER...

OUT/own: sheets with tiles in all numberings, and packages to the layout of phones' scans. OUT/ktx2 and OUT/avif: the
textured glTF files in the folders, with their images in these formats.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from beltrami_cli.errors import BeltramiError
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.jobs.smooth import smooth_file
from beltrami_cli.layers.settings import SmoothSettings, TextureSettings
from formats.gltf_files import gltf_files
from formats.tile_files import tiled_model
from formats.usd_files import phone_scan

PATTERNS = ("skin.<UDIM>.png", "skin_<udim>.png", "<UVTILE>.skin.png", "skin<uvtile>.png")


def write_own(folder: Path) -> None:
    """Write sheets and scans, each into a folder of its own."""
    for number, pattern in enumerate(PATTERNS):
        tiled_model(folder / f"tiles{number}", pattern)
    for udim in (False, True):
        phone_scan(folder / f"scan{int(udim)}", udim=udim)
        (folder / f"scan{int(udim)}" / "baked.usdc").unlink()  # what the package was made of


def write_as(suffix: str, source: Path, folder: Path) -> None:
    """Write a glTF file with its images in another format; nothing, if it has no textures."""
    settings = SmoothSettings(
        KernelParameters(iterations=1, beta=10), on="texture", textures=TextureSettings(image_suffix=suffix)
    )
    folder.mkdir(parents=True)
    try:
        smooth_file(source, folder / source.name, settings)
    except BeltramiError as error:
        folder.rmdir()
        print(error, file=sys.stderr)


def main() -> None:
    """Write all of them."""
    out, *folders = map(Path, sys.argv[1:])
    write_own(out / "own")
    for file in (file for folder in folders for file in gltf_files(folder)):
        for suffix in (".ktx2", ".avif"):
            write_as(suffix, file, out / suffix[1:] / file.parent.name / file.stem)


if __name__ == "__main__":
    main()
