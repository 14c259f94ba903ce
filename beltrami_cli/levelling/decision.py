"""Whether there are exposure steps at all, and of which kind: each seam is foretold from the others.

A fit can take out any step. But only if steps are of exposure does a fit to some seams also foretell the steps at the
others, for each chart has several seams, and one exposure.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.levelling.fit import SHORT, fit_exposures

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.levelling.steps import Steps

# Expected deviations of gains, offsets, and tilts if any: strong and faint.
STRONG, FAINT = (0.1, 0.03), (0.03, 0.01)
_TILTS = 0.8  # of the gains
_FOLDS = 4
_FEWEST_SEAMS = 8  # below, parts of seams are foretold from the others
_STRETCHES = 4  # whose mean step is foretold: the pattern on it is averaged away
_SATURATED = 14 / 255  # steps count no more than this
_SURE = 0.25  # strong steps that are foretold so well are not tried as faint ones
# Shares of the energy of steps that must be foretold, and in how many standard errors over the seams: where it is more,
# one will do, as there may be few seams.
_ENOUGH = ((0.12, 2.0), (0.2, 0.9))


@dataclass(frozen=True)
class Verdict:
    """The deviations that foretell the steps best, and what share of their energy they do foretell."""

    spread: tuple[float, ...]
    share: float
    errors: float

    @property
    def is_sure(self) -> bool:
        """Whether there are exposure steps."""
        return any(self.share >= share and self.errors >= errors for share, errors in _ENOUGH)


def judge(steps: Steps, fixed: NDArray[np.bool_] | None = None) -> Verdict:
    """Choose the kind of exposure steps by cross-validation over the seams."""
    folds, groups = _folds(steps), _groups(steps)

    def tried(base: tuple[float, float]) -> list[Verdict]:
        tilt = _TILTS * base[0]
        return [_foretold(steps, each, folds, groups, fixed) for each in (base, (*base, tilt, tilt))]

    found = tried(STRONG)
    if max(each.share for each in found) < _SURE:
        found += tried(FAINT)
    return max(found, key=lambda verdict: verdict.share)


def _folds(steps: Steps) -> NDArray[np.int64]:
    """Return the fold of each stretch: by its seam, or if there are few of those along each."""
    seams = np.unique(steps.seams)
    if len(seams) >= _FEWEST_SEAMS:
        drawn = np.random.default_rng(0).permutation(len(seams)) % _FOLDS
        return drawn[np.searchsorted(seams, steps.seams)]
    return np.arange(len(steps.seams)) // (2 * _STRETCHES) % _FOLDS


def _groups(steps: Steps) -> NDArray[np.int64]:
    """Divide stretches into groups of neighbours on a seam, with the same two charts, and return their numbers."""
    keys = np.column_stack([steps.seams, steps.ends])
    starts = np.flatnonzero(np.r_[True, np.any(keys[1:] != keys[:-1], axis=1)][: len(keys)])
    within = np.arange(len(keys)) - np.repeat(starts, np.diff(np.r_[starts, len(keys)]))
    begins = within % _STRETCHES == 0
    return np.cumsum(begins) - 1


def _foretold(
    steps: Steps,
    spread: tuple[float, ...],
    folds: NDArray[np.int64],
    groups: NDArray[np.int64],
    fixed: NDArray[np.bool_] | None,
) -> Verdict:
    after = np.empty_like(steps.colours)
    for fold in range(_FOLDS):
        held = folds == fold
        others = fit_exposures(steps.part(~held), spread, SHORT, fixed)
        after[held] = others.sides(steps.part(held))
    seam_of = np.zeros(int(groups.max(initial=-1)) + 1, np.int64)
    seam_of[groups] = steps.seams
    before, left = (_energy(steps, sides, groups) for sides in (steps.colours, after))
    units = seam_of if len(np.unique(seam_of)) >= _FEWEST_SEAMS else np.arange(len(seam_of))
    gained = np.bincount(units, before - left)
    error = float(np.sqrt(np.square(gained).sum()))
    total = float(before.sum())
    if not total or not error:
        return Verdict(spread, 0.0, 0.0)
    return Verdict(spread, float(gained.sum()) / total, float(gained.sum()) / error)


def _energy(steps: Steps, sides: NDArray[np.float64], groups: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the squared mean step of each group, of which paint cannot make much, times its texels."""
    counts = np.bincount(groups, steps.counts)
    step = sides[:, 1] - sides[:, 0]
    means = [np.bincount(groups, each * steps.counts) / counts for each in step.T]
    return np.asarray(counts * np.minimum(np.mean(np.square(means), axis=0), _SATURATED**2))
