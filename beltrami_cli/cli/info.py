"""The command `beltrami info`."""

from __future__ import annotations

import json
from typing import Any

import click

from beltrami_cli.cli import options
from beltrami_cli.cli.console import printable

EPILOG = """\b
Examples:
  beltrami info scan.ply
  beltrami info scan.glb --json | jq .noise
  beltrami info scan.obj --json | jq '.textures[].images'    each texture: size, charts, overlap, noise, ...
  beltrami info scan.ply -t 4 --beta 5       how large would kernels be?
"""


@click.command("info", epilog=EPILOG)
@click.argument("source", metavar="FILE")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@options.smoothing
@options.reading
@options.verbose
def command(source: str, as_json: bool, verbose: int, **smoothing: Any) -> None:
    """Show what is coloured in FILE and how, how noisy it is, and what smoothing it would do."""
    settings = options.settings_from(smoothing)
    from beltrami_cli.pipeline.inspect import inspect_file

    with options.reading_from(smoothing, source) as access:
        facts = inspect_file(source, settings, access)
    if as_json:
        click.echo(json.dumps(facts, indent=2))
        return
    for section, content in facts.items():
        for part in content if isinstance(content, list) and section == "textures" else [content]:
            if part:
                click.echo("\n".join(map(printable, [section, *_lines(part)])))


def _lines(content: Any) -> list[str]:
    if isinstance(content, dict):
        width = max(map(len, content))
        return [
            f"  {label:<{width}}  {text}"
            for key, value in content.items()
            for label, text in _rows(key, value)
        ]
    return [f"  {_show(entry)}" for entry in content]


def _rows(key: str, value: Any) -> list[tuple[str, str]]:
    """Return what stands on the lines of a value: one, or as many as there are records in a list."""
    label = key.replace("_", " ")
    if isinstance(value, list) and value and all(isinstance(entry, dict) for entry in value):
        return [(label if number == 0 else "", _show(entry)) for number, entry in enumerate(value)]
    return [(label, _show(value))]


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
