"""Plan of how a manifold is smoothed, with parameters chosen from the data."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from beltrami_cli.arrays import Float64s
from beltrami_cli.errors import UsageError
from beltrami_cli.flow.choice.choice import Choice, is_noisy, tune
from beltrami_cli.flow.corrections.coarse_levels import without_shared_noise
from beltrami_cli.flow.corrections.mean_light import MeanLight
from beltrami_cli.flow.manifolds.manifold import Manifold, Step
from beltrami_cli.flow.noise.model import Reading
from beltrami_cli.flow.parameters import KernelParameters, Space

AnyManifold = TypeVar("AnyManifold", bound=Manifold)


@dataclass(frozen=True, kw_only=True)
class Plan(Generic[AnyManifold]):
    """A manifold with fully specified parameters, and the noise for which they were chosen."""

    manifold: AnyManifold  # with these parameters
    noise: Float64s  # standard deviation in the input's colours by channel, shape (N,)
    described_noise: dict[str, float]  # see `NoiseModel.described`
    reading: Reading | None = None  # None: the noise is given
    choice: Choice | None = None  # None where no parameter was chosen from the data
    takes_patches: bool = False
    light: MeanLight | None = None  # the radiance whose mean is preserved

    @property
    def parameters(self) -> KernelParameters:
        return self.manifold.parameters

    @property
    def beta(self) -> float:
        """Beta of the first iteration, in units of length per unit of the input's colours."""
        return self.manifold.noise.beta_to_input(self.manifold.beta)

    @property
    def guide_betas(self) -> dict[str, float]:
        return {guide.name: guide.beta for guide in self.manifold.guides}

    @property
    def outliers(self) -> dict[str, object]:
        """Their number, their share of all samples, and whether they are replaced; empty if there are none."""
        own, is_replaced = self.manifold.outliers, self.parameters.outliers != "keep"
        return {} if own is None else {"count": len(own.samples), "share": own.share, "replaced": is_replaced}

    def step(self, iteration: int) -> Step:
        own = self.parameters
        return Step(self.manifold.beta * own.growth(iteration), own.t, own.is_regularised(iteration))

    def with_noise(self, sigma: Float64s, reading: Reading | None) -> Plan[AnyManifold]:
        """Return the plan for another noise: `sigma` is the RMS error by channel, without a predicted PSNR."""
        more = float(np.sqrt(np.mean(np.square(sigma)) / np.mean(np.square(self.noise))))
        described = {
            name: value if name == "grain" else more * value for name, value in self.described_noise.items()
        }
        choice = self.choice
        if choice is not None and choice.gain is not None:
            gain = choice.gain + 20 * float(np.log10(more))
            choice = dataclasses.replace(choice, gain=gain, predicted=None)
        return dataclasses.replace(
            self, noise=sigma, described_noise=described, choice=choice, reading=reading
        )

    def stopped_before(self, iteration: int) -> Plan[AnyManifold]:
        """Return a plan of the iterations before this one, counted from 0, and of no later step."""
        first = dataclasses.replace(self.parameters, iterations=iteration, clipping="keep")
        manifold = dataclasses.replace(self.manifold, parameters=first)
        return dataclasses.replace(self, takes_patches=False, light=None, manifold=manifold)


def choose_parameters(
    manifold: AnyManifold,
    wanted: KernelParameters,
    tick: Callable[[], None] | None = None,
    *,
    light_in: Space | None = None,
) -> Plan[AnyManifold]:
    """Choose the open parameters so that the estimated error of the result is least.

    If patches follow, the colours of the plan are without the noise that neighbouring samples share, except at the
    finest scale. `tick` is called often, and may raise to stop. `light_in` is the space of colours that stand for
    light. Their mean radiance is preserved, unless beta is given.
    """
    light = None
    if light_in is not None and wanted.stabilises_noise:
        light = MeanLight.of(manifold, light_in)
        # Texels that no light path has reached are black; their noise was not clipped.
        wanted = dataclasses.replace(wanted, clipping="keep")
        kept = dataclasses.replace(manifold.parameters, clipping="keep")
        manifold = dataclasses.replace(manifold, parameters=kept)
    moves = manifold.moving is not None
    if moves and manifold.resources.chunking is not None:
        raise UsageError("vertices are not moved in pieces; leave out --pieces, or --smooth-geometry")
    if moves:  # positions share the iterations, and the best parameters of colours are too strong for them
        wanted = dataclasses.replace(wanted, free=())
    noise, error = manifold.noise, 0.0
    noisy = is_noisy(noise.of_input)
    corrects = noisy and noise.is_shared and wanted.takes_patches and not moves
    if corrects:
        manifold, error = without_shared_noise(manifold, tick)
    chosen, choice = tune(manifold, wanted, noisy=noisy, tick=tick)
    if corrects and "iterations" in wanted.free:
        chosen = dataclasses.replace(chosen, iterations=max(1, chosen.iterations))
    if choice is not None:
        variance = float(np.mean(np.square(noise.of_input)))
        choice = choice.improved(-error)
        if corrects and choice.psnr is not None:
            # So far the gain is relative to colours without shared noise.
            choice = dataclasses.replace(choice, gain=choice.psnr + 10 * math.log10(variance))
    work = manifold.geometry.work(manifold.unit)
    chosen = work.bounded(chosen)
    work.announce(chosen)
    read = noise.as_read()
    return Plan(
        manifold=dataclasses.replace(manifold, parameters=chosen), noise=read.of_input,
        described_noise=read.described(), reading=noise.reading, choice=choice,
        takes_patches=wanted.takes_patches and chosen.iterations > 0 and not moves and noisy, light=light,
    )  # fmt: skip
