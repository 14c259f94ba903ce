"""The commands that show colours: `beltrami render`, `sweep`, `report` and `view`."""

from __future__ import annotations

import atexit
import itertools
import os
import shlex
import sys
from dataclasses import replace
from typing import Any, Literal

import click

from beltrami_cli.cli import options
from beltrami_cli.cli.commands import command, complete_files
from beltrami_cli.cli.console import Messages, counted, output_name
from beltrami_cli.errors import UsageError
from beltrami_cli.fields import Parameter, parameters
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.jobs.job import Job
from beltrami_cli.layers.settings import SmoothSettings
from beltrami_cli.view.settings import RenderSettings


@command("render", sources="FILE...", target="OUT.png")
@options.options_of(RenderSettings)
@click.option("--no-labels", is_flag=True, help="No words in the picture.")
@options.writing
def render(sources: tuple[str, ...], target: str, no_labels: bool, messages: Messages, **values: Any) -> None:
    """Draw each FILE, a model, points or an image, and write all as one picture."""
    if values["labels"] and no_labels:
        raise UsageError("--label and --no-labels contradict each other")
    settings = options.record_from(RenderSettings, values, **({"labels": ()} if no_labels else {}))
    from beltrami_cli.view.render import render_file

    with options.job_from(values, sources[0], messages) as job:
        width, height = render_file(sources, target, settings, job)
    messages.say(f"{output_name(target)}: {width} x {height} pixels")


_SWEPT = ("beta", "t", "iterations", "metric_scale", "metric_steps")
_LABELS = {"iterations": "n", "metric_scale": "metric scale", "metric_steps": "metric steps"}
# Options of a single picture, or that follow from the options of smoothing.
_NOT_APPEARANCE = ("slot", "on", "side_by_side", "labels")


def _listed(declared: Parameter) -> Parameter:
    """Return a parameter that takes a list of values instead of one."""
    numbers = "whole numbers" if declared.kind is int else "numbers"

    def values_in(text: str) -> tuple[float, ...]:
        try:
            values = tuple(declared.kind(word) for word in text.split(","))
        except ValueError:
            raise ValueError(f"is {text!r}, but must be a list of {numbers} such as 4,8,16") from None
        return tuple(dict.fromkeys(values))

    return replace(
        declared, default=None, several=True, optional=True, unset="one value, as for smooth", metavar="A,B,...",
        parse=values_in,
    )  # fmt: skip


_LISTS = [_listed(each) for each in parameters(KernelParameters) if each.name in _SWEPT]


@command("sweep", source="INPUT", target="OUT.png|OUT.html|OUT")
@click.option(
    "--reference",
    metavar="FILE",
    shell_complete=complete_files,
    help="The same without noise: measure how near to it each result is.",
)
@click.option(
    "--format", "kind", type=click.Choice(["csv", "json"]),
    help="Write only the parameters and figures, and draw nothing; OUT may be - then.",
)  # fmt: skip
@options.adding(_LISTS[::-1])
@options.options_of(SmoothSettings, without=_SWEPT)
@options.preset
@options.options_of(RenderSettings, without=_NOT_APPEARANCE)
@options.writing
def sweep(
    source: str,
    target: str,
    reference: str | None,
    kind: Literal["csv", "json"] | None,
    messages: Messages,
    **given: Any,
) -> None:
    """Smooth INPUT with every combination of parameters, and show all results in a picture or page, or as figures."""
    trials, columns = _trials(given)
    if kind is not None:
        options.refuse_typed(RenderSettings, f"of pictures, and --format {kind} draws none; leave it out")
    plain = trials[0][1]
    on = "vertices" if plain.on == "vertices" else "auto"
    settings = options.record_from(RenderSettings, given, on=on, slot=plain.textures.slots[0])
    from beltrami_cli.view.sweep import best_of, sweep_file

    with options.job_from(given, source, messages) as job:
        done = sweep_file(
            source, target, trials, settings, columns=columns, reference=reference, kind=kind, job=job
        )
    for trial in done:
        messages.detail(trial.label)
    best = best_of(done)
    shown = "" if best is None else f", best {done[best].label}"
    messages.say(f"{output_name(target)}: {counted(len(done), 'trial')}{shown}")


