"""Make the sample meshes: ``python sample_data/make.py`` writes them, ``--check`` only compares."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import head
import head_tex
import knot
import mirrored
import nonmanifold
import scan
import sphere_exr
import terrain
import textured
import textured_files
import tiled
import torus_two
import writers
from comparison import same
from samples import noisy

if TYPE_CHECKING:
    from collections.abc import Iterator

    from samples import Sample
    from textured import TexturedSample

FOLDER = Path(__file__).parent
SHAPES = {"knot": knot.make, "head": head.make, "terrain": terrain.make, "nonmanifold": nonmanifold.make}
NOISE_SEEDS = {"knot": 1, "head": 2, "terrain": 3, "nonmanifold": 4}
PLY: dict[str, tuple[writers.Flavour, bool]] = {
    "knot": ("little", False),
    "head": ("little", False),
    "terrain": ("ascii", False),
    "nonmanifold": ("big", True),
}
COLOR_0 = {"knot": ("u2", 4), "head": ("f4", 3), "terrain": ("u1", 4), "nonmanifold": ("u2", 3)}

TEXTURED = {
    "head-tex": (head_tex.make, 5, (textured_files.obj, textured_files.glb)),
    "torus-two": (torus_two.make, 6, (textured_files.gltf,)),
    "mirrored": (mirrored.make, 7, (textured_files.obj,)),
    "tiled": (tiled.make, 8, (textured_files.glb,)),
    "sphere-exr": (sphere_exr.make, 9, (textured_files.obj,)),
    "scan": (scan.make, 10, (textured_files.ply, textured_files.glb)),
}  # how it is made, the seed of its noise, and what it is written as


def main(arguments: list[str] | None = None) -> int:
    """Write all files, or name the files that differ from the ones that would be written."""
    parser = argparse.ArgumentParser(description="Make the sample meshes.")
    parser.add_argument("--check", action="store_true", help="compare with the files there, write nothing")
    check = parser.parse_args(arguments).check
    differing = 0
    for name, data in files():
        path = FOLDER / name
        if not check:
            path.write_bytes(data)
        elif not path.is_file() or not same(path.read_bytes(), data, path.suffix):
            differing += 1
            print(f"{name}: {'differs' if path.is_file() else 'is missing'}", file=sys.stderr)
    return 1 if differing else 0


def samples() -> Iterator[tuple[str, Sample]]:
    """Yield every sample, clean and noisy, with the stem of its files."""
    for name, make in SHAPES.items():
        clean = make()
        yield f"{name}-clean", clean
        yield f"{name}-noisy", noisy(clean, NOISE_SEEDS[name])


def textured_samples() -> Iterator[tuple[str, TexturedSample]]:
    """Yield every textured sample, clean and noisy, with the stem of its files."""
    for name, (make, seed, _) in TEXTURED.items():
        clean = make()
        yield f"{name}-clean", clean
        yield f"{name}-noisy", textured.noisy(clean, seed)


def files() -> Iterator[tuple[str, bytes]]:
    """Yield the name and the bytes of every file."""
    for stem, sample in samples():
        name = stem.split("-")[0]
        yield f"{stem}.ply", writers.ply(sample, *PLY[name])
        yield f"{stem}.obj", writers.obj(sample)
        yield f"{stem}.glb", writers.glb(sample, *COLOR_0[name])
    for stem, model in textured_samples():
        for write in TEXTURED[stem.rsplit("-", 1)[0]][2]:
            yield from write(model, stem).items()
        if stem == "scan-clean":
            yield from textured_files.glb(scan.exposed(model), "scan-exposed").items()


if __name__ == "__main__":
    sys.exit(main())
