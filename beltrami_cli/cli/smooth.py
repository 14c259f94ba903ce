"""The commands that write new colours: `beltrami smooth`, and `level`, `bake` and `noise`."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast, get_args

import click

from beltrami_cli.cli import options
from beltrami_cli.cli.commands import command, complete_files, overwrite_at
from beltrami_cli.cli.console import NO_AREA, Messages, counted, lines_on, outliers_in_words, output_name
from beltrami_cli.errors import OutputError, UsageError
from beltrami_cli.jobs.job import Job
from beltrami_cli.jobs.settings import BakeSettings, NoiseSettings
from beltrami_cli.layers.settings import DEFAULTS, BakeTo, LevelSettings, SmoothSettings
from beltrami_cli.quantities import of_255, show_size
from beltrami_cli.view.words import advice_in_words, doubt_in_words, noise_of, reason_in_words

if TYPE_CHECKING:
    from beltrami_cli.jobs.output import Output
    from beltrami_cli.jobs.recolour import FileReport
    from beltrami_cli.jobs.smoothing import SmoothReport
    from beltrami_cli.layers.layer import LayerReport, LevelReport
    from beltrami_cli.view.before_after import Preview

Report = TypeVar("Report", bound="FileReport")

_dry_run = click.option("--dry-run", is_flag=True, help="Compute and report, but write no OUTPUT.")
_report = click.option(
    "--report",
    "report_path",
    metavar="FILE.json",
    shell_complete=complete_files,
    help="Write parameters, counts and changes; - prints them.",
)
_preview = click.option(
    "--preview", "preview_path", metavar="FILE.png", shell_complete=complete_files,
    help="Draw INPUT and OUTPUT side by side, with a detail; `beltrami render` draws others.",
)  # fmt: skip


def _reporting(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of a report."""
    return options.as_json(_report(command))