def _trials(given: dict[str, Any]) -> tuple[list[tuple[dict[str, float], SmoothSettings]], int]:
    """Return the default and all combinations, and how many belong in a row: the values of the last list of several."""
    swept = {
        each.name: options.parsed(each, given[each.name]) for each in _LISTS if given[each.name] is not None
    }
    swept = {name: swept[name] for name in _SWEPT if name in swept}
    plain = {**given, **dict.fromkeys(_SWEPT)}
    trials: list[tuple[dict[str, float], SmoothSettings]] = [({}, options.settings_from(plain))]
    if not swept:
        flags = ", ".join(each.flag for each in _LISTS)
        raise UsageError(f"nothing is varied; give several values, such as --beta 4,8,16, of one of {flags}")
    for combination in itertools.product(*swept.values()):
        chosen = dict(zip(swept, combination, strict=True))
        settings = options.settings_from({**plain, **chosen})
        trials.append(({_LABELS.get(name, name): value for name, value in chosen.items()}, settings))
    rows = [len(values) for values in swept.values() if len(values) > 1]
    return trials, max(2, rows[-1] if rows else 2)


@command("report", before="BEFORE", after="AFTER", target="OUT.html")
@click.option(
    "--parameters", metavar="FILE.json", shell_complete=complete_files,
    help="Also show the parameters, from what `beltrami smooth --report` wrote.",
)  # fmt: skip
@click.option(
    "--full-size", is_flag=True,
    help="Keep pictures at full size, to zoom as far as single texels, however large the page becomes.  "
    "[default: at most 8 MB]",
)  # fmt: skip
@options.options_of(SmoothSettings, only=("on", "slots", "space"), changed=options.COMPARED)
@options.writing
def report(
    before: str,
    after: str,
    target: str,
    parameters: str | None,
    full_size: bool,
    messages: Messages,
    **values: Any,
) -> None:
    """Write a page that shows what changed from BEFORE to AFTER, two models or images that differ in colours only."""
    from beltrami_cli.view.report import report_file

    settings = options.compared_from(values)
    with options.job_from(values, before, messages) as job:
        found = report_file(
            before, after, target, settings, parameters=parameters, full_size=full_size, job=job
        )
    for notice in found["notices"]:
        messages.warn(notice)
    messages.say(f"{output_name(target)}: {counted(found['samples'], 'sample')}, {_result(found)}")


def _result(found: dict[str, Any]) -> str:
    if not found["samples"]:
        return "so no colours are compared"
    if found["psnr"] is None:
        return "whose colours are equal" if found["notices"] else "nothing differs"
    return f"{found['psnr']:.2f} dB from one to the other"


@command("view", source="MODEL")
@click.option("--no-open", is_flag=True, help="Print the address of the page, and open no browser.")
@options.smoothing
@options.reading
@options.messages
def view(source: str, no_open: bool, messages: Messages, **smoothing: Any) -> None:
    """Show MODEL in the browser, and smooth it there while parameters are changed."""
    settings = options.settings_from(smoothing)
    from beltrami_cli.view.live import Live
    from beltrami_cli.view.server import PageServer

    def typed(settings: SmoothSettings, target: str) -> str:
        words = options.words_of(settings, smoothing["preset"])
        words += ["--allow-outside"] if smoothing["allow_outside"] else []
        columns = smoothing["columns"]
        words += ["--columns", columns] if columns else []
        words += ["--max-memory", smoothing["max_memory"]] if smoothing["max_memory"] else []
        return shlex.join(["beltrami", "smooth", source, target, *words])

    with options.reading_from(smoothing, source) as access:
        live = Live(source, settings, Job(access), typed)
        try:
            server = PageServer(live.files, live.answer)
            messages.say(f"{source}: shown at {server.address} until the page is closed, or Ctrl-C")
            if not no_open:
                import webbrowser

                webbrowser.open(server.first_address)
            server.run()
        finally:
            if not live.close():  # threads of the core would make Python abort as it ends
                error = sys.exc_info()[1]
                atexit.register(os._exit, 0 if error is None else getattr(error, "exit_code", 1))
