"""Measure how well outliers are distinguished from thin detail: ``python benchmarks/bench_outliers.py FOLDER...``.

The PNG and JPEG files of the folders must not have outliers. For several values of the constants, the table has the
number of files in which outliers are found. It also has the shares of missed outliers and of wrongly replaced pixels if
0.5, 2 and 10 % of the pixels of the four most colourful images are made black and white, or red, with and without
noise of 10/255.
"""

import sys

import numpy as np

from beltrami_cli.arrays import Array
from beltrami_cli.flow.corrections import outliers
from beltrami_cli.flow.manifolds.grid.surroundings import CanvasSurroundings
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.formats.image.reading import read_image
from beltrami_cli.formats.image.sample_types import full_scale_one
from beltrami_cli.surface.grid_atlas import grid_atlas
from harness import arguments, show

LARGEST = 512  # pixels per side that are judged
COLOURFUL = 4  # number of images that take impulses, the most colourful ones
TRIED: dict[str, list[float]] = {
    "_MIN_DEVIATIONS": [2.5, 4, 5], "_MIN_SHARE_OF_RANGE": [0.07, 0.15], "_WEAK_LIMIT": [0.2, 0.5],
    "_SAME_VALUE": [0.03, 0.12], "_MIN_CLUMPS": [10, 30], "_MAJORITY": [0.5, 0.8],
}  # fmt: skip


def found_in(image: Array) -> Array:
    """Return the mask of outliers that are found in an image, shape (H, W)."""
    atlas = grid_atlas(image.shape[:2], 2, None, np.ones(image.shape[:2], bool))
    planes = np.zeros((image.shape[2], *atlas.kind.shape), np.float32)
    planes[:, 2:-2, 2:-2] = np.moveaxis(image, 2, 0)
    _, made = outliers.fill_outliers(planes, CanvasSurroundings(atlas), KernelParameters(), is_light=False)
    wrong = np.zeros(image.shape[0] * image.shape[1], bool)
    if made is not None:
        wrong[made.samples] = True
    return wrong.reshape(image.shape[:2])


def with_impulses(clean: list[Array]) -> list[tuple[Array, Array]]:
    rng, made = np.random.default_rng(0), []
    for image in clean:
        for share in (0.005, 0.02, 0.1):
            for sigma in (0, 10):
                noisy = np.rint(255 * image + rng.normal(0, sigma, image.shape)).clip(0, 255) / 255
                where = rng.random(image.shape[:2]) < share
                for values in ((rng.random(where.sum()) < 0.5)[:, None], np.array([220, 20, 20]) / 255):
                    spoiled = noisy.copy()
                    spoiled[where] = values
                    made.append((spoiled, where))
    return made


def judge(clean: list[Array], spoiled: list[tuple[Array, Array]]) -> tuple[str, str, str]:
    """Return the number of clean images that change, and the missed and wrongly replaced pixels per impulse."""
    harmed = sum(bool(found_in(image).any()) for image in clean)
    missed = false = every = 0
    for image, where in spoiled:
        found = found_in(image)
        missed += int((where & ~found).sum())
        false += int((found & ~where).sum())
        every += int(where.sum())
    return f"{harmed} of {len(clean)}", f"{100 * missed / every:.2f} %", f"{100 * false / every:.2f} %"


def main() -> None:
    options = arguments(__doc__, "folders", required=True)
    paths = sorted(path for folder in options.folders for path in folder.rglob("*.[jp][pn]g"))
    images = [read_image(path.read_bytes(), path.name) for path in paths]
    clean = [full_scale_one(each.pixels[:LARGEST, :LARGEST, list(each.colour)]) for each in images]
    coloured = sorted((each for each in clean if each.shape[2] == 3), key=lambda each: -len(np.unique(each)))
    if not coloured:
        sys.exit("no PNG or JPEG file with colours in the folders")
    spoiled = with_impulses(coloured[:COLOURFUL])
    rows = [("as they are", *judge(clean, spoiled))]
    for name, values in TRIED.items():
        kept = getattr(outliers, name)
        for value in values:
            setattr(outliers, name, value)
            rows.append((f"{name} = {value}", *judge(clean, spoiled)))
        setattr(outliers, name, kept)
    show(rows, options, ("constants", "images changed", "missed", "wrongly replaced"))


if __name__ == "__main__":
    main()
