"""Measure the PSNR that is lost because the noise is estimated: the figure by which estimates are judged.

``python benchmarks/bench_regret.py [FOLDER...]`` smooths images, vertices, clouds and light by default parameters,
and again with the true RMS noise before clipping. The loss of a noisy image is the difference of both PSNRs, at least
0. That of a clean image is the difference of its PSNR from 42 dB if it is below. All kinds have the same
weight; noisy kinds contribute 70 %, clean kinds 30 %. Noise counts as not found if the result is the input although the
true noise gains more than 0.5 dB. ``--kinds A,B`` judges the kinds that begin with A or B, and ``--quick`` two cases of
each kind; ``--readings`` prints a line for each case.

Images are generated, photographs of scikit-image that the noise model is not trained on, and files of folders, which
must not be training images either. For example, four packages of Debian::

    apt-get download extremetuxracer-data freedroidrpg-data torcs-data tuxpaint-stamps-default
    for package in *.deb; do dpkg-deb --extract $package build/images/${package%%_*}; done
    python benchmarks/bench_regret.py build/images/*
"""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, islice

import numpy as np

from harness import arguments, rms, show
from pixels import Interval
from regret_cases import Case, kinds

CLEAN_PSNR = 42.0  # dB from which on a clean image counts as unchanged
NOISY_SHARE = 0.7  # weight of the noisy kinds in the loss
MIN_MISSED_GAIN = 0.5  # minimum gain in dB by the true noise where noise is not found
MIN_GAIN = 0.05  # gain in dB below which a result is the input


@dataclass(frozen=True)
class Judged:
    """Figures of a case: noise of 255, and PSNR in dB."""

    rms: float
    read: float  # estimated RMS noise
    given: float  # PSNR of the input
    default: float  # PSNR by default parameters
    informed: float  # PSNR with the true noise; of a clean image: `CLEAN_PSNR`
    interval: Interval | None  # None: no interval is reported

    @property
    def lost(self) -> float:
        return max(0.0, self.informed - self.default)

    @property
    def is_missed(self) -> bool:
        return self.rms > 0 and self.default - self.given < MIN_GAIN and self.lost > MIN_MISSED_GAIN

    @property
    def holds(self) -> bool:
        return self.interval is not None and self.interval[0] <= self.default <= self.interval[1]


def main() -> None:
    options = arguments(__doc__, "folders", kinds="", quick=False, readings=False)
    most = 2 if options.quick else None
    judged = {
        kind: [judge(kind, case, shown=options.readings) for case in islice(cases, most)]
        for kind, cases in kinds(options.folders).items()
        if kind.startswith(tuple(options.kinds.split(",")))
    }
    if not judged:
        sys.exit(f"no kind begins with {options.kinds}")
    clean = {kind: cases for kind, cases in judged.items() if kind.startswith("clean")}
    noisy = {kind: cases for kind, cases in judged.items() if kind not in clean}
    rows = [(kind, mean_loss({kind: cases}), *figures(cases)) for kind, cases in judged.items()]
    for name, some in (("noisy", noisy), ("clean", clean)):
        if some:
            rows.append((name, mean_loss(some), *figures([*chain.from_iterable(some.values())])))
    if noisy and clean:
        loss = NOISY_SHARE * mean_loss(noisy) + (1 - NOISY_SHARE) * mean_loss(clean)
        rows.append(("all", loss, *figures([*chain.from_iterable(judged.values())])))
    show(rows, options, ("kind", "dB lost", "worst", "not found", "intervals hold"))


def mean_loss(judged: Mapping[str, Sequence[Judged]]) -> float:
    """Return the mean loss in dB over kinds, which have the same weight."""
    return float(np.mean([np.mean([each.lost for each in cases]) for cases in judged.values()]))


def judge(kind: str, case: Case, *, shown: bool) -> Judged:
    result, informed = case.smooth(case.given), CLEAN_PSNR
    if not kind.startswith("clean"):
        informed = case.psnr(case.smooth(case.given, noise=f"{100 * case.rms:.4f}%").colours)
    read, given, default = 255 * rms(result.noise), case.psnr(case.given), case.psnr(result.colours)
    if shown:
        psnrs = f"{given:.1f} -> {default:.1f}, {informed:.1f} with the true noise"
        print(f"{kind}, {case.name}: noise of {255 * case.rms:.1f} read as {read:.1f}; {psnrs}", flush=True)
    return Judged(255 * case.rms, read, given, default, informed, result.interval)


def figures(judged: Sequence[Judged]) -> tuple[float, str, str]:
    """Return the worst loss, how often noise was not found, and how often intervals held."""
    reported = [each for each in judged if each.interval is not None]
    worst, missed = max(each.lost for each in judged), sum(each.is_missed for each in judged)
    noisy = sum(each.rms > 0 for each in judged)
    return worst, f"{missed} of {noisy}", f"{sum(each.holds for each in reported)} of {len(reported)}"


if __name__ == "__main__":
    main()
