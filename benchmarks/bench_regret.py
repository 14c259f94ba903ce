"""Measure the PSNR that is lost because the noise is estimated: the figure by which estimates are judged.

``python benchmarks/bench_regret.py [FOLDER...]`` smooths pictures, vertices, clouds and light by default parameters,
and again with the true RMS noise before clipping ("told"). The loss of a noisy picture is PSNR(told) - PSNR(default),
at least 0. That of a clean picture is the difference of its PSNR from 42 dB if it is below. All kinds have the same
weight; noisy kinds contribute 70 %, clean kinds 30 %. Noise counts as not found if the result is the input although the
true noise gains more than 0.5 dB.

Pictures are generated, photographs of scikit-image that the noise model is not trained on, and files of folders, which
must not be training pictures either. For example, four packages of Debian::

    apt-get download extremetuxracer-data freedroidrpg-data torcs-data tuxpaint-stamps-default
    for package in *.deb; do dpkg-deb --extract $package build/pictures/${package%%_*}; done
    python benchmarks/bench_regret.py build/pictures/*
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from regret_scene import kinds, rms

CLEAN_PSNR = 42.0  # dB from which on a clean picture counts as unchanged
NOISY_SHARE = 0.7  # weight of the noisy kinds in the loss
MIN_MISSED_GAIN = 0.5  # minimum gain in dB by the true noise where noise is not found
MIN_GAIN = 0.05  # gain in dB below which a result is the input


@dataclass(frozen=True)
class Row:
    """Figures of a case: noise of 255, and PSNR in dB."""

    kind: str
    name: str
    rms: float
    read: float  # estimated RMS noise
    given: float  # PSNR of the input
    default: float  # PSNR by default parameters
    told: float  # PSNR with the true noise; of a clean picture: `CLEAN_PSNR`
    interval: Any  # None: no interval is reported

    @property
    def lost(self):
        return max(0.0, self.told - self.default)

    @property
    def is_missed(self):
        return self.rms > 0 and self.default - self.given < MIN_GAIN and self.lost > MIN_MISSED_GAIN

    @property
    def holds(self):
        least, most = self.interval
        return least <= self.default and (most is None or self.default <= most)


def main():
    parser = argparse.ArgumentParser(
        description="Measure the PSNR that is lost because the noise is estimated."
    )
    parser.add_argument("folders", nargs="*", type=Path, help="with pictures that training has not seen")
    parser.add_argument("--kinds", default="", help="names, or how they begin, separated by commas")
    parser.add_argument("--quick", action="store_true", help="the fewest pictures of each kind")
    parser.add_argument("--readings", action="store_true", help="print each noise beside what was read")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all figures into a file")
    options = parser.parse_args()
    start, rows = time.process_time(), []
    for kind, cases in kinds(options.folders).items():
        if kind.startswith(tuple(options.kinds.split(","))):
            for case in islice(cases, 2 if options.quick else None):
                rows.append(judged(kind, case))
                if options.readings:
                    show_reading(rows[-1])
    if not rows:
        parser.error(f"no kind begins with {options.kinds!r}")
    figures = {"kinds": by_kind(rows), "lost": total(rows), "rows": [asdict(row) for row in rows]}
    show(figures)
    print(f"\n{time.process_time() - start:.0f} s of processor time")
    if options.json:
        options.json.write_text(json.dumps(figures, indent=1) + "\n")


def judged(kind, case):
    """Smooth a case by default parameters, and with its true noise."""
    result = case.smooth(case.given)
    told = CLEAN_PSNR
    if not kind.startswith("clean"):
        told = case.psnr(case.smooth(case.given, noise=f"{100 * case.rms:.4f}%").colours)
    read = 255 * rms(result.noise)
    given, default = case.psnr(case.given), case.psnr(result.colours)
    return Row(kind, case.name, 255 * case.rms, read, given, default, told, result.interval or None)


def by_kind(rows):
    figures = {}
    for kind in dict.fromkeys(row.kind for row in rows):
        of_kind = [row for row in rows if row.kind == kind]
        reported = [row for row in of_kind if row.interval is not None]
        figures[kind] = {
            "pictures": len(of_kind),
            "lost": float(np.mean([row.lost for row in of_kind])),
            "worst": max(row.lost for row in of_kind),
            "missed": sum(row.is_missed for row in of_kind),
            "hold": sum(row.holds for row in reported),
            "intervals": len(reported),
        }
    return figures


def total(rows):
    """Return the mean loss in all, of noisy and of clean kinds; None if there are no such kinds."""
    figures = by_kind(rows)
    clean = [each["lost"] for kind, each in figures.items() if kind.startswith("clean")]
    noisy = [each["lost"] for kind, each in figures.items() if not kind.startswith("clean")]
    means = [float(np.mean(values)) if values else None for values in (noisy, clean)]
    both = None if None in means else NOISY_SHARE * means[0] + (1 - NOISY_SHARE) * means[1]
    return {"all": both, "noisy": means[0], "clean": means[1]}


def show_reading(row):
    """Print the true and the estimated noise of a case, and the PSNR of the input and of both results."""
    psnrs = f"{row.given:.1f} -> {row.default:.1f}, {row.told:.1f} told"
    print(f"{row.kind}, {row.name}: noise of {row.rms:.1f} read as {row.read:.1f}; {psnrs}", flush=True)


def show(figures):
    print("| kind | pictures | dB lost | worst | not found | intervals hold |\n|---|" + "---:|" * 5)
    for kind, each in figures["kinds"].items():
        counts = f"{each['missed']} | {each['hold']} of {each['intervals']}"
        print(f"| {kind} | {each['pictures']} | {each['lost']:.2f} | {each['worst']:.1f} | {counts} |")
    missed, hold, intervals = (
        sum(each[key] for each in figures["kinds"].values()) for key in ("missed", "hold", "intervals")
    )
    noisy = sum(row["rms"] > 0 for row in figures["rows"])
    print(f"\nnot found: {missed} of {noisy}; intervals that hold: {hold} of {intervals}")
    losses = [f"{name} {value:.2f}" for name, value in figures["lost"].items() if value is not None]
    print("dB lost:", ", ".join(losses))


if __name__ == "__main__":
    main()