def _report_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of a dry run, a report and a preview."""
    return _dry_run(_reporting(_preview(command)))


@command("smooth", source="INPUT", target="OUTPUT")
@options.smoothing
@options.unwrapping
@options.output_format
@options.reading
@options.overwrite
@_report_options
@options.messages
def smooth(source: str, target: str, messages: Messages, **smoothing: Any) -> None:
    """Smooth the colours of INPUT, in its vertices, textures or pixels, and write OUTPUT with nothing else changed."""
    settings, dry_run = options.settings_from(smoothing), smoothing["dry_run"]
    unwrap = options.unwrapping_from(smoothing)
    from beltrami_cli.jobs.smooth import smooth_file

    carry_out = partial(smooth_file, source, target, settings, unwrap=unwrap)
    report = _written(smoothing, (source, target), messages, carry_out, settings)
    name = output_name(report.output)
    _show_levelled(messages, report.levelled, f"{name}: ")
    if settings.kernel.iterations:
        _show_result(messages, report, dry_run=dry_run)
    elif not settings.level_seams:
        _show_unchanged(messages, report, unwrapped=unwrap is not None, dry_run=dry_run)
    if report.new_texture:
        unwritten = "not written (dry run), " if dry_run else ""
        messages.say(f"{name}: {unwritten}{report.new_texture}")
    details = asdict(report)
    for line in lines_on({key: details[key] for key in ("stages", "vertices", "image", "textures")}):
        messages.detail(line)


def _show_result(messages: Messages, report: SmoothReport, *, dry_run: bool) -> None:
    messages.warn_of(report.input, report.warnings)
    if report.peak_memory is not None:
        show = messages.say if dry_run else messages.detail
        show(f"peak memory: {show_size(report.peak_memory)}")
    name = f"{output_name(report.output)}: {'not written (dry run), ' if dry_run else ''}"
    if report.vertices is not None:
        done = report.vertices
        what = counted(int(done.counts["vertices"]), "point" if "outliers" in done.counts else "vertex")
        # A kernel with given parameters averages what lies at one place.
        is_empty = not (done.spacing or done.iterations) and done.counts.get("triangles", 0) > 0
        what += f", {NO_AREA}" if is_empty else ""
        _show_done(messages, name + what, done, is_empty=is_empty)
        if done.geometry is not None:
            share = done.geometry["mean_move"] / done.spacing if done.spacing else 0.0
            messages.say(f"{name}positions too, by {share:.2f} sample spacings on average")
    if report.image is not None:
        facts = report.image.image
        holes = f" with {counted(cast('int', facts['holes']), 'hole')}" if facts["holes"] else ""
        what = f"{facts['width']} x {facts['height']} pixels{holes}"
        is_empty = facts["holes"] == cast("int", facts["width"]) * cast("int", facts["height"])
        _show_done(messages, name + what, report.image, is_empty=is_empty, noun="pixel")
    for slot in report.textures:
        textures = counted(len(slot.textures), f"{slot.slot} texture")
        if sum(other.slot == slot.slot for other in report.textures) > 1:
            textures += f" ({', '.join(str(each['name']) for each in slot.textures)})"
        charts = counted(slot.counts["charts"], "chart")
        what = f"{textures}, {counted(slot.counts['covered'], 'texel')} in {charts}"
        is_empty = not slot.counts["covered"]
        _show_done(messages, name + what, slot, is_empty=is_empty, noun="texel")


def _show_done(
    messages: Messages, what: str, done: LayerReport, *, is_empty: bool = False, noun: str = "sample"
) -> None:
    if is_empty:  # `what` or a warning says why.
        messages.say(f"{what}, so the colours are left as they are")
        return
    wrong = outliers_in_words(done.wrong_samples, noun)
    what += f", {wrong}" if wrong else ""
    part, is_smoothed = asdict(done), done.iterations > 0
    if is_smoothed and not done.change["largest"]:
        messages.say(f"{what}, noise {noise_of(part)}, but no colour of the written file changes")
        return
    moved = f" (colours moved by {of_255(done.change['mean'])}/255 on average)"
    if doubt := doubt_in_words(part, is_smoothed=is_smoothed, moved=moved):
        messages.say(f"{what}, {doubt}")
        return
    if not is_smoothed:
        others = "all other colours" if done.wrong_samples.get("replaced") else "the colours"
        messages.say(
            f"{what}, {reason_in_words(part)}, so {others} are left as they are{advice_in_words(part)}"
        )
    elif any(done.noise.values()):
        messages.say(f"{what}, noise {noise_of(part)} removed{moved}")
    else:
        messages.say(f"{what}, {reason_in_words(part)}, smoothed all the same{moved}")


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


@command("level", source="INPUT", target="OUTPUT")
@options.options_of(LevelSettings)
@options.options_of(
    SmoothSettings, only=(*options.TEXTURES, *options.ENCODING, "alpha"), changed=options.SPACE_WITHOUT_OKLAB
)
@options.output_format
@options.reading
@options.overwrite
@_report_options
@options.messages
def level(source: str, target: str, messages: Messages, **values: Any) -> None:
    """Remove the exposure steps between the charts of the textures of INPUT, and write OUTPUT."""
    levelling = options.record_from(LevelSettings, values)
    settings = options.record_from(SmoothSettings, values)
    from beltrami_cli.jobs.level import level_file

    carry_out = partial(level_file, source, target, levelling, settings)
    report = _written(values, (source, target), messages, carry_out, settings)
    messages.warn_of(source, report.warnings)
    unwritten = "not written (dry run), " if values["dry_run"] else ""
    _show_levelled(messages, report.levelled, f"{output_name(target)}: {unwritten}")


def _show_levelled(messages: Messages, reports: Sequence[LevelReport], name: str) -> None:
    """Report for each slot what was done about exposure steps, or why nothing was done."""
    for each in reports:
        seams = f"{each.what}, {counted(each.charts, 'chart')}, {counted(each.seams, 'seam')} between them"
        if not each.levelled:
            step = f", median step {255 * each.before:.1f}/255" if each.seams else ""
            messages.say(f"{name}{seams}{step}: left as they are; {each.reason}")
            continue
        how = "gains that fall off over charts, and offsets" if each.tilted else "gains and offsets"
        mean = f", mean change {255 * each.change['mean']:.1f}/255" if each.change else ""
        steps = f"median step {255 * each.before:.1f}/255, now {255 * each.after:.1f}/255"
        messages.say(f"{name}{seams}, {steps}, by {how}{mean}")
        messages.detail(
            f"{each.stepped} of the seams had a step, {each.painted} of all are edges of colour; "
            f"one exposure per chart explains {100 * each.explained:.0f} % of the steps at seams that were held out"
        )


def _written(
    values: Mapping[str, Any], ends: tuple[str, str], messages: Messages, carry_out: Callable[[Job], Report],
    settings: SmoothSettings = DEFAULTS,
) -> Report:  # fmt: skip
    """Carry out a job from INPUT to OUTPUT, and put all that it writes in place together; `settings`: for a preview."""
    from beltrami_cli.formats.changes import Written
    from beltrami_cli.jobs.output import FileSet

    with options.job_from(values, ends[0], messages) as job, FileSet(ends) as files:
        job = replace(job, dry_run=values.get("dry_run", False), files=files)
        named = dict.fromkeys([values["report_path"], "-" if values["as_json"] else None])
        report_files = [_open_report(path, ends[1], job) for path in named if path is not None]
        preview = _open_preview(values.get("preview_path"), ends, settings, job)
        report = carry_out(job if preview is None else replace(job, check=preview.check))
        if preview is not None:
            preview.draw()
        for file in report_files:
            file.write(Written(main=[(json.dumps(asdict(report), indent=2) + "\n").encode()]))
        files.commit()
    return report


def _open_report(path: str, target: str, job: Job) -> Output:
    """Check that a report can be written, before anything is computed."""
    from beltrami_cli.jobs.output import Output
    from beltrami_cli.jobs.smoothing import is_report

    if path == target == "-":
        raise OutputError("<stdout>", "the report would mix with OUTPUT", "name a file for one of them")
    replaced = overwrite_at("report_path", overwrite=job.overwrite)
    return Output(path, overwrite=replaced, is_text=True, what="report", is_own=is_report, files=job.files)


def _open_preview(
    path: str | None, names: tuple[str, str], settings: SmoothSettings, job: Job
) -> Preview | None:
    """Check that a preview of INPUT and OUTPUT can be drawn, if one is wanted, before anything is computed."""
    if path is None:
        return None
    from beltrami_cli.view.before_after import Preview

    if job.dry_run:
        raise UsageError("--preview draws OUTPUT, which --dry-run does not write")
    assert job.files is not None
    replaced = overwrite_at("preview_path", overwrite=job.overwrite)
    return Preview(path, *names, settings, job.access, overwrite=replaced, files=job.files)


@command("bake", source="INPUT", target="OUTPUT")
@click.option("--to", type=click.Choice(get_args(BakeTo)), required=True, help="Where the colours go.")
@options.options_of(BakeSettings)
@options.output_format
@_reporting
@options.writing
def bake(source: str, target: str, to: BakeTo, messages: Messages, **values: Any) -> None:
    """Move the colours of INPUT from its vertices to a texture, or from its textures to the vertices."""
    settings = options.record_from(BakeSettings, values)
    if to == "vertices":
        options.refuse_typed(BakeSettings, "of the new texture that --to texture makes; leave it out")
    from beltrami_cli.jobs.bake import bake_file

    report = _written(values, (source, target), messages, partial(bake_file, source, target, to, settings))
    messages.warn_of(report.input, report.warnings)
    for path in report.written[1:]:
        messages.detail(f"written with it: {path}")
    made = ", ".join(counted(number, noun) for noun, number in report.counts.items())
    messages.say(f"{output_name(report.output)}: {made}" + (f", {report.texture}" if report.texture else ""))


@command("noise", source="INPUT", target="OUTPUT")
@options.options_of(NoiseSettings)
@options.options_of(
    SmoothSettings, only=(*options.COLOURS, *options.ENCODING), changed=options.SPACE_WITHOUT_OKLAB
)
@options.output_format
@_reporting
@options.writing
def noise(source: str, target: str, messages: Messages, **values: Any) -> None:
    """Add noise to the colours of INPUT, and write OUTPUT with nothing else changed: for tests and demonstrations."""
    settings = options.record_from(SmoothSettings, values)
    noise = options.record_from(NoiseSettings, values)
    from beltrami_cli.jobs.noise import noise_file

    report = _written(
        values, (source, target), messages, partial(noise_file, source, target, noise, settings)
    )
    messages.warn_of(source, report.warnings)
    for added in report.added:
        messages.say(
            f"{output_name(target)}: {added.what}, {counted(added.samples, 'sample')}, {noise.kind} noise, "
            f"root mean square change {255 * added.rms:.1f}/255, seed {noise.seed}"
        )
    if not report.added:
        messages.say(f"{output_name(target)}: no noise, so the colours are unchanged")
