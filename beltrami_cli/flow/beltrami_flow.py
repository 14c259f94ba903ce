"""N iterations of the short-time Beltrami kernel on an image manifold."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Iterator, Sequence
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s
from beltrami_cli.errors import UsageError
from beltrami_cli.flow.coarse_levels import denoise_means
from beltrami_cli.flow.manifold import Manifold
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.flow.partitions import Joined, Partition, Runner, TooNarrowError
from beltrami_cli.flow.patches import PASSES, blend_with_patches
from beltrami_cli.flow.records import Averaged, SampledKernel, Step
from beltrami_cli.flow.tuning.choice import Choice, is_noisy, tune

# Levels of dark, middle and bright colours.
_LEVELS = {"dark": 0.1, "middle": 0.5, "bright": 0.9}

# The quantiles of places that are said to be quiet and loud.
_QUIET, _LOUD = 0.05, 0.95


@dataclass(frozen=True)
class FlowResult:
    """How smoothed samples came about; `choice` is None where no parameter was chosen from the data."""

    spacing: float  # mean sample spacing, in the surface's own unit of length
    beta: float  # that was used, in units of length per unit of colour
    sigma: Float64s  # estimated noise by channel
    samples_per_kernel: float  # mean over samples and iterations
    truncated: int  # kernels that were cut short at ...
    max_samples: int  # ... the largest that was allowed
    choice: Choice | None
    patches: float | None = None  # the share taken from patches; None: only the kernel was run


@dataclass(frozen=True)
class Split:
    """Surfaces are smoothed in `count` partitions, by a runner."""

    count: int
    runner: Runner

    def run(
        self,
        cut: Callable[[int], Sequence[Partition]],
        values: Float32s,
        iterations: int,
        progress: Callable[[int, int], None] | None,
    ) -> Joined:
        """Cut a surface and run all iterations; partitions that prove too narrow are cut again, twice as wide."""
        widening = 1
        while True:
            try:
                return self.runner.run(cut(widening), values, iterations, progress)
            except TooNarrowError:
                widening *= 2


_WANTED: ContextVar[Split | None] = ContextVar("split", default=None)


@contextlib.contextmanager
def in_partitions(count: int, runner: Runner) -> Iterator[None]:
    """Within this context and thread, smooth every surface in up to `count` partitions."""
    token = _WANTED.set(Split(count, runner))
    try:
        yield
    finally:
        _WANTED.reset(token)


def wanted_split() -> Split | None:
    """Return how surfaces are split in this context; None: not at all."""
    return _WANTED.get()


AnyManifold = TypeVar("AnyManifold", bound=Manifold)


class BeltramiFlow(Generic[AnyManifold]):
    """The kernel on a manifold, with its parameters as used: what was left open is chosen from the data.

    `noise` is its standard deviation by channel as it was found, before any was removed.
    `tick` is called often meanwhile, and may raise to stop.
    """

    def __init__(
        self, manifold: AnyManifold, parameters: KernelParameters, tick: Callable[[], None] | None = None
    ) -> None:
        self.manifold: AnyManifold = manifold
        self._split = wanted_split()
        moves = manifold.moving is not None
        if moves and self._split is not None:
            raise UsageError("vertices are not moved in pieces; leave out --pieces, or --smooth-geometry")
        if moves:  # positions take the same iterations, and what is best for colours is not best for them
            parameters = dataclasses.replace(parameters, free=())
        noisy, self._error = is_noisy(manifold.noise), 0.0
        corrects = noisy and manifold.shares_noise and parameters.takes_patches and not moves
        self.noise, self.noise_model = manifold.noise, describe_noise(manifold)
        if corrects:
            self._error = denoise_means(manifold, tick)
        chosen, self.choice = tune(manifold, parameters, noisy=noisy, tick=tick)
        if corrects and "iterations" in parameters.free:
            chosen = dataclasses.replace(chosen, iterations=max(1, chosen.iterations))
        if self.choice is not None:
            variance = float(np.mean(np.square(self.noise)))
            self.choice = self.choice.improved(-self._error).doubted(variance, manifold.doubt)
        work = manifold.work
        self.parameters = work.bounded(chosen)
        work.announce(self.parameters)
        manifold.parameters = self.parameters
        chosen_beta = self.parameters.beta
        self._beta = manifold.beta if chosen_beta is None or manifold.beta == 0 else chosen_beta
        self.beta = manifold.given_beta(self._beta)
        if self._split is None:
            manifold.release()
        self.takes_patches = parameters.takes_patches and self.parameters.iterations > 0 and not moves
        self.takes_patches &= noisy
        self._samples, self._truncated = 0.0, 0
        self._clipped = None
        if self.parameters.clipping == "restore" and self.beta > 0 and self.parameters.iterations:
            self._clipped = manifold.find_clipped()

    def step(self, iteration: int) -> Step:
        """Return an iteration, counted from 0."""
        own = self.parameters
        return Step(self._beta * own.growth(iteration), own.t, own.is_regularised(iteration))

    def reckon_with(self, sigma: Float64s) -> None:
        """Tell noise as it was by channel before some was taken from the colours, and the gain over that.

        `sigma`: root mean square differences from the truth.
        """
        more = float(np.sqrt(np.mean(np.square(sigma)) / np.mean(np.square(self.noise))))
        self.noise = sigma
        self.noise_model = {
            name: value if name == "grain" else more * value for name, value in self.noise_model.items()
        }
        if self.choice is not None and self.choice.gain is not None:
            self.choice = dataclasses.replace(self.choice, gain=self.choice.gain + 20 * float(np.log10(more)))

    def stop_before(self, iteration: int) -> None:
        """Have `run` do only the iterations before one, counted from 0, and nothing after them."""
        self.takes_patches = False
        self.parameters = dataclasses.replace(self.parameters, iterations=iteration)
        self.manifold.parameters, self._clipped = self.parameters, None

    def run(self, progress: Callable[[int, int], None] | None = None) -> FlowResult:
        """Run the kernel and, if wanted, patches; `progress` is called with work done and total, and may raise."""
        manifold, choice, share = self.manifold, self.choice, None
        iterations = self.parameters.iterations
        passes = 2 * (iterations + PASSES) if self.takes_patches else iterations
        stages = _Stages(progress, passes, manifold.size)
        if self.takes_patches:
            blend = blend_with_patches(
                manifold,
                manifold.colours,
                lambda colours: self._smooth(colours, stages),
                self._clipped,
                stages.of,
            )
            manifold.colours, share = blend.colours, blend.share
            choice = None if choice is None else choice.improved(blend.gain)
        else:
            manifold.colours = self._smooth(manifold.colours, stages)
        return FlowResult(
            manifold.spacing, self.beta, self.noise,
            self._samples / max(1, self.parameters.iterations * manifold.kernels), self._truncated,
            self.parameters.max_samples, choice, share,
        )  # fmt: skip

    def _smooth(self, colours: Float32s, stages: _Stages) -> Float32s:
        """Run all iterations of the kernel on colours, which are overwritten."""
        manifold, iterations = self.manifold, self.parameters.iterations
        stacks, done = [colours], Averaged([colours], 0)
        if self._clipped is not None:
            stacks.append(manifold.marks(self._clipped))
        if iterations and self._split is None:
            done = self._iterate(stacks, stages)
        elif iterations and self._split is not None and manifold.kernels:
            done = self._iterate_in_partitions(stacks, self._split, stages)
        if self._clipped is not None:
            manifold.restore(self._clipped, done.stacks[0], done.stacks[1])
        self._samples, self._truncated = done.samples, done.truncated
        return done.stacks[0]

    def _iterate(self, stacks: list[Float32s], stages: _Stages) -> Averaged:
        """Run all iterations on the whole manifold."""
        manifold, iterations, samples, truncated = self.manifold, self.parameters.iterations, 0.0, 0
        for iteration in range(iterations):
            step = self.step(iteration)
            if not step.regularised:
                manifold.forget_smoothing()
            manifold.measure(stacks[0], step)  # eq. (1)
            done = manifold.average(stacks, stages.of(1))  # eq. (9)
            stacks, samples, truncated = done.stacks, samples + done.samples, truncated + done.truncated
        return Averaged(stacks, samples, truncated)

    def _iterate_in_partitions(self, stacks: list[Float32s], split: Split, stages: _Stages) -> Averaged:
        """Run all iterations partition by partition: the same colours bit for bit; `samples` is an estimate."""
        manifold = self.manifold
        steps = [self.step(iteration) for iteration in range(self.parameters.iterations)]
        channels = stacks[0].shape[manifold.axis]

        def cut(widening: int) -> Sequence[Partition]:
            return manifold.partitions(split.count, widening, steps, channels)

        progress = stages.of(len(steps))
        shared = None if progress is None else lambda done, total: progress(manifold.size * done // total)
        done = split.run(cut, manifold.rows(stacks), len(steps), shared)
        manifold.put_rows(done.values, stacks)
        return Averaged(stacks, done.samples, done.truncated)

    def values(self) -> Float32s:
        """Return the colours of all samples as they are now, shape (S, N), in the caller's order."""
        return self.manifold.values()

    def kernel_at(self, sample: int) -> SampledKernel:
        """Return the kernel that the next iteration would have at a sample."""
        return self.manifold.kernel_at(sample, self.step(self.parameters.iterations))


