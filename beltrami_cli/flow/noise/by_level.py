"""Noise by the level of colours and by scale, from the samples that lie in even neighbourhoods.

Noise is measured in the details of each scale, for the mean of channels and their differences, and for groups of
neighbourhoods of similar level: the mean energy of those with the most even means around. What they hold besides noise
makes them larger, never smaller. So

    log energy (scale, component, group) = a (scale, component) + s (group, component) + texture,    texture >= 0

is fitted, where s is the mean of s (level) over the channels that a component mixes, by their shares in it. Weights
fall where residuals are above 0: textures differ from level to level and from component to component, and where
one is free of them, it shows the noise of the others [1]_.

References
----------
.. [1] M. Lebrun, M. Colom, J.-M. Morel, "The Noise Clinic: a blind image denoising algorithm", Image Processing On Line
   5, 2015: noise by level and by scale. https://doi.org/10.5201/ipol.2015.125
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float64s, Int64s
from beltrami_cli.flow.noise.stabilising import VarianceStabiliser

# The mean of three channels and two differences, orthonormal.
OPPONENTS = np.array([[1, 1, 1], [1, 0, -1], [1, -2, 1]]) / np.sqrt([[3], [2], [6]])

# Levels differ if standard deviations of noise do by more than this factor, between those with a share of the samples.
_UNEVEN, _COUNTED = 1.3, 0.02

# Standard deviations that differ by less than this factor are those of the same noise.
_FLAT = 1.1

# Bound on the relative standard deviation, beyond which there is texture.
_MOST_RELATIVE = 3.0

# Groups of levels, and how far apart they are at least.
LEVELS, _LEAST_APART = 8, 1 / 32

# Neighbourhoods of a group that are taken to be even: a share, and at least this many; with fewer than the least it is
# left out.
_SHARE, _FEWEST, _LEAST = 0.1, 6, 3

# Where the more even half of these holds less than this factor of their energy in the differences of channels, the
# others hold texture: of a window that is mostly white, six may be nearly all of a group. Halves of three with a dozen
# values each hold that much less by chance once in some thousands. Factors of 0.6 to 0.7 give such a window the same.
_LESS = 0.6

# Residuals, in logarithms of variance, above which there is texture; and iterations of the weights.
_SCATTER, _ROUNDS = 0.1, 30

# Neighbourhoods with a larger share of samples at 0 or full scale are left out; more are taken where fewer than the
# last share of them would be left.
_MOST_CUT_OFF, _DARK, _ENOUGH_LIT = 0.3, 0.6, 0.1

# If this share of the neighbourhoods is plain, the others show paint, or what JPEG left of noise: nobody can tell.
MOST_PLAIN = 0.5

# Values that make a full weight.
_ENOUGH_VALUES = 200

# Differences of channels are of one hue if they hold more than this factor of what differs from it.
_ONE_HUE = 2.0

# Numbers are no levels, as the a and b of Oklab, if more than this share of neighbourhoods has a mean below 0 by this
# many standard deviations of its noise, or if more than the last share of a channel's has one at all. Noise around
# black does neither.
_FEW_FAR_BELOW, _FAR_BELOW = 1e-3, 4.0
_FEW_BELOW = 1 / 4

# Steps between neighbouring levels count by this, over the distance; all else that is not determined is small.
_EVEN, _LITTLE = 0.03, 1e-3


@dataclass(frozen=True)
class Neighbourhoods:
    """M neighbourhoods at one scale."""

    energy: Float64s  # mean square of details by component, shape (K, M)
    unevenness: Float64s  # of means around, shape (M,)
    levels: Float64s  # mean level of each channel, shape (K, M)
    values: int  # details in each
    cut_off: float = 0.0  # share of colours at a limit, in these and in others that were left out
    most: Float64s | float = np.inf  # standard deviation of noise at most, by component, shape (K,)
    by_channel: Float64s | None = None  # the energy by channel, shape (K, M), where that is measured
    plain: float = 0.0  # share of neighbourhoods that held nothing, and were left out


@dataclass(frozen=True)
class NoiseByLevel:
    """Standard deviations of noise by scale and component, and the relative one by level."""

    sigma: Float64s  # shape (L, K); NaN where there was nothing to measure
    levels: Float64s  # ascending, shape (G,)
    relative: Float64s  # shape (G,); its logarithm has the mean 0
    seen: Float64s  # how many channels of neighbourhoods of the finest scale have each level, shape (G,)


def fit_by_level(scales: Sequence[Neighbourhoods], mixing: Float64s) -> NoiseByLevel | None:
    """Fit noise to the neighbourhoods of each scale; None without enough of them at the finest.

    `mixing`: of channels into components, shape (K, K).
    """
    if not scales or scales[0].levels.shape[1] < _FEWEST:
        return None
    levels, seen = _levels(scales[0].levels.reshape(-1))
    rows, shape = list(_measured(scales, mixing, levels)), (len(scales), len(mixing))
    if not rows:
        return None
    numbers, shares, logs, weights = (np.array(each) for each in zip(*rows, strict=True))
    if _is_even(numbers, logs, shape):
        levels, seen = levels.mean(keepdims=True), seen.sum(keepdims=True)
        shares = np.ones((len(logs), 1))
    fitted, known = _fit(numbers, shares, logs, weights, levels, shape)
    sizes, relative = np.split(fitted, [known.size])
    middle = float(np.average(relative, weights=np.maximum(seen, 1e-9)))
    sigma = np.where(known, np.exp((sizes.reshape(shape) + middle) / 2), np.nan)
    return NoiseByLevel(sigma, levels, np.exp((relative - middle) / 2), seen)


def are_levels(own: Neighbourhoods) -> bool:
    """Whether colours are levels, on which noise may depend, by their means in neighbourhoods."""
    if not own.levels.size:
        return True
    noise = np.sqrt(own.energy.mean(axis=0) / own.values)
    far = own.levels < -_FAR_BELOW * noise
    return bool(far.mean() <= _FEW_FAR_BELOW and (own.levels < 0).mean(axis=1).max() <= _FEW_BELOW)


def _measured(
    scales: Sequence[Neighbourhoods], mixing: Float64s, levels: Float64s
) -> Iterator[tuple[tuple[int, int], Float64s, float, float]]:
    """Yield energies by scale, component and group: these numbers, the shares of levels, the logarithm, the weight."""
    edges = _edges(scales[0].levels.mean(axis=0))
    for scale, own in enumerate(scales):
        group = _groups(own.levels.mean(axis=0), edges)
        for number in range(len(edges) - 1):
            members = np.flatnonzero(group == number)
            if len(members) < _LEAST:
                continue
            even = members[most_even(own.unevenness[members])]
            even = even[: _free_of_texture(own.energy[:, even])]
            # A component holds noise of each channel, at the level of this channel.
            shares = np.square(mixing) @ _shares(own.levels[:, even].mean(axis=1), levels)
            weight = min(1.0, len(even) * own.values / _ENOUGH_VALUES)
            for component, energy in enumerate(own.energy[:, even].mean(axis=1)):
                yield (scale, component), shares[component], float(np.log(energy)), weight


def most_cut_off(shares: Float64s) -> float:
    """Return the share of samples at a limit below which neighbourhoods count, by the shares of all."""
    is_lit = np.count_nonzero(shares < _MOST_CUT_OFF) >= _ENOUGH_LIT * np.count_nonzero(shares < 1)
    return _MOST_CUT_OFF if is_lit else _DARK


def most_even(unevenness: Float64s) -> Int64s:
    """Return which neighbourhoods are the most even ones, the first of them first."""
    count = min(len(unevenness), max(_FEWEST, int(_SHARE * len(unevenness))))
    return np.argsort(unevenness, kind="stable")[:count]


def _free_of_texture(energy: Float64s) -> int:
    """Return how many neighbourhoods hold no texture, by their energies by component, the most even ones first."""
    differences = energy[1:] if len(energy) == len(OPPONENTS) else energy
    count: int = energy.shape[1]
    while count > _LEAST:
        half = max(_LEAST, count // 2)
        shares = differences[:, :half].mean(axis=1) / differences[:, :count].mean(axis=1)
        if np.log(shares).mean() > np.log(_LESS):
            break
        count = half
    return count


def _is_even(numbers: Int64s, logs: Float64s, shape: tuple[int, int]) -> bool:
    """Whether the noise of all differences of channels is white, and the same at all levels.

    What textures hide in the mean of channels and at coarse scales, they leave in these.
    """
    means = np.full((2, shape[1]), np.inf)
    for component in range(1, shape[1]):
        for scale in (0, 1):
            own = logs[(numbers == (scale, component)).all(axis=1)]
            if not len(own) or (scale == 0 and np.ptp(own) > 2 * np.log(_FLAT)):
                return False
            means[scale, component] = np.median(own)
    return shape[1] > 1 and bool(abs(np.diff(means.min(axis=1))[0]) < 2 * np.log(_FLAT))


def stabiliser_of(found: NoiseByLevel) -> VarianceStabiliser | None:
    """Return the transformation that makes noise even; None if it is."""
    counted = found.seen >= _COUNTED * found.seen.sum()
    relative = found.relative[counted]
    if len(relative) < 2 or relative.max() < _UNEVEN * relative.min():
        return None
    relative = np.clip(relative, 1 / _MOST_RELATIVE, _MOST_RELATIVE)
    return VarianceStabiliser(found.levels[counted], relative, found.seen[counted])


def by_channel(details: Array, mixing: Float64s) -> Array:
    """Return details of channels, shape (K, ...), by those of components."""
    channels: Array = np.einsum("ki,k...->i...", mixing.astype(np.float32), details)
    return channels


def mixing_for(channels: int) -> Float64s:
    """Return the mixing of channels into components, shape (K, K): the colours', or one channel each."""
    return OPPONENTS if channels >= len(OPPONENTS) else np.eye(channels)


