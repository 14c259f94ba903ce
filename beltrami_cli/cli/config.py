"""The command `beltrami config`."""

from __future__ import annotations

import copy
import json
from typing import TYPE_CHECKING

import click
from click.core import ParameterSource

from beltrami_cli.cli.commands import HelpfulCommand, long_name, variable_in_force
from beltrami_cli.cli.console import printable

if TYPE_CHECKING:
    from collections.abc import Iterator

    from beltrami_cli.cli.configuration import Configuration

EPILOG = """\b
Examples:
  beltrami config                  all that is not as it is by default
  beltrami config smooth           every option of smooth
  beltrami --config other.toml config
  BELTRAMI_SMOOTH_BETA=8 beltrami config smooth

\b
What counts, first to last:
  1. options on the command line
  2. variables of the environment: BELTRAMI_, the command, the option in capitals with _ for -, such as
     BELTRAMI_SMOOTH_BETA=8; flags are 1 or 0, options that may be repeated have spaces between values
  3. the file that --config or BELTRAMI_CONFIG names; or else beltrami.toml, or pyproject.toml with
     [tool.beltrami], in the working folder or the nearest one above it, up to the home folder, the
     root of a repository (.git) or the border of a file system
  4. the defaults

\b
A file that was only found sets parameters of the method and of how results are encoded. Options that
name files or a scheduler, allow something or lift a limit (--report, --overwrite, --out-dir ...) are
refused in it. It is not read if it, or a link to it, belongs to somebody else than you and root, or
if others may write to it.

\b
beltrami.toml (in pyproject.toml the tables are [tool.beltrami] and [tool.beltrami.smooth]):
  threads = 4          # for all commands that have the option
  [smooth]             # for smooth; batch takes what bears on a file from here, too
  beta = 8
  channels = ["red", "green"]
"""


@click.command("config", cls=HelpfulCommand, epilog=EPILOG)
@click.argument("name", metavar="[COMMAND]", required=False)
@click.pass_context
def command(context: click.Context, name: str | None) -> None:
    """Show the options in force, and where each comes from: a file, the environment, or the default.

    The output is TOML for beltrami.toml; defaults are comments in it.
    """
    from beltrami_cli.cli.main import COMMANDS, defaults_from

    group = context.parent
    if group is None or (name is not None and name not in COMMANDS):
        raise click.UsageError(f"there is no command {name}; there are {', '.join(COMMANDS)}")
    configuration: Configuration = group.obj
    names = list(COMMANDS) if name is None else [name]
    group.default_map = {each: defaults_from(configuration, each) for each in names}
    click.echo(f"# {printable(configuration.path or 'no file')} and the environment")
    for each in names:
        lines = list(_lines(group, each, configuration, with_defaults=name is not None))
        if lines:
            click.echo("\n".join([f"[{each}]", *lines]))


def _lines(
    group: click.Context, name: str, configuration: Configuration, *, with_defaults: bool
) -> Iterator[str]:
    context = _parsed(group, name)
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


def _parsed(group: click.Context, name: str) -> click.Context:
    """Let click find the values of all options of a command, none of which it must have."""
    from beltrami_cli.cli.main import group as commands

    found = commands.get_command(group, name)
    optional: list[click.Parameter] = []
    for parameter in found.params if found is not None else ():
        if isinstance(parameter, click.Option):
            wanted = copy.copy(parameter)
            wanted.required = False
            optional.append(wanted)
    return click.Command(name, params=optional).make_context(name, [], parent=group)