class _Stages:
    """Joins the progress of stages, each of which goes through `size` samples and takes some iterations' time."""

    def __init__(self, progress: Callable[[int, int], None] | None, iterations: int, size: int) -> None:
        self._progress, self._total, self._size, self._before = progress, iterations * size, size, 0

    def of(self, iterations: int) -> Callable[[int], None] | None:
        """Return what the next stage calls with the samples that it has gone through."""
        before, report = self._before, self._progress
        self._before += iterations * self._size
        return None if report is None else lambda done: report(before + iterations * done, self._total)


def describe_noise(manifold: Manifold) -> dict[str, float]:
    """Return standard deviations, the mean of colour channels, full scale 1, and over how many samples they are shared.

    "dark", "middle" and "bright" are those at these levels, "quiet" and "loud" those of such places, where they differ.
    "grain" is the width of the area that samples share noise over: 1 where each has its own.
    """
    model: dict[str, float] = {}
    if not len(manifold.sigma):
        return model
    sigma = float(np.sqrt(np.mean(np.square(manifold.sigma[:3]))))
    if manifold.stabiliser is not None:
        for name, level in _LEVELS.items():
            model[name] = manifold.stabiliser.sigma_at(level, sigma)
    if manifold.differing is not None:
        mean = float(np.sqrt(np.mean(np.square(manifold.noise[:3]))))
        quiet, loud = np.quantile(manifold.differing, (_QUIET, _LOUD))
        model |= {"quiet": mean * float(np.sqrt(quiet)), "loud": mean * float(np.sqrt(loud))}
    return {**model, "grain": manifold.grain}
