"""The channels of the metric besides positions: regularised colours, guides, and features of moving positions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from beltrami_cli.flow.manifolds.geometry import Gaussian, Stack
from beltrami_cli.flow.manifolds.iteration import Step
from beltrami_cli.flow.manifolds.manifold import Manifold


class MetricChannels(NamedTuple):
    """Channels of the metric, and their beta."""

    stack: Stack
    beta: float


def gaussian_for(manifold: Manifold, step: Step, gaussian: Gaussian | None) -> Gaussian | None:
    """Return the Gaussian that regularises the metric of an iteration, the given one if there is one."""
    if not step.regularised or (step.beta == 0 and manifold.moving is None):
        return None
    return manifold.geometry.gaussian(manifold.parameters.metric_scale) if gaussian is None else gaussian


def joined_channels(
    manifold: Manifold, colours: Stack, step: Step, gaussian: Gaussian | None, *,
    features: Sequence[MetricChannels] = (),
) -> MetricChannels:  # fmt: skip
    """Return all channels of the metric; `features`: further ones that are regularised like colours."""
    axis, relative = manifold.geometry.axis, manifold.noise.relative
    if not isinstance(manifold.metric_channels, slice):
        colours = np.ascontiguousarray(np.take(colours, manifold.metric_channels, axis=axis))
    if relative is not None:  # differences are relative to the local noise
        colours = np.divide(colours, np.sqrt(relative), dtype=np.float32)

    def regularised(channels: MetricChannels) -> MetricChannels:
        if gaussian is None or not channels.beta:
            return channels
        return MetricChannels(gaussian.smooth(channels.stack), channels.beta / gaussian.gain)

    guides = [MetricChannels(guide.stack, guide.beta) for guide in manifold.guides]  # guides have no noise
    smoothed = [regularised(feature) for feature in features]
    return _joined([regularised(MetricChannels(colours, step.beta)), *guides, *smoothed], axis)


def _joined(parts: Sequence[MetricChannels], axis: int) -> MetricChannels:
    """Scale channels of different beta to one beta, colours first, and join them; beta is 0 if all are."""
    counted = [part for part in parts if part.beta > 0 and part.stack.shape[axis] > 0]
    if len(counted) < 2:
        return counted[0] if counted else parts[0]._replace(beta=0.0)
    first, largest = counted[0].beta, max(part.beta for part in counted)
    # The first part is not scaled, unless the others would exceed the range of float32.
    common = first if first > 1e-9 * largest else largest
    scaled = [stack if beta == common else stack * np.float32(beta / common) for stack, beta in counted]
    return MetricChannels(np.concatenate(scaled, axis=axis), common)
