"""Clean pictures that plain `smooth` changes, though there is no noise to remove.

``python benchmarks/bench_clean.py FOLDER...`` smooths up to 130 pictures of each folder by default parameters: an even
sample of the pictures with sides of 64 to 1024 pixels. The table shows how many pictures changed at all, and how many
have a PSNR below 35 and 40 dB, over the pixels that are not transparent.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np

import beltrami_cli
from beltrami_cli.errors import BeltramiError
from beltrami_cli.formats.image import read_image

SUFFIXES = ".png", ".jpg", ".jpeg", ".tga", ".bmp", ".webp"
SIDES = 64, 1024
COUNT = 130
LIMITS = 35, 40
WORST = 5


def main():
    """Judge the pictures of all folders; print a table."""
    parser = argparse.ArgumentParser(description="Benchmark what happens to clean pictures.")
    parser.add_argument("folders", nargs="+", type=Path, help="with clean pictures")
    options = parser.parse_args()
    print("| folder | pictures | changed | below 35 dB | below 40 dB |\n|---|---|---|---|---|")
    for folder in options.folders:
        found = {path: psnr_after(path, before) for path, before in pictures(folder)}
        values = np.array(list(found.values()))
        shares = [np.mean(np.isfinite(values)), *(np.mean(values < limit) for limit in LIMITS)]
        print(f"| {folder.name} | {len(values)} |", " | ".join(f"{share:.1%}" for share in shares), "|")
        for path in sorted(found, key=found.__getitem__)[:WORST]:
            if found[path] < LIMITS[-1]:
                print(f"  {found[path]:.1f} dB: {path.relative_to(folder)}", flush=True)


def pictures(folder):
    """Yield pictures that are spread evenly over a folder."""
    paths = sorted(path for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES)
    every, wanted = np.arange(len(paths)) * 0.5698402909980532 % 1, COUNT  # spread evenly (M. Roberts, 2018)
    for number in np.argsort(every):
        try:
            pixels = read_image(paths[number].read_bytes(), paths[number].name).pixels
        except BeltramiError:
            continue
        sides = pixels.shape[:2]
        if pixels.dtype == np.uint8 and SIDES[0] <= min(sides) and max(sides) <= SIDES[1]:
            yield paths[number], pixels
            wanted -= 1
        if not wanted:
            return


def psnr_after(path, before):
    """Return the PSNR of a picture that was smoothed; infinite: it was not."""
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / path.name
        beltrami_cli.smooth_file(path, output)
        after = read_image(output.read_bytes(), path.name).pixels
    shown = before[..., -1] > 0 if before.shape[2] in (2, 4) else np.ones(before.shape[:2], bool)
    colours = before.shape[2] - (before.shape[2] in (2, 4))
    error = np.mean(np.square((after - before.astype(float))[shown][:, :colours]))
    return 10 * np.log10(255**2 / error) if error else np.inf


if __name__ == "__main__":
    main()
