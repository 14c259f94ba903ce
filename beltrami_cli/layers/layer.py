"""Layers: coloured parts of a document, and the way back into the document.

Vertices, points, texels, pixels and vertices on a grid differ only in how their colours are read and written. Code that
gives a layer new colours works for all of them.
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, Self

import numpy as np

from beltrami_cli.arrays import Float32s, Indices
from beltrami_cli.errors import UsageError
from beltrami_cli.flow.beltrami_flow import FlowResult
from beltrami_cli.flow.chunks import IN_ONE_PIECE, Resources
from beltrami_cli.flow.manifolds.guides import Guide
from beltrami_cli.flow.manifolds.new_colours import NewColours
from beltrami_cli.flow.noise.model import scaled_description
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.flow.plan import Plan
from beltrami_cli.layers.channels import ChosenChannels
from beltrami_cli.layers.reports import LayerReport, LevelReport, describe_choice, describe_reading, named
from beltrami_cli.layers.settings import LevelSettings, SmoothSettings
from beltrami_cli.layers.storing import StoredColours
from beltrami_cli.surface.records import Cells, ColouredVertices

Part = Literal["vertices", "textures", "image"]


@dataclass(frozen=True)
class SampledVertices:
    """A mesh, and the sample of each of its V vertices."""

    mesh: ColouredVertices
    sample_of: Indices  # shape (V,); -1: no sample


@dataclass(frozen=True, kw_only=True, eq=False)
class Layer(ABC):
    """Coloured samples of a document; UsageError if settings name absent channels or contradict it."""

    part: ClassVar[Part]  # part of the document, a section of reports

    settings: SmoothSettings
    # Given standard deviations: one row per vertex, texel of the layer, or pixel of the image.
    noise: Float32s | None = None
    guides: Sequence[Guide] = ()  # with rows as those of `noise`
    level_report: LevelReport | None = None  # None: exposure steps were not searched for
    levelled_colours: Float32s | None = None  # (S, N): colours of the samples without exposure steps
    is_normalised: bool = False  # whether plans can be made of it
    resources: Resources = IN_ONE_PIECE  # of its smoothing

    @property
    @abstractmethod
    def label(self) -> str: ...

    @property
    def notices(self) -> Sequence[str]:
        """Notices about how it is stored, and about its surface."""
        return ()

    @property
    @abstractmethod
    def channels(self) -> ChosenChannels: ...

    @property
    def names(self) -> tuple[str, ...]:
        return self.channels.names

    def normalised(self) -> Self:
        """Return the layer in the unit of plans, in which noise is judged independently of the unit of the colours.

        Layers are levelled and given noise before, and planned and described after.
        """
        if self.is_normalised:
            return self
        # Exposures are as stored.
        layer = self if self.levelled_colours is not None else self._in_own_unit()
        return dataclasses.replace(layer, is_normalised=True)

    @abstractmethod
    def _in_own_unit(self) -> Self:
        """Return the layer with its colours divided by a unit that suits them."""

    @abstractmethod
    def unit_in(self, space: str) -> float:
        """Return the unit of plans, which divides the colours of this layer in `space`."""

    @property
    def unit(self) -> float:
        """The unit of plans, which divides colours in the working space."""
        assert self.is_normalised, "a layer is normalised before it is planned"
        return self.unit_in(self.settings.space)

    @property
    def kernel(self) -> KernelParameters:
        """The requested parameters, in the unit of plans."""
        return self.settings.kernel.in_unit(self.unit, self.unit_in("linear"))

    @property
    def deviations(self) -> Float32s | None:
        """The given standard deviations of samples, in the unit of plans."""
        return None if self.noise is None else self.noise / np.float32(self.unit)

    @abstractmethod
    def plan(self, tick: Callable[[], None] | None = None) -> Plan[Any]:
        """Plan the smoothing; `tick` is called meanwhile, and may raise to stop."""

    @abstractmethod
    def report(self, plan: Plan[Any], result: FlowResult[Any]) -> LayerReport:
        """Report the smoothing, without the change of colours."""

    @abstractmethod
    def encode(self, new: NewColours, *, is_smoothed: bool = True) -> StoredColours:
        """Encode the new colours of all samples for the document.

        A texture that neither smoothing nor levelling changed keeps its gutter.
        """

    def levelled(self, wanted: LevelSettings) -> Self:
        """Return the layer without exposure steps, and with a report; UsageError if it has no charts."""
        del wanted
        cause = "there are no charts that could differ in exposure; textures of models have them"
        raise UsageError(f"{self.label}: {cause}")

    @abstractmethod
    def describe(self) -> dict[str, object]:
        """Return facts about the layer, its noise, and its plan of smoothing, in JSON types, by topic."""

    @abstractmethod
    def places(self) -> Cells | SampledVertices:
        """Return the locations of the samples, in images or at vertices of a mesh."""

    def require_writable(self) -> None:  # noqa: B027
        """Raise errors of output images before anything is computed."""

    def _common_report(self, plan: Plan[Any], result: FlowResult[Any]) -> dict[str, Any]:
        return {
            "beta": plan.beta / self.unit,
            "iterations": plan.parameters.iterations,
            **self._noise(plan),
            "guides": plan.guide_betas,
            "choice": describe_choice(result.choice, self.unit),
            "patches": result.patches,
        }

    def _noise(self, plan: Plan[Any]) -> dict[str, Any]:
        return {
            "noise": named(self.names, self.unit * plan.noise),
            "noise_model": scaled_description(plan.described_noise, self.unit),
            "reading": describe_reading(plan.reading, self.unit),
            "wrong_samples": plan.outliers,
        }

    def _described_plan(self, plan: Plan[Any]) -> dict[str, Any]:
        """Return the noise and the planned parameters of the kernel, for `describe`."""
        choice, given = describe_choice(plan.choice, self.unit), self.settings.kernel.noise
        used = dataclasses.asdict(
            dataclasses.replace(plan.parameters, beta=plan.beta / self.unit, noise=given)
        )
        del used["free"]  # empty in a plan
        smooth = {
            **used,
            "patches": "on" if plan.takes_patches else "off",
            "threads": self.settings.kernel.thread_count,
            "space": self.settings.space,
            **({"guide_betas": plan.guide_betas} if plan.guide_betas else {}),
            **({"choice": choice} if choice else {}),
        }
        return {**self._noise(plan), "smooth": smooth}
