"""Count clean images that `smooth` changes although there is no noise to remove.

``python benchmarks/bench_clean.py FOLDER...`` smooths up to 130 images of each folder by default parameters: an even
sample of the images with sides of 64 to 1024 pixels. The table has the share of images that changed at all, the
shares with a PSNR below 40 and 35 dB over the pixels that are not transparent, and the worst image.
"""

import tempfile
from pathlib import Path

import numpy as np

import beltrami_cli
from beltrami_cli.arrays import Array
from beltrami_cli.formats.image.reading import read_image
from harness import arguments, psnr, show
from pixels import images_of


def main() -> None:
    options = arguments(__doc__, "folders", required=True)
    rows = []
    for folder in options.folders:
        found = {path.relative_to(folder): psnr_after(path, image) for path, image in images_of(folder)}
        values = np.array(list(found.values()))
        shares = (f"{np.mean(values < limit):.1%}" for limit in (np.inf, 40, 35))
        worst = min(found, key=found.__getitem__)
        rows.append((folder.name, len(found), *shares, f"{worst}: {found[worst]:.1f} dB"))
    show(rows, options, ("folder", "images", "changed", "below 40 dB", "below 35 dB", "worst"))


def psnr_after(path: Path, before: Array) -> float:
    """Return the PSNR of a smoothed image against the input; infinite if it was not changed."""
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / path.name
        beltrami_cli.smooth_file(path, output)
        after = read_image(output.read_bytes(), path.name).pixels
    has_alpha = before.shape[2] in (2, 4)
    shown = before[..., -1] > 0 if has_alpha else ...
    colours = slice(before.shape[2] - has_alpha)
    if np.array_equal(after, before):
        return np.inf
    return psnr(after[..., colours] / 255, before[..., colours] / 255, shown)


if __name__ == "__main__":
    main()
