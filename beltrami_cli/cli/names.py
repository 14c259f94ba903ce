"""Names of options: as they are typed, in files, and as variables of the environment; and values under these names."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

_PREFIX = "BELTRAMI"


def long_name(option: click.Parameter) -> str:
    """Return the name of an option that people know, without dashes in front."""
    return next((text for text in option.opts if text.startswith("--")), option.opts[0]).lstrip("-")


def plain(name: str) -> str:
    """Return the name of an option without dashes."""
    return spelled(name).lstrip("-").replace("-", "_")


def spelled(name: str) -> str:
    """Return the documented spelling of an option; the American one of colour is accepted everywhere."""
    return name.replace("color", "colour")


def options_by_name(command: click.Command) -> dict[str, click.Option]:
    """Return the options of a command by all their names, without dashes in front and with _ for those within."""
    found: dict[str, click.Option] = {}
    for option in command.params:
        if isinstance(option, click.Option) and option.name and not option.is_eager:
            for name in (*option.opts, option.name):
                found[plain(name)] = option
    return found


def values_for(options: Mapping[str, click.Option], table: Mapping[str, object]) -> dict[str, Any]:
    """Return values for a default map, by the names that click has for the options.

    ValueError if there is no such option, or it cannot have the value.
    """
    values: dict[str, Any] = {}
    for name, value in table.items():
        option = options.get(plain(name))
        if option is None or option.name is None:
            raise ValueError(f"{name} is no option there")
        if option.name in values:
            raise ValueError(f"{name} is given twice, under two names")
        values[option.name] = _value(option, name, value)
    return values


def _value(option: click.Option, name: str, value: object) -> object:
    if isinstance(value, dict) or (isinstance(value, bool) and not option.is_flag):
        raise ValueError(f"{name} can be no {'table' if isinstance(value, dict) else 'truth value'}")
    if option.multiple:
        return tuple(value) if isinstance(value, list) else (value,)
    if isinstance(value, list):  # options that take a list take it with commas
        return ",".join(str(each) for each in value)
    return value


def with_variables(
    command: click.Command, name: str, other: str = "", shared: Collection[str] = ()
) -> click.Command:
    """Give every option of a command its variable; for `shared` options those of another command count as well.

    The click library could do that alone, but would name them after arguments of functions, not after options.
    """
    for option in command.params:
        if isinstance(option, click.Option) and not option.is_eager:
            commands = [name, other] if option.name in shared else [name]
            variables = [
                "_".join((_PREFIX, each, long_name(option))).upper().replace("-", "_") for each in commands
            ]
            others = [each.replace("COLOUR", "COLOR") for each in variables if "COLOUR" in each]
            option.envvar = [*variables, *others]
    return command


def variable_in_force(option: click.Parameter) -> str:
    """Return which of an option's variables is set."""
    names = [option.envvar] if isinstance(option.envvar, str) else option.envvar or []
    return next((name for name in names if os.environ.get(name)), "")


def blamed_variable(error: click.ClickException) -> str:
    """Return which variable a bad value comes from, if it comes from one."""
    if not isinstance(error, click.BadParameter) or error.param is None or error.ctx is None:
        return ""
    source = error.ctx.get_parameter_source(str(error.param.name))
    return variable_in_force(error.param) if source is ParameterSource.ENVIRONMENT else ""
