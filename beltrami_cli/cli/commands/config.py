"""The command `beltrami config`."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator

import click
from click.core import ParameterSource

from beltrami_cli.cli.command import command
from beltrami_cli.cli.configuration import Configuration, configured_values
from beltrami_cli.cli.console import printable
from beltrami_cli.cli.option_names import long_name, variable_in_force
from beltrami_cli.cli.registry import COMMANDS, command_named


@command("config", name="[COMMAND]")
@click.pass_context
def config(context: click.Context, name: str | None) -> None:
    """Show the options in force, and where each comes from: a file, the environment, or the default."""
    group = context.parent
    assert group is not None
    if name is not None and name not in COMMANDS:
        raise click.UsageError(f"there is no command {name}; there are {', '.join(COMMANDS)}")
    configuration: Configuration = group.obj
    names = COMMANDS if name is None else [name]
    group.default_map = {each: configured_values(configuration, each) for each in names}
    click.echo(f"# configuration file: {printable(configuration.path or 'none')}")
    is_whole = name is not None
    tables = {each: "\n".join(_lines(group, each, configuration, with_defaults=is_whole)) for each in names}
    shown = [f"[{each}]\n{lines}" for each, lines in tables.items() if lines]
    click.echo("\n".join(shown or ["# every option has its default"]))


def _lines(
    group: click.Context, name: str, configuration: Configuration, *, with_defaults: bool
) -> Iterator[str]:
    context = _all_values(group, name)
    for option in context.command.params:
        if option.name is None or option.is_eager:
            continue
        source = context.get_parameter_source(option.name)
        value = context.params[option.name]
        assignment = f"{long_name(option)} = {json.dumps(value)}"  # TOML writes these values as JSON does
        if source is ParameterSource.ENVIRONMENT:
            yield f"{assignment}  # {variable_in_force(option)}"
        elif source is ParameterSource.DEFAULT_MAP:
            yield f"{assignment}  # {printable(configuration.path or '')}"
        elif with_defaults and value is None:
            yield f"# {long_name(option)} is not given"
        elif with_defaults:
            yield f"# {assignment}"


def _all_values(group: click.Context, name: str) -> click.Context:
    """Let click find the values of all options of a command, and require none."""
    optional: list[click.Parameter] = []
    for parameter in command_named(name).params:
        if isinstance(parameter, click.Option):
            wanted = copy.copy(parameter)
            wanted.required = False
            optional.append(wanted)
    return click.Command(name, params=optional).make_context(name, [], parent=group)
