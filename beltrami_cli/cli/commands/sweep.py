"""The command `beltrami sweep`."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any, Literal

import click

from beltrami_cli.cli import options
from beltrami_cli.cli.command import command, complete_files
from beltrami_cli.cli.console import Messages
from beltrami_cli.cli.parameter_options import adding, options_of, parsed, record_from, refuse_typed
from beltrami_cli.cli.phrases import counted, output_name
from beltrami_cli.errors import UsageError
from beltrami_cli.fields import Parameter, parameters
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.layers.settings import SmoothSettings
from beltrami_cli.view.settings import RenderSettings, parts_shown

_SWEPT = ("beta", "t", "iterations", "metric_scale", "metric_steps")
_LABELS = {"iterations": "n", "metric_scale": "metric scale", "metric_steps": "metric steps"}
# Options of a single picture, or that follow from the options of smoothing.
_NOT_APPEARANCE = ("slot", "on", "side_by_side", "labels")


def _listed(declared: Parameter) -> Parameter:
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
@adding(_LISTS[::-1])
@options_of(SmoothSettings, without=_SWEPT)
@options.preset
@options_of(RenderSettings, without=_NOT_APPEARANCE)
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
        refuse_typed(RenderSettings, f"of pictures, and --format {kind} draws none; leave it out")
    settings = record_from(RenderSettings, given, **parts_shown(trials[0][1]))
    from beltrami_cli.view.sheet import best_of
    from beltrami_cli.view.sweep import sweep_file

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
    swept = {each.name: parsed(each, given[each.name]) for each in _LISTS if given[each.name] is not None}
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