def mixing_by(details: Array) -> Float64s:
    """Return the same by details of colours, shape (K, M): what most of them lie along, and what differs from that.

    Textures of one hue, as of grass or wood, are as strong in differences of channels as noise would be.
    """
    if len(details) < len(OPPONENTS):
        return np.eye(len(details))
    squares = np.einsum("im,jm->ij", details, details, dtype=np.float64)
    energies, vectors = np.linalg.eigh(squares)
    differences = np.trace(OPPONENTS[1:] @ squares @ OPPONENTS[1:].T)
    if differences <= _ONE_HUE * energies[:2].sum():
        return OPPONENTS
    hue = vectors[:, -1] * np.sign(vectors[:, -1] @ OPPONENTS[0] or 1)
    # The mean of channels reflected to the hue, and its differences likewise, which stay at right angles to it.
    halfway = OPPONENTS[0] + hue
    reflected: Float64s = OPPONENTS - 2 * np.outer(OPPONENTS @ halfway, halfway) / (halfway @ halfway)
    reflected[0] = -reflected[0]
    return reflected


def _edges(levels: Float64s) -> Float64s:
    """Return the limits of groups with equally many levels, but not closer than they may be."""
    ordered = np.sort(levels)
    wanted = ordered[np.linspace(0, len(ordered) - 1, LEVELS + 1).astype(int)]
    edges = [float(wanted[0])]
    for edge in wanted[1:]:
        if edge - edges[-1] >= _LEAST_APART:
            edges.append(float(edge))
    return np.array(edges if len(edges) > 1 else [edges[0], edges[0] + _LEAST_APART])


