"""Exposure steps between the charts of a canvas, taken out of its colours."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.levelling.decision import judge
from beltrami_cli.levelling.fit import fit_exposures
from beltrami_cli.levelling.steps import weighted_median

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.levelling.decision import Verdict
    from beltrami_cli.levelling.fit import Exposures
    from beltrami_cli.levelling.steps import Steps
    from beltrami_cli.surface.atlas import Indices

# Seams with a mean weight below this are painted, with a step above the other have one at all.
_PAINTED, _STEP = 0.3, 2 / 255


@dataclass(frozen=True)
class SeamFacts:
    """The seams between different charts: how many, which have steps, and how large these are in the median."""

    seams: int
    stepped: int
    painted: int
    before: float
    after: float


@dataclass(frozen=True)
class Levelled:
    """What is known of exposure steps; without exposures nothing is to be changed."""

    verdict: Verdict | None
    exposures: Exposures | None
    facts: SeamFacts
    groups: Indices  # (charts,): charts that are joined by seams without paint


def find_exposures(steps: Steps, strength: float = 1.0, fixed: NDArray[np.bool_] | None = None) -> Levelled:
    """Decide whether the charts differ in exposure, and find how; `fixed` charts stay as they are."""
    apart = np.arange(steps.charts)
    if not np.any(steps.ends[:, 0] != steps.ends[:, 1]):
        return Levelled(None, None, SeamFacts(0, 0, 0, 0.0, 0.0), apart)
    verdict = judge(steps, fixed)
    found = fit_exposures(steps, verdict.spread, fixed=fixed)
    facts = _facts(steps, found, strength if verdict.is_sure else 0.0)
    if not verdict.is_sure:
        return Levelled(verdict, None, facts, apart)
    return Levelled(verdict, found, facts, _joined(steps, found))


def _facts(steps: Steps, found: Exposures, strength: float) -> SeamFacts:
    between = steps.ends[:, 0] != steps.ends[:, 1]
    _, seam = np.unique(steps.seams[between], return_inverse=True)
    signs = np.where(steps.ends[between, 0] < steps.ends[between, 1], 1.0, -1.0)
    counts = np.bincount(seam, steps.counts[between])

    def sizes(sides: NDArray[np.float64]) -> NDArray[np.float64]:
        step = signs[:, None] * (sides[between, 1] - sides[between, 0])
        means = [np.bincount(seam, each * steps.counts[between]) / counts for each in step.T]
        return np.asarray(np.sqrt(np.mean(np.square(means), axis=0)))

    before = sizes(steps.colours)
    after = sizes(steps.colours + strength * (found.sides(steps) - steps.colours))
    agreed = np.bincount(seam, found.weights[between] * steps.counts[between]) / counts
    return SeamFacts(
        len(counts),
        int(np.count_nonzero(before > _STEP)),
        int(np.count_nonzero(agreed < _PAINTED)),
        weighted_median(before, counts),
        weighted_median(after, counts),
    )


def _joined(steps: Steps, found: Exposures) -> Indices:
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    used = steps.ends[found.weights > 0]
    pairs = coo_array((np.ones(len(used)), (used[:, 0], used[:, 1])), shape=(steps.charts,) * 2)
    return np.asarray(connected_components(pairs, directed=False)[1])
