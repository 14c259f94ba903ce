"""Variables of the environment that give options their values."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import click
from click.core import ParameterSource

if TYPE_CHECKING:
    from collections.abc import Collection

_PREFIX = "BELTRAMI"


def long_name(option: click.Parameter) -> str:
    """Return the name of an option that people know, without dashes in front."""
    return next((text for text in option.opts if text.startswith("--")), option.opts[0]).lstrip("-")


def with_variables(
    command: click.Command, name: str, other: str = "", shared: Collection[str] = ()
) -> click.Command:
    """Give every option of a command its variable.

    The click library could do that alone, but would name them after arguments of functions, not after options.

    Parameters
    ----------
    command : click.Command
        The command.
    name : str
        Its name.
    other : str
        Another command, whose variables count as well where there is none of this one.
    shared : collection of str
        For which options they do, by the names that click has for them.
    """
    for option in command.params:
        if isinstance(option, click.Option) and not option.is_eager:
            commands = [name, other] if option.name in shared else [name]
            option.envvar = [
                "_".join((_PREFIX, each, long_name(option))).upper().replace("-", "_") for each in commands
            ]
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
