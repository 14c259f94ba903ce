"""The command `beltrami info`."""

from __future__ import annotations

import json
from typing import Any

import click

from beltrami_cli.cli import options
from beltrami_cli.cli.commands import HelpfulCommand
from beltrami_cli.cli.console import ALL_THE_SAME, NO_NOISE, choice_in_words, printable

EPILOG = """\b
Examples:
  beltrami info scan.ply
  beltrami info scan.glb --json | jq .noise
  beltrami info scan.obj --json | jq '.textures[].images'    each texture: size, charts, overlap, noise, ...
  beltrami info scan.ply -t 4 --beta 5       how large would kernels be?
"""


@click.command("info", cls=HelpfulCommand, epilog=EPILOG)
@click.argument("source", metavar="FILE")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@options.smoothing
@options.reading
@options.verbose
def command(source: str, as_json: bool, verbose: int, **smoothing: Any) -> None:
    """Show what is coloured in FILE and how, how noisy it is, and what smoothing it would do."""
    settings = options.settings_from(smoothing)
    from beltrami_cli.jobs.inspect import inspect_file

    with options.reading_from(smoothing, source) as access:
        facts = inspect_file(source, settings, access)
    if as_json:
        click.echo(json.dumps(facts, indent=2))
        return
    slots: Any = facts.get("textures", [])
    planned: list[Any] = [facts.get("smooth"), *(slot["smooth"] for slot in slots)]
    for smooth in planned:
        if smooth and settings.kernel.iterations:
            smooth["choice"] = _choice(smooth)
        if smooth and "samples_per_kernel" in smooth:
            smooth["samples_per_kernel"] = _samples(smooth)
    for section, content in facts.items():
        for part in content if isinstance(content, list) and section == "textures" else [content]:
            _print(section, part)


def _print(section: str, part: Any) -> None:
    """Print a section, and what smoothing would do to textures as one of its own."""
    if not part:
        return
    nested = part.get("smooth") if isinstance(part, dict) else None
    if nested is not None:
        part = {key: value for key, value in part.items() if key != "smooth"}
    click.echo("\n".join(map(printable, [section, *_lines(part, section)])))
    if nested is not None:
        _print("smooth", nested)


def _lines(content: Any, section: str) -> list[str]:
    if not isinstance(content, dict):
        return [f"  {_show(entry)}" for entry in content]
    if section == "noise":
        content = {channel: _noise(value) for channel, value in content.items()}
    rows = [row for key, value in content.items() if value not in (None, []) for row in _rows(key, value)]
    width = max((len(label) for label, _ in rows), default=0)
    return [f"  {label:<{width}}  {text}" for label, text in rows]


def _choice(smooth: dict[str, Any]) -> str | None:
    """Say what would be chosen, and by what; None: all is given."""
    if "choice" in smooth:
        return choice_in_words(smooth["choice"])
    return None if smooth["iterations"] else f"nothing to smooth: the noise is {NO_NOISE}; {ALL_THE_SAME}"


def _samples(smooth: dict[str, Any]) -> str:
    """Say of what the samples of a kernel are the mean, since `smooth` gives that over all iterations."""
    others = f" of {smooth['iterations']} iterations; smooth gives the mean over all"
    return f"{smooth['samples_per_kernel']:.5g} in the first{others if smooth['iterations'] > 1 else ' iteration'}"


def _rows(key: str, value: Any) -> list[tuple[str, str]]:
    """Return what stands on the lines of a value: one, or as many as there are records in a list."""
    label = key.replace("_", " ")
    if isinstance(value, list) and value and all(isinstance(entry, dict) for entry in value):
        shown = [_image(entry) if key == "images" else _show(entry) for entry in value]
        return [(label if number == 0 else "", text) for number, text in enumerate(shown)]
    if key == "noise" and isinstance(value, dict):
        value = {channel: _noise(share) for channel, share in value.items()}
    return [(label, _show(value))]


def _image(facts: dict[str, Any]) -> str:
    """Put all about a texture on a line."""
    facts = dict(facts)
    name, width, height = (facts.pop(key) for key in ("name", "width", "height"))
    kind, stored, channels = (facts.pop(key) for key in ("format", "stored", "channels"))
    shown = [f"covered {100 * facts.pop('covered'):.0f} %"]
    shown += [f"{key} {text}" for key, value in facts.items() for _, text in _rows(key, value)]
    return f"{name}: {width} x {height} {kind}, {stored} {' '.join(channels)}; {', '.join(shown)}"


def _noise(share: float) -> str:
    """Write noise as `beltrami noise` takes it."""
    return f"{255 * share:.1f}/255"


def _show(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.5g}"
    if isinstance(value, list):
        return ", ".join(
            f"({_show(entry)})" if isinstance(entry, (list, dict)) else _show(entry) for entry in value
        )
    if isinstance(value, dict):
        return ", ".join(
            f"{key.replace('_', ' ')} {f'({_show(entry)})' if isinstance(entry, dict) else _show(entry)}"
            for key, entry in value.items()
        )
    return str(value)
