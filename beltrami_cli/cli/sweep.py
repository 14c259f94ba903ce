"""The command `beltrami sweep`."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any, Literal

import click

from beltrami_cli.cli import options
from beltrami_cli.cli.commands import HelpfulCommand
from beltrami_cli.cli.console import Messages, counted
from beltrami_cli.cli.render import render_settings_from, view
from beltrami_cli.fields import Parameter, parameters
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.layers.settings import SmoothSettings
from beltrami_cli.view.settings import RenderSettings

EPILOG = """\b
Examples:
  beltrami sweep scan.ply sheet.png --beta 4,8,16 -n 2,5,10            nine trials, three by three
  beltrami sweep scan.glb sheet.html -t 1,2.4,4                        a page; click on a view to see it next to INPUT
  beltrami sweep noisy.glb sheet.html --reference clean.glb --beta 5,10,20 -n 3,5   with PSNR and the like
  beltrami sweep photo.jpg sheet.png --metric-steps 1,2,4 --crop auto,0.1 --size 400
  beltrami sweep scan.ply figures.csv --format csv --beta 4,8,16       estimated PSNR and gain, and no pictures
  beltrami sweep scan.ply sheet.png --beta 0,10 --space oklab --view left      other options as for smooth and render

\b
Every value is tried with every other, and the default without these values. Other parameters are as in `beltrami
smooth`. Results are drawn and thrown away: smooth with the parameters that you like best.
"""

_SWEPT = ("beta", "t", "iterations", "metric_scale", "metric_steps")
_SHOWN = {"iterations": "n", "metric_scale": "metric scale", "metric_steps": "metric steps"}
# Options of a single picture, or that follow from the options of smoothing.
_NOT_LOOKS = ("slot", "on", "side_by_side", "turntable", "fps", "labels")


def _listed(declared: Parameter) -> Parameter:
    """Return a parameter that takes a list of values, where it took one."""

    def values_in(text: str) -> tuple[float, ...]:
        try:
            values = tuple(declared.kind(word) for word in text.split(","))
        except ValueError:
            raise ValueError(f"is {text!r}, but must be a list of numbers such as 4,8,16") from None
        return tuple(dict.fromkeys(values))

    return replace(
        declared, default=None, several=True, optional=True, unset="one value, as for smooth", metavar="A,B,...",
        parse=values_in,
    )  # fmt: skip


_LISTS = [_listed(each) for each in parameters(KernelParameters) if each.name in _SWEPT]


@click.command("sweep", cls=HelpfulCommand, epilog=EPILOG)
@click.argument("source", metavar="INPUT")
@click.argument("target", metavar="OUT.png|OUT.html|OUT")
@click.option(
    "--reference", metavar="FILE", help="The same without noise: measure how near to it each result is."
)
@click.option(
    "--format", "kind", type=click.Choice(["csv", "json"]),
    help="Write only the parameters and figures, and draw nothing; OUT may be - then.",
)  # fmt: skip
@options.adding(_LISTS[::-1])
@options.options_of(SmoothSettings, without=_SWEPT)
@options.preset
@view
@options.options_of(RenderSettings, without=_NOT_LOOKS)
@options.writing
def command(
    source: str,
    target: str,
    reference: str | None,
    kind: Literal["csv", "json"] | None,
    messages: Messages,
    **given: Any,
) -> None:
    """Smooth INPUT with every combination of parameters, and show all results in one picture or page, or their figures.

    The first views are the reference, if there is one, INPUT as it is, and the default; the others show their
    parameters.
    """
    trials, columns = _trials(given)
    plain = trials[0][1]
    on = "vertices" if plain.on == "vertices" else "auto"
    settings = render_settings_from(given, on=on, slot=plain.textures.slots[0])
    from beltrami_cli.view.sweep import best_of, sweep_file

    with options.job_from(given, source, messages) as job:
        done = sweep_file(
            source, target, trials, settings, columns=columns, reference=reference, kind=kind, job=job
        )
    for trial in done:
        messages.detail(trial.label)
    best = best_of(done)
    shown = "" if best is None else f", best {done[best].label}"
    messages.say(f"{target}: {counted(len(done), 'trial')}{shown}")


def _trials(given: dict[str, Any]) -> tuple[list[tuple[dict[str, float], SmoothSettings]], int]:
    """Return the default and all combinations, and how many belong in a row: the values of the last list of several."""
    swept = {
        each.name: options.parsed(each, given[each.name]) for each in _LISTS if given[each.name] is not None
    }
    swept = {name: swept[name] for name in _SWEPT if name in swept}
    plain = {**given, **dict.fromkeys(_SWEPT)}
    trials: list[tuple[dict[str, float], SmoothSettings]] = [({}, options.settings_from(plain))]
    for combination in itertools.product(*swept.values()) if swept else ():
        chosen = dict(zip(swept, combination, strict=True))
        settings = options.settings_from({**plain, **chosen})
        trials.append(({_SHOWN.get(name, name): value for name, value in chosen.items()}, settings))
    rows = [len(values) for values in swept.values() if len(values) > 1]
    return trials, max(2, rows[-1] if rows else 2)
