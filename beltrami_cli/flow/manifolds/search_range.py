"""Candidate parameters for each kind of manifold, how many samples they are tried on, and rules without a search."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# Noise up to which a `Rule` uses `iterations`; above it, the number grows with the logarithm of the noise.
_LOW_NOISE = 5 / 255

# Number of samples for which one perturbation suffices, and maximum number of perturbations for fewer samples.
_ENOUGH_SAMPLES, _MAX_PROBES = 5_000, 4


@dataclass(frozen=True)
class SearchRange:
    """Candidates for a kind of manifold, and the starts of the search."""

    t: float
    growths: tuple[float, ...]  # of beta
    regularised: tuple[int, ...]  # numbers of regularised iterations
    max_iterations: int
    starts: tuple[tuple[float, float, int], ...]  # beta times the noise, growth, regularised iterations
    least_gain: float = 0.0  # share of the error; an iteration that gains less is the last that is tried


@dataclass(frozen=True)
class TrialBudget:
    """Number of samples on which parameters are tried: a share of all, within limits."""

    share: float
    least: int
    most: int

    def of(self, samples: int) -> int:
        """Return the number for a surface, which may exceed that of all its samples."""
        return int(np.clip(samples * self.share, self.least, self.most))


@dataclass(frozen=True)
class Rule:
    """Parameters as functions of the noise level."""

    contrast: float  # beta times the noise
    growth: float  # of beta
    t: float  # time step
    regularised: int  # regularised iterations
    iterations: int  # all iterations at noise of up to 5 of 255, where more would cost detail of the image
    more: int  # further iterations each time the noise doubles ...
    max_iterations: int  # ... up to this many

    def count(self, noise: float) -> int:
        """Return the number of iterations for a noise sigma, with colours in [0, 1]."""
        doublings = max(0.0, float(np.log2(max(noise, _LOW_NOISE) / _LOW_NOISE)))
        return min(self.max_iterations, self.iterations + round(self.more * doublings))


def wanted_probes(samples: int) -> int:
    """Return the number of perturbations that estimate the divergence on this many samples."""
    return min(_MAX_PROBES, -(-_ENOUGH_SAMPLES // max(1, samples)))


# On painted, baked and photographed samples with noise of 5 to 40 of 255, other time steps and growths are hardly
# better when tuned on the truth, and worse when chosen by the estimate: more candidates, more wrong choices. On a grid
# the window bounds the kernel, and a large time step only makes its weights more even.
ON_GRIDS = SearchRange(8.0, (1.5, 3.0), (0, 1, 2, 3), 10, ((1.4, 1.5, 1), (1.4, 3.0, 2)))
# On a mesh the time step alone bounds the kernel, and larger ones cost more time than they gain. The regularised metric
# removes sharp borders, and from there a descent ends with remaining noise. Iterations that gain less than a fiftieth
# lead nowhere, while on grids many small gains add up.
ON_MESHES = SearchRange(2.4, (1.3, 2.0), (0, 1, 2), 8, ((1.0, 2.0, 1), (1.4, 1.3, 0)), least_gain=0.02)

# Trying takes hardly longer than smoothing: some sixty iterations are tried, each two or three times.
# On grids, twice as many cells change the default results on thirteen textures with noise of 20 of 255 by 0.00 dB on
# average, and by 0.09 dB at most. With twice the most the risk is known to a tenth of a dB or better.
# On meshes, the estimate is too uncertain with fewer than the least, which take tenths of a second. More than the most
# do not improve the choice.
BUDGET_ON_GRIDS = TrialBudget(1 / 50, least=20_000, most=50_000)
BUDGET_ON_MESHES = TrialBudget(1 / 20, least=6_000, most=40_000)

# The least average loss over noise of 5, 10, 20 and 40 of 255 on painted, baked and photographed models: ten textures,
# where flat ones need more iterations and rich ones fewer, and eleven with colours at the vertices.
RULE_ON_GRIDS = Rule(1.4, 3.0, 8.0, 1, 5, 0, 5)
RULE_ON_MESHES = Rule(0.7, 2.0, 1.6, 0, 2, 1, 6)
