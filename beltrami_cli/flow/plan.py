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
from beltrami_cli.flow.manifolds.iteration import Step
from beltrami_cli.flow.manifolds.manifold import Manifold
from beltrami_cli.flow.noise.model import Reading, scaled_description
from beltrami_cli.flow.parameters import KernelParameters, Space, growth_at

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
        outliers, is_replaced = self.manifold.outliers, self.parameters.outliers != "keep"
        if outliers is None:
            return {}
        return {"count": len(outliers.samples), "share": outliers.share, "replaced": is_replaced}

    def step(self, iteration: int) -> Step:
        """Return an iteration, counted from 0."""
        beta = self.manifold.beta * growth_at(iteration, self.parameters.beta_growth)
        return Step(beta, self.parameters.t, self.parameters.is_regularised(iteration))

    def with_noise(self, sigma: Float64s, reading: Reading | None) -> Plan[AnyManifold]:
        """Return the plan for another noise: `sigma` is the RMS error by channel, without a predicted PSNR."""
        ratio = float(np.sqrt(np.mean(np.square(sigma)) / np.mean(np.square(self.noise))))
        choice = self.choice
        if choice is not None and choice.gain is not None:
            gain = choice.gain + 20 * float(np.log10(ratio))
            choice = dataclasses.replace(choice, gain=gain, predicted=None)
        return dataclasses.replace(
            self, noise=sigma, described_noise=scaled_description(self.described_noise, ratio),
            choice=choice, reading=reading,
        )  # fmt: skip

    def stopped_before(self, iteration: int) -> Plan[AnyManifold]:
        """Return a plan of the iterations before this one, counted from 0, and of no later step."""
        manifold = self.manifold.with_parameters(iterations=iteration, clipping="keep")
        return dataclasses.replace(self, takes_patches=False, light=None, manifold=manifold)


def choose_parameters(
    manifold: AnyManifold, tick: Callable[[], None] | None = None, *,
    light_in: Space | None = None, can_stay: bool = False,
) -> Plan[AnyManifold]:  # fmt: skip
    """Choose the free parameters of a manifold so that the estimated error of the result is least.

    If patches follow, the colours of the plan are without the noise that neighbouring samples share, except at the
    finest scale. `tick` is called often, and may raise to stop. `light_in` is the space of colours that stand for
    light. Their mean radiance is preserved, unless beta is given. `can_stay`: plan no iteration, except that outliers
    are replaced, for colours that `should_stay`.
    """
    light = None
    if light_in is not None and manifold.parameters.stabilises_noise:
        light = MeanLight.of(manifold, light_in)
        # Texels that no light path has reached are black; their noise was not clipped.
        manifold = manifold.with_parameters(clipping="keep")
    if manifold.moving is not None:
        if manifold.resources.chunking is not None:
            raise UsageError("vertices are not moved in pieces; leave out --pieces, or --smooth-geometry")
        # Positions share the iterations, and the best parameters of colours are too strong for them.
        manifold = manifold.with_parameters(free=())
    parameters, noise, planned = manifold.parameters, manifold.noise, manifold
    has_noise = is_noisy(noise.of_input)
    takes_patches = parameters.takes_patches and has_noise and manifold.moving is None
    if takes_patches and noise.is_shared:
        planned, chosen, choice = _choose_without_shared_noise(manifold, tick)
    else:
        chosen, choice = tune(manifold, noisy=has_noise, tick=tick)
    if can_stay and should_stay(choice, parameters):
        planned, chosen = manifold, dataclasses.replace(chosen, iterations=0, clipping="keep")
    work = manifold.geometry.work(manifold.unit)
    chosen = work.bounded(chosen)
    work.announce(chosen)
    noise_as_read = noise.as_read()
    return Plan(
        manifold=dataclasses.replace(planned, parameters=chosen), noise=noise_as_read.of_input,
        described_noise=noise_as_read.described(), reading=noise.reading, choice=choice,
        takes_patches=takes_patches and chosen.iterations > 0, light=light,
    )  # fmt: skip


def should_stay(choice: Choice | None, parameters: KernelParameters) -> bool:
    """Whether a result is estimated to be worse than the input, and no option asks for smoothing all the same."""
    insists = (
        "iterations" not in parameters.free or parameters.given_noise is not None or parameters.strength > 1
    )
    return not insists and choice is not None and choice.gain is not None and choice.gain < 0


def _choose_without_shared_noise(
    manifold: AnyManifold, tick: Callable[[], None] | None
) -> tuple[AnyManifold, KernelParameters, Choice | None]:
    """Remove the noise that neighbours share, and choose parameters for the rest, with one iteration at least."""
    variance = float(np.mean(np.square(manifold.noise.of_input)))
    is_free = "iterations" in manifold.parameters.free
    filtered, error = without_shared_noise(manifold, tick)
    chosen, choice = tune(filtered, noisy=True, tick=tick)
    if is_free:
        chosen = dataclasses.replace(chosen, iterations=max(1, chosen.iterations))
    if choice is not None:
        choice = choice.improved(-error)
        if choice.psnr is not None:
            # So far the gain is relative to colours without shared noise.
            choice = dataclasses.replace(choice, gain=choice.psnr + 10 * math.log10(variance))
    return filtered, chosen, choice
