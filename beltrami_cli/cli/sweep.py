"""The command `beltrami sweep`."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Any

import click

from beltrami_cli.cli import options
from beltrami_cli.cli.console import Messages, counted
from beltrami_cli.cli.rendering import LOOKS, looking, render_settings_from
from beltrami_cli.flow.parameters import TUNABLE
from beltrami_cli.samples.settings import DEFAULTS

if TYPE_CHECKING:
    from collections.abc import Callable

    from beltrami_cli.samples.settings import SmoothSettings

EPILOG = """\b
Examples:
  beltrami sweep scan.ply sheet.png --beta 4,8,16 -n 2,5,10            nine trials, three by three
  beltrami sweep scan.glb sheet.html -t 1,2.4,4                        a page; click on a view to enlarge it
  beltrami sweep noisy.glb sheet.html --reference clean.glb --beta 5,10,20 -n 3,5   with PSNR and the like
  beltrami sweep photo.jpg sheet.png --metric-steps 1,2,4 --crop auto,0.1 --size 400
  beltrami sweep scan.ply sheet.png --beta 0,10 --space oklab --view left      other options as for smooth and render

\b
Every value is tried with every other. What is not given is as in `beltrami smooth`. Results are drawn and thrown
away: smooth with the parameters that you like best.
"""

_SWEPT: dict[str, type[int] | type[float]] = {
    "beta": float, "t": float, "iterations": int, "metric_scale": float, "metric_steps": int,
}  # fmt: skip
# Of what is not swept, the choice from the data is left open as in `beltrami smooth`.
_UNSWEPT = {name: None if name in TUNABLE else getattr(DEFAULTS.kernel, name) for name in _SWEPT}
_SHOWN = {"iterations": "n", "metric_scale": "metric scale", "metric_steps": "metric steps"}


def _values(kind: type[int] | type[float]) -> Callable[..., tuple[float, ...] | None]:
    def parse(
        context: click.Context, parameter: click.Parameter, text: str | None
    ) -> tuple[float, ...] | None:
        if text is None:
            return None
        try:
            values = tuple(kind(word) for word in text.split(","))
        except ValueError:
            raise click.BadParameter(f"{text!r} is no list of numbers such as 4,8,16") from None
        return tuple(dict.fromkeys(values))

    return parse


@click.command("sweep", epilog=EPILOG)
@click.argument("source", metavar="INPUT")
@click.argument("target", metavar="OUT.png|OUT.html")
@click.option(
    "--reference", metavar="FILE", help="The same without noise: measure how near to it each result is."
)
@options.smoothing
@looking
@options.reading
@options.overwrite
@options.quiet
@options.verbose
def command(
    source: str,
    target: str,
    reference: str | None,
    overwrite: bool,
    quiet: bool,
    verbose: int,
    **given: Any,
) -> None:
    """Smooth INPUT with every combination of parameters, and show all results in one picture or page.

    The first views are the reference, if there is one, and INPUT as it is; the others show their parameters.
    """
    messages = Messages(quiet=quiet, verbose=verbose)
    looks = {name: given.pop(name) for name in LOOKS}
    looks["on"] = "vertices" if given["on"] == "vertices" else "auto"
    looks["slot"] = given["slots"].split(",")[0].strip()
    settings = render_settings_from(looks)
    reading = {name: given.pop(name) for name in ("max_memory", "allow_outside")}
    trials, columns = _trials(given)
    from beltrami_cli.view.sweep import best_of, sweep_file

    with options.reading_from(reading, source) as access, messages.progress() as progress:
        done = sweep_file(
            source, target, trials, settings,
            columns=columns, reference=reference, overwrite=overwrite, progress=progress, access=access,
        )  # fmt: skip
    for trial in done:
        messages.detail(trial.label)
    best = best_of(done)
    messages.say(
        f"{target}: {counted(len(done), 'trial')}" + ("" if best is None else f", best {done[best].label}")
    )


def _trials(given: dict[str, Any]) -> tuple[list[tuple[dict[str, float], SmoothSettings]], int]:
    """Return what is tried, and how many trials belong in a row: the values of the last list that has several."""
    lists = {name: given.pop(name) for name in _SWEPT}
    swept = {name: values for name, values in lists.items() if values is not None}
    trials = []
    for combination in itertools.product(*swept.values()):
        chosen = dict(zip(swept, combination, strict=True))
        settings = options.settings_from({**given, **_UNSWEPT, **chosen})
        trials.append(({_SHOWN.get(name, name): value for name, value in chosen.items()}, settings))
    rows = [len(values) for values in swept.values() if len(values) > 1]
    return trials, max(2, rows[-1] if rows else 2)


for _option in command.params:
    if isinstance(_option, click.Option) and _option.name in _SWEPT:  # takes a list, and not a value
        _option.type, _option.callback, _option.default = click.STRING, _values(_SWEPT[_option.name]), None
        _option.metavar = "A,B,..."
