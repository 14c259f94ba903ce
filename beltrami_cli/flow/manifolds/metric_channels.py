"""The channels of the metric besides positions: regularised colours, guides, and features of moving positions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from beltrami_cli.arrays import Float32s
from beltrami_cli.flow.manifolds.geometry import Gaussian, Stack
from beltrami_cli.flow.manifolds.iteration import Step
from beltrami_cli.flow.manifolds.manifold import Manifold


def gaussian_for(manifold: Manifold, step: Step, gaussian: Gaussian | None) -> Gaussian | None:
    """Return the Gaussian that regularises the metric of an iteration, the given one if there is one."""
    if not step.regularised or (step.beta == 0 and manifold.moving is None):
        return None
    return manifold.geometry.gaussian(manifold.parameters.metric_scale) if gaussian is None else gaussian


def joined_channels(
    manifold: Manifold, colours: Stack, step: Step, gaussian: Gaussian | None, *,
    features: Sequence[tuple[Stack, float]] = (),
) -> tuple[Stack, float]:  # fmt: skip
    """Return the channels of the metric, and their beta.

    `features`: further stacks that are regularised like colours, each with its beta.
    """
    axis, relative = manifold.geometry.axis, manifold.noise.relative
    if not isinstance(manifold.metric_channels, slice):
        colours = np.ascontiguousarray(np.take(colours, manifold.metric_channels, axis=axis))
    if relative is not None:  # differences are relative to the local noise
        colours = np.divide(colours, np.sqrt(relative), dtype=np.float32)

    def regularised(stack: Stack, beta: float) -> tuple[Stack, float]:
        if gaussian is None or not beta:
            return stack, beta
        return gaussian.smooth(stack), beta / gaussian.gain

    guides = [(guide.stack, guide.beta) for guide in manifold.guides]  # guides have no noise
    smoothed = [regularised(*feature) for feature in features]
    return _join_channels([regularised(colours, step.beta), *guides, *smoothed], axis)


def _join_channels(parts: Sequence[tuple[Float32s, float]], axis: int) -> tuple[Float32s, float]:
    """Scale channels of different beta to one beta, colours first, and join them; beta is 0 if all are."""
    weighted = [(values, beta) for values, beta in parts if beta > 0 and values.shape[axis] > 0]
    if len(weighted) < 2:
        return weighted[0] if weighted else (parts[0][0], 0.0)
    largest = max(beta for _, beta in weighted)
    # The first part is not scaled, unless the others would exceed the range of float32.
    common = weighted[0][1] if weighted[0][1] > 1e-9 * largest else largest
    scaled = [values if beta == common else values * np.float32(beta / common) for values, beta in weighted]
    return np.concatenate(scaled, axis=axis), common
