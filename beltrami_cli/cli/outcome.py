"""What is printed when a file has been smoothed."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from beltrami_cli.cli.console import counted
from beltrami_cli.jobs.resources import show_size

if TYPE_CHECKING:
    from beltrami_cli.cli.console import Messages
    from beltrami_cli.jobs.smoothing import SmoothReport
    from beltrami_cli.samples.reports import ImageReport, SlotReport, VertexReport

    Done = VertexReport | ImageReport | SlotReport


def show_unchanged(messages: Messages, report: SmoothReport, *, unwrapped: bool, dry_run: bool) -> None:
    """Say that no iterations were asked for, and the warnings."""
    messages.warn_of(report.input, report.warnings)
    same = Path(report.input).suffix.lower() == f".{report.format}" and not unwrapped
    what = "would be" if dry_run else "is"
    messages.say(
        f"{report.output}: no iterations, so the file {what} copied unchanged"
        if same
        else f"{report.output}: no iterations, so the colours are unchanged"
    )


def show_result(messages: Messages, report: SmoothReport, *, dry_run: bool) -> None:
    """Say what was done to the colours; in detail also the times, and which parameters were chosen by what."""
    messages.warn_of(report.input, report.warnings)
    _show_costs(messages, report, dry_run=dry_run)
    free = cast("list[str]", report.parameters["free"])
    for key in ("iterations", "t", "threshold", "metric_scale", "metric_steps", "space"):
        messages.detail(f"{key:>14}: {'chosen from the data' if key in free else report.parameters[key]}")
    name = f"{report.output}: {'not written (dry run), ' if dry_run else ''}"
    if report.vertices is not None:
        done = report.vertices
        what = counted(int(done.counts["vertices"]), "point" if "outliers" in done.counts else "vertex")
        _show_done(messages, name + what, done, done.counts["samples_per_kernel"])
        if done.geometry is not None:
            messages.say(name + _geometry(done.geometry, done.spacing))
    if report.image is not None:
        facts = report.image.image
        holes = f" with {counted(cast('int', facts['holes']), 'hole')}" if facts["holes"] else ""
        what = f"{facts['width']} x {facts['height']} pixels{holes}"
        _show_done(messages, name + what, report.image, report.image.samples_per_kernel)
    for slot in report.textures:
        textures = counted(len(slot.textures), f"{slot.slot} texture")
        charts = counted(slot.counts["charts"], "chart")
        what = f"{textures}, {counted(slot.counts['covered'], 'texel')} in {charts}"
        _show_done(messages, name + what, slot, slot.samples_per_kernel)
        if slot.counts["jumps"]:
            jumps = f"{slot.counts['jumps']} of {counted(slot.counts['seams'], 'seam')}"
            messages.detail(f"{jumps} are real colour edges and were not smoothed over")


def _show_costs(messages: Messages, report: SmoothReport, *, dry_run: bool) -> None:
    for stage, seconds in report.stages.items():
        messages.detail(f"{stage:>14}: {seconds['wall']:.2f} s, {seconds['cpu']:.2f} s CPU")
    if report.peak_memory is not None:
        (messages.say if dry_run else messages.detail)(
            f"{'peak memory':>14}: {show_size(report.peak_memory)}"
        )


def _show_done(messages: Messages, what: str, done: Done, samples: float) -> None:
    noise = f"{what}, noise {255 * max(done.noise.values(), default=0):.1f}/255"
    if not done.iterations:
        messages.say(f"{noise}, no more than rounding makes: the colours are left as they are")
        return
    messages.say(
        f"{noise}, beta {done.beta:.3g}, {samples:.0f} samples a kernel, "
        f"mean change {255 * done.change['mean']:.1f}/255"
    )
    for guide, beta in done.guides.items():
        messages.detail(f"guide {guide}: beta {beta:.3g}")
    if done.choice is not None:
        messages.detail(f"chosen: {choice_in_words(done.choice)}")


def choice_in_words(choice: dict[str, Any]) -> str:
    """Return what was chosen, by what estimate, and how sure that is."""
    chosen = ", ".join(f"{name} {value:.3g}" for name, value in choice["chosen"].items())
    if choice["psnr"] is None:
        return f"{chosen}; by the fixed rule of --fast"
    shared = "; neighbours share noise, as in JPEG pictures" if choice["correlated"] else ""
    return (
        f"{chosen}; estimated PSNR {choice['psnr']:.1f} +- {choice['error']:.1f} dB, {choice['gain']:+.1f} dB "
        f"against the input; the best of {choice['candidates']} on {choice['samples']} samples{shared}"
    )


def _geometry(geometry: dict[str, float], spacing: float) -> str:
    share = geometry["mean_move"] / spacing if spacing else 0.0
    return (
        f"positions too, noise of the normals {math.degrees(geometry['normal_noise']):.1f} degrees, normal beta "
        f"{geometry['normal_beta']:.3g}, mean move {geometry['mean_move']:.3g} ({share:.2f} sample spacings)"
    )
