"""Smooth an image manifold as planned: N iterations of the short-time Beltrami kernel, then patches.

Smoothing is three functions of values: `estimate_on_mesh` or `estimate_on_canvas`, `choose_parameters`, and
`smooth_in_place`. Only the last one overwrites an array that it is given, since the colours may take half of the
memory.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Generic

from beltrami_cli.arrays import Float32s
from beltrami_cli.flow.choice.choice import Choice
from beltrami_cli.flow.corrections.clipping import (
    ClippedChannels,
    clipped_on,
    mark_clipped,
    restore_clipped_in_place,
)
from beltrami_cli.flow.manifolds.iteration import Averaged, Step
from beltrami_cli.flow.manifolds.manifold import Manifold
from beltrami_cli.flow.patches import PASSES, blend_with_patches_in_place
from beltrami_cli.flow.plan import AnyManifold, Plan


@dataclass(frozen=True)
class FlowResult(Generic[AnyManifold]):
    """The result of smoothing a manifold."""

    manifold: AnyManifold  # with the new colours
    choice: Choice | None
    samples_per_kernel: float  # mean over samples and iterations
    truncated: int  # kernels truncated at `max_samples`
    patches: float | None = None  # mean weight of the patches; None: only the kernel was run


def smooth_in_place(
    plan: Plan[AnyManifold], progress: Callable[[int, int], None] | None = None
) -> FlowResult[AnyManifold]:
    """Run the kernel and, if planned, patches. The result takes the memory of the plan's colours, which are lost.

    `progress` is called with the work done and the total, and may raise to stop.
    """
    manifold, choice, share = plan.manifold, plan.choice, None
    manifold.geometry.drop_samples()
    iterations = plan.parameters.iterations
    passes = 2 * (iterations + sum(PASSES)) if plan.takes_patches else iterations
    stages = _Stages(progress, passes, manifold.geometry.size)
    is_restored = plan.parameters.clipping == "restore" and manifold.beta > 0 and iterations
    clipped = clipped_on(manifold) if is_restored else None
    kernel = partial(_run_kernel_in_place, plan, clipped=clipped, stages=stages)
    if plan.takes_patches:
        blend = blend_with_patches_in_place(manifold, kernel, clipped, stages.of)
        done, share = blend.averaged, blend.share
        choice = None if choice is None else choice.improved(blend.gain)
    else:
        done = kernel(manifold.colours)
    per_kernel = done.samples / max(1, iterations * manifold.geometry.kernels)
    smoothed = dataclasses.replace(manifold, colours=done.stacks[0], moving=done.moving)
    if plan.light is not None and iterations:
        plan.light.restore_in_place(smoothed)
    return FlowResult(smoothed, choice, per_kernel, done.truncated, share)


def _run_kernel_in_place(
    plan: Plan[Any], colours: Float32s, *, clipped: ClippedChannels | None, stages: _Stages
) -> Averaged:
    """Run all iterations on colours, and correct the averages of clipped samples."""
    manifold = plan.manifold
    steps = [plan.step(iteration) for iteration in range(plan.parameters.iterations)]
    stacks = [colours] if clipped is None else [colours, mark_clipped(manifold, clipped)]
    done = _iterate_in_place(manifold, stacks, steps, stages)
    if clipped is not None:
        restore_clipped_in_place(manifold, clipped, *done.stacks)
    return dataclasses.replace(done, stacks=done.stacks[:1])


def _iterate_in_place(
    manifold: Manifold, stacks: list[Float32s], steps: Sequence[Step], stages: _Stages
) -> Averaged:
    samples, truncated, gaussian = 0.0, 0, None
    for step in steps:
        metric = manifold.measure(stacks[0], step, gaussian)  # eq. (1)
        gaussian = metric.gaussian  # None after the last regularised iteration
        done = manifold.average_in_place(stacks, metric, stages.of(1))  # eq. (9)
        stacks, samples, truncated = done.stacks, samples + done.samples, truncated + done.truncated
        if done.moving is not None:
            manifold = dataclasses.replace(manifold, moving=done.moving)
    return Averaged(stacks, samples, truncated, manifold.moving)


class _Stages:
    """Progress over several stages, each with a number of iterations over `size` samples."""

    def __init__(self, progress: Callable[[int, int], None] | None, iterations: int, size: int) -> None:
        self._progress, self._total, self._size, self._before = progress, iterations * size, size, 0

    def of(self, iterations: int) -> Callable[[int], None] | None:
        """Return the progress callback of the next stage, which takes the number of samples done."""
        before, report = self._before, self._progress
        self._before += iterations * self._size
        return None if report is None else lambda done: report(before + iterations * done, self._total)
