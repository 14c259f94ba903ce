"""The command `beltrami smooth`."""

from __future__ import annotations

from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beltrami_cli.cli import options, outputs
from beltrami_cli.cli.command import command
from beltrami_cli.cli.console import Messages
from beltrami_cli.cli.phrases import (
    NO_AREA,
    counted,
    head_of_result,
    lines_on,
    outliers_in_words,
    output_name,
)
from beltrami_cli.layers.reported_noise import noise_size
from beltrami_cli.quantities import show_amount, show_size
from beltrami_cli.view.noise_in_words import advice_in_words, doubt_in_words, noise_of, reason_in_words

if TYPE_CHECKING:
    from beltrami_cli.flow.given_noise import GivenNoise
    from beltrami_cli.jobs.smooth_report import SmoothReport
    from beltrami_cli.layers.reports import ImageReport, LayerReport, SlotReport, VertexReport


@command("smooth", source="INPUT", target="OUTPUT")
@options.smoothing
@options.unwrapping
@outputs.previewed_result
def smooth(source: str, target: str, messages: Messages, **smoothing: Any) -> None:
    """Smooth the colours of INPUT, in its vertices, textures or pixels, and write OUTPUT with nothing else changed."""
    settings, dry_run = options.settings_from(smoothing), smoothing["dry_run"]
    unwrap = options.unwrapping_from(smoothing)
    from beltrami_cli.jobs.smooth import smooth_file

    carry_out = partial(smooth_file, source, target, settings, unwrap=unwrap)
    report = outputs.run_and_write(smoothing, (source, target), messages, carry_out, settings)
    outputs.show_levelled(messages, report.levelled, head_of_result(report.output, dry_run=dry_run))
    if settings.kernel.iterations:
        _show_result(messages, report, settings.kernel.given_noise, dry_run=dry_run)
    elif not settings.level_seams:
        _show_unchanged(messages, report, unwrapped=unwrap is not None, dry_run=dry_run)
    if report.new_texture:
        messages.say(f"{head_of_result(report.output, dry_run=dry_run)}{report.new_texture}")
    details = asdict(report)
    for line in lines_on({key: details[key] for key in ("stages", "vertices", "image", "textures")}):
        messages.detail(line)


def _show_result(
    messages: Messages, report: SmoothReport, given: GivenNoise | None, *, dry_run: bool
) -> None:
    messages.warn_of(report.input, report.warnings)
    if report.peak_memory is not None:
        show = messages.say if dry_run else messages.detail
        show(f"peak memory: {show_size(report.peak_memory)}")
    name = head_of_result(report.output, dry_run=dry_run)
    if report.vertices is not None:
        _show_vertices(messages, name, report.vertices)
    if report.image is not None:
        _show_image(messages, name, report.image, given)
    for slot in report.textures:
        _show_textures(
            messages, name, slot, is_one=sum(each.slot == slot.slot for each in report.textures) == 1
        )


def _show_vertices(messages: Messages, name: str, done: VertexReport) -> None:
    what = counted(int(done.counts["vertices"]), "point" if "outliers" in done.counts else "vertex")
    # A kernel with given parameters averages what lies at one place.
    is_empty = not (done.spacing or done.iterations) and done.counts.get("triangles", 0) > 0
    what += f", {NO_AREA}" if is_empty else ""
    _show_done(messages, name + what, done, is_empty=is_empty, noun="sample")
    if done.geometry is not None:
        share = done.geometry["mean_move"] / done.spacing if done.spacing else 0.0
        messages.say(f"{name}positions too, by {share:.2f} sample spacings on average")


def _show_image(messages: Messages, name: str, done: ImageReport, given: GivenNoise | None) -> None:
    facts: dict[str, Any] = done.image
    holes = f", {facts['holes']} of them transparent, masked or not finite" if facts["holes"] else ""
    what = f"{name}{facts['width']} x {facts['height']} pixels{holes}"
    is_empty = facts["holes"] == facts["width"] * facts["height"]
    left = _left_by_coding(done, given) if facts["format"] == "jpeg" else ""
    _show_done(messages, what, done, is_empty=is_empty, noun="pixel", why=left)


def _show_textures(messages: Messages, name: str, done: SlotReport, *, is_one: bool) -> None:
    textures = counted(len(done.textures), f"{done.slot} texture")
    textures += "" if is_one else f" ({', '.join(str(each['name']) for each in done.textures)})"
    texels = f"{counted(done.counts['covered'], 'texel')} in {counted(done.counts['charts'], 'chart')}"
    is_empty = not done.counts["covered"]
    _show_done(messages, f"{name}{textures}, {texels}", done, is_empty=is_empty, noun="texel")


def _show_done(
    messages: Messages, what: str, done: LayerReport, *, is_empty: bool, noun: str, why: str = ""
) -> None:
    """Say what was done to a part; `why` explains the noise."""
    if is_empty:  # `what` or a warning says why.
        messages.say(f"{what}, so the colours are left as they are")
        return
    wrong = outliers_in_words(done.wrong_samples, noun)
    what += f", {wrong}" if wrong else ""
    part, is_smoothed = asdict(done), done.iterations > 0
    if is_smoothed and not done.change["largest"]:
        messages.say(f"{what}, noise {noise_of(part)}, but no colour of the written file changes")
        return
    moved = f" (colours moved by {show_amount(done.change['mean'])} on average)"
    if doubt := doubt_in_words(part, is_smoothed=is_smoothed, moved=moved):
        messages.say(f"{what}, {doubt}")
        return
    if not is_smoothed:
        others = "all other colours" if done.wrong_samples.get("replaced") else "the colours"
        messages.say(
            f"{what}, {reason_in_words(part)}, so {others} are left as they are{advice_in_words(part)}"
        )
    elif any(done.noise.values()):
        messages.say(f"{what}, noise {noise_of(part)} removed{why}{moved}")
    else:
        messages.say(f"{what}, {reason_in_words(part)}, smoothed all the same{moved}")


def _left_by_coding(done: LayerReport, given: GivenNoise | None) -> str:
    """Explain the noise of a JPEG image that had the given noise before it was coded."""
    if given is None or show_amount(noise_size(asdict(done))) == show_amount(given.sigma):
        return ""
    return f", which JPEG coding left of {show_amount(given.sigma)}" if given.sigma else ""


def _show_unchanged(messages: Messages, report: SmoothReport, *, unwrapped: bool, dry_run: bool) -> None:
    messages.warn_of(report.input, report.warnings)
    what = "would be" if dry_run else "is"
    if Path(report.input).suffix.lower() != f".{report.format}" or unwrapped:
        made = "laid out on a new texture" if unwrapped else f"converted to {report.format}"
        kept = "only the type of images is changed" if report.textures else "its colours are unchanged"
        result = f"it {what} {made}, and {kept}"
    elif report.textures:
        result = "only the type of images is changed"
    else:
        names = ", but for the names of its images and other files" if len(report.written) > 1 else ""
        result = f"the file {what} copied unchanged{names}"
    messages.say(f"{output_name(report.output)}: no iterations, so {result}")
