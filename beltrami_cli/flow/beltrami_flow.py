"""N iterations of the short-time Beltrami kernel on an image manifold, with what was left open chosen from the data."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s
from beltrami_cli.errors import UsageError
from beltrami_cli.flow.choice import Choice, is_noisy, tune
from beltrami_cli.flow.chunks import chunking
from beltrami_cli.flow.clipping import ClippedChannels
from beltrami_cli.flow.coarse_levels import denoise_means
from beltrami_cli.flow.manifold import Averaged, Manifold, Step, mark_clipped, restore_clipped
from beltrami_cli.flow.mean_light import MeanLight
from beltrami_cli.flow.noise.model import Reading
from beltrami_cli.flow.parameters import KernelParameters, Space
from beltrami_cli.flow.patches import PASSES, blend_with_patches

AnyManifold = TypeVar("AnyManifold", bound=Manifold)


@dataclass(frozen=True, kw_only=True)
class Plan(Generic[AnyManifold]):
    """How a manifold is smoothed: parameters with nothing left open, and the noise that they are chosen for."""

    manifold: AnyManifold  # with these parameters
    noise: Float64s  # standard deviation in the input's colours by channel, shape (N,)
    described_noise: dict[str, float]  # see `NoiseModel.described`
    reading: Reading | None = None  # None: the noise is given
    choice: Choice | None = None  # None where no parameter was chosen from the data
    takes_patches: bool = False
    light: MeanLight | None = None  # whose mean stays

    @property
    def parameters(self) -> KernelParameters:
        return self.manifold.parameters

    @property
    def beta(self) -> float:
        """Beta of the first iteration, in units of length per unit of the input's colours."""
        return self.manifold.beta / self.manifold.noise.growth

    @property
    def guide_betas(self) -> dict[str, float]:
        return {guide.name: guide.beta for guide in self.manifold.guides}

    @property
    def outliers(self) -> dict[str, object]:
        """How many samples were outliers, their share of all, and whether they are replaced; empty: none were."""
        own, is_replaced = self.manifold.outliers, self.parameters.outliers != "keep"
        return {} if own is None else {"count": len(own.samples), "share": own.share, "replaced": is_replaced}

    def step(self, iteration: int) -> Step:
        """Return an iteration, counted from 0."""
        own = self.parameters
        return Step(self.manifold.beta * own.growth(iteration), own.t, own.is_regularised(iteration))

    def with_noise(self, sigma: Float64s, reading: Reading | None) -> Plan[AnyManifold]:
        """Return the plan for colours with other noise, root mean square differences from the truth by channel.

        No PSNR is predicted for it.
        """
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
        """Return the plan of the iterations before one, counted from 0, and of nothing after them."""
        first = dataclasses.replace(self.parameters, iterations=iteration, clipping="keep")
        manifold = dataclasses.replace(self.manifold, parameters=first)
        return dataclasses.replace(self, takes_patches=False, light=None, manifold=manifold)


@dataclass(frozen=True)
class FlowResult(Generic[AnyManifold]):
    """What smoothing made of a manifold."""

    manifold: AnyManifold  # with the new colours
    choice: Choice | None
    samples_per_kernel: float  # mean over samples and iterations
    truncated: int  # kernels that were cut short at `max_samples`
    patches: float | None = None  # the share taken from patches; None: only the kernel was run


def choose_parameters(
    manifold: AnyManifold,
    wanted: KernelParameters,
    tick: Callable[[], None] | None = None,
    *,
    light_in: Space | None = None,
) -> Plan[AnyManifold]:
    """Choose the open parameters by the estimated error of the result.

    Where patches follow, noise that neighbouring samples share is first removed from the colours, in place, but for
    its finest details. `tick` is called often, and may raise to stop. `light_in` is the space of colours that stand for
    light, whose mean stays unless beta is given.
    """
    light = None
    if light_in is not None and wanted.evens_noise:
        light = MeanLight.of(manifold, light_in)
        # Texels that no path has lit are black, and no noise was cut off there.
        wanted = dataclasses.replace(wanted, clipping="keep")
        kept = dataclasses.replace(manifold.parameters, clipping="keep")
        manifold = dataclasses.replace(manifold, parameters=kept)
    moves = manifold.moving is not None
    if moves and chunking() is not None:
        raise UsageError("vertices are not moved in pieces; leave out --pieces, or --smooth-geometry")
    if moves:  # positions take the same iterations, for which the best parameters of colours are too strong
        wanted = dataclasses.replace(wanted, free=())
    noise, error = manifold.noise, 0.0
    noisy = is_noisy(noise.of_input)
    corrects = noisy and noise.is_shared and wanted.takes_patches and not moves
    if corrects:
        manifold, error = denoise_means(manifold, tick)
    chosen, choice = tune(manifold, wanted, noisy=noisy, tick=tick)
    if corrects and "iterations" in wanted.free:
        chosen = dataclasses.replace(chosen, iterations=max(1, chosen.iterations))
    if choice is not None:
        variance = float(np.mean(np.square(noise.of_input)))
        choice = choice.improved(-error)
        if corrects and choice.psnr is not None:
            # Until here the gain is over colours whose shared noise is removed already.
            choice = dataclasses.replace(choice, gain=choice.psnr + 10 * math.log10(variance))
    work = manifold.geometry.work(manifold.unit)
    chosen = work.bounded(chosen)
    work.announce(chosen)
    manifold.geometry.drop_samples()
    read = noise.as_read()
    return Plan(
        manifold=dataclasses.replace(manifold, parameters=chosen), noise=read.of_input,
        described_noise=read.described(), reading=noise.reading, choice=choice,
        takes_patches=wanted.takes_patches and chosen.iterations > 0 and not moves and noisy, light=light,
    )  # fmt: skip


