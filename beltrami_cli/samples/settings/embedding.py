"""What else is told of the embedding: guides, which colours enter the metric, and whether positions move."""

from __future__ import annotations

import math
from dataclasses import dataclass

from beltrami_cli.errors import UsageError


@dataclass(frozen=True)
class EmbeddingSettings:
    """What enters the metric besides the colours that are smoothed, and what is smoothed besides them.

    Attributes
    ----------
    guides : tuple of str
        Channels that enter the metric and stay as they are: vertex attributes or texture slots of the input by their
        names, or paths of files.
    guide_betas : tuple of float
        Sample spacings per unit of the guides, each >= 0: one for each guide, or one for all. Empty: from the guides.
    metric_channels : tuple of str or None
        Names of the colour channels that enter the metric; None: those that are smoothed. Empty: none, which leaves
        the metric to the surface and the guides.
    smooth_geometry : bool
        Whether vertex positions are smoothed along with the vertex colours.
    normal_beta : float or None
        Sample spacings per radian that the normal turns, >= 0: how strongly creases of a smoothed geometry are kept.
        None: from the estimated noise of the normals.

    Raises
    ------
    UsageError
        If a value is out of its range, or is of something that is not asked for.
    """

    guides: tuple[str, ...] = ()
    guide_betas: tuple[float, ...] = ()
    metric_channels: tuple[str, ...] | None = None
    smooth_geometry: bool = False
    normal_beta: float | None = None

    def __post_init__(self) -> None:
        for beta in self.guide_betas:
            _require_weight("guide_beta", beta)
        if self.guide_betas and not self.guides:
            raise UsageError("guide_beta is of a guide; add --guide")
        if self.guide_betas and len(self.guide_betas) not in (1, len(self.guides)):
            raise UsageError(
                f"guide_beta has {len(self.guide_betas)} values, but must have one for each guide, or one for all"
            )
        if self.normal_beta is not None:
            _require_weight("normal_beta", self.normal_beta)
            if not self.smooth_geometry:
                raise UsageError("normal_beta is of a geometry that is smoothed; add --smooth-geometry")

    @property
    def weighted_guides(self) -> list[tuple[str, float | None]]:
        """Each guide with its beta; None: from the guide."""
        if len(self.guide_betas) == len(self.guides):
            return list(zip(self.guides, self.guide_betas, strict=True))
        return [(guide, self.guide_betas[0] if self.guide_betas else None) for guide in self.guides]


def _require_weight(name: str, value: float) -> None:
    if not (value >= 0 and math.isfinite(value)):
        raise UsageError(f"{name} is {value}, but must be 0 or more")