def _groups(levels: Float64s, edges: Float64s) -> Int64s:
    """Return the groups of levels, by their limits."""
    return np.clip(np.searchsorted(edges, levels, "right") - 1, 0, len(edges) - 2).astype(np.int64)


def _levels(levels: Float64s) -> tuple[Float64s, Float64s]:
    """Return the mean levels of groups, and how many each has, shape (G,)."""
    edges = _edges(levels)
    group, middles = _groups(levels, edges), (edges[1:] + edges[:-1]) / 2
    seen = np.bincount(group, minlength=len(middles)).astype(float)
    means = np.bincount(group, levels, len(middles)) / np.maximum(seen, 1)
    return np.where(seen > 0, means, middles), seen


def _shares(levels: Float64s, among: Float64s) -> Float64s:
    """Return by which shares levels, shape (K,), lie at the two nearest of ascending ones, shape (K, G)."""
    return np.stack([np.interp(levels, among, own) for own in np.eye(len(among))], axis=1)


def _fit(
    numbers: Int64s,
    shares: Float64s,
    logs: Float64s,
    weights: Float64s,
    levels: Float64s,
    shape: tuple[int, int],
) -> tuple[Float64s, Bools]:
    """Return a and s side by side, and which of a were measured, shape (L, K)."""
    own = numbers[:, 0] * shape[1] + numbers[:, 1]
    first = shape[0] * shape[1]
    count = first + len(levels)
    design = np.zeros((len(logs), count))
    design[np.arange(len(logs)), own] = 1
    design[:, first:] = shares
    prior = _LITTLE * np.eye(count)
    for k, apart in enumerate(np.diff(levels)):
        at = first + k
        penalty = _EVEN / max(float(apart), _LEAST_APART)
        prior[at : at + 2, at : at + 2] += penalty * np.array([[1, -1], [-1, 1]])
    # First weights are those of noise of one size at all levels, so that the texture of some is not taken for more.
    least = np.full(first, np.inf)
    np.minimum.at(least, own, logs)
    residuals, fitted = logs - least[own], np.zeros(count)
    for _ in range(_ROUNDS):
        factors = np.where(residuals > 0, 1 / (1 + np.square(residuals / _SCATTER)), 1)
        weighted = design * (weights * factors)[:, None]
        fitted = np.linalg.solve(
            np.einsum("ij,ik->jk", weighted, design) + prior, np.einsum("ij,i->j", weighted, logs)
        )
        residuals = logs - np.einsum("ij,j->i", design, fitted)
    return fitted, np.bincount(own, minlength=first).reshape(shape) > 0