def smooth(
    plan: Plan[AnyManifold], progress: Callable[[int, int], None] | None = None
) -> FlowResult[AnyManifold]:
    """Run the kernel and, if planned, patches, on the manifold's colours, which are taken over.

    `progress` is called with work done and total, and may raise to stop.
    """
    manifold, choice, share, run = plan.manifold, plan.choice, None, Averaged([], 0.0)
    iterations = plan.parameters.iterations
    passes = 2 * (iterations + sum(PASSES)) if plan.takes_patches else iterations
    stages = _Stages(progress, passes, manifold.geometry.size)
    is_clipped = plan.parameters.clipping == "restore" and manifold.beta > 0 and iterations
    clipped = manifold.geometry.find_clipped(manifold.colours, manifold.noise.sigma) if is_clipped else None

    def kernel(colours: Float32s) -> Float32s:
        nonlocal run
        done = _run_kernel(plan, colours, clipped, stages)
        run = dataclasses.replace(done, stacks=[])
        return done.stacks[0]

    if plan.takes_patches:
        blend = blend_with_patches(manifold, manifold.colours, kernel, clipped, stages.of)
        colours, share = blend.colours, blend.share
        choice = None if choice is None else choice.improved(blend.gain)
    else:
        colours = kernel(manifold.colours)
    per_kernel = run.samples / max(1, iterations * manifold.geometry.kernels)
    smoothed = dataclasses.replace(manifold, colours=colours, moving=run.moving)
    if plan.light is not None and iterations:
        plan.light.restore(smoothed)
    return FlowResult(smoothed, choice, per_kernel, run.truncated, share)


def _run_kernel(
    plan: Plan[Any], colours: Float32s, clipped: ClippedChannels | None, stages: _Stages
) -> Averaged:
    """Run all iterations on colours, which are overwritten, and restore what was cut off of them."""
    manifold = plan.manifold
    steps = [plan.step(iteration) for iteration in range(plan.parameters.iterations)]
    stacks = [colours] if clipped is None else [colours, mark_clipped(manifold, clipped)]
    done = _iterate(manifold, stacks, steps, stages)
    if clipped is not None:
        restore_clipped(manifold, clipped, *done.stacks)
    return done


def _iterate(manifold: Manifold, stacks: list[Float32s], steps: Sequence[Step], stages: _Stages) -> Averaged:
    samples, truncated, gaussian = 0.0, 0, None
    for step in steps:
        metric = manifold.measure(stacks[0], step, gaussian)  # eq. (1)
        gaussian = metric.gaussian  # none any more after the last regularised iteration
        done = manifold.average(stacks, metric, stages.of(1))  # eq. (9)
        stacks, samples, truncated = done.stacks, samples + done.samples, truncated + done.truncated
        if done.moving is not None:
            manifold = dataclasses.replace(manifold, moving=done.moving)
    return Averaged(stacks, samples, truncated, manifold.moving)


class _Stages:
    """Joins the progress of stages, each of which goes through `size` samples and takes some iterations' time."""

    def __init__(self, progress: Callable[[int, int], None] | None, iterations: int, size: int) -> None:
        self._progress, self._total, self._size, self._before = progress, iterations * size, size, 0

    def of(self, iterations: int) -> Callable[[int], None] | None:
        """Return what the next stage calls with the samples that it has gone through."""
        before, report = self._before, self._progress
        self._before += iterations * self._size
        return None if report is None else lambda done: report(before + iterations * done, self._total)
