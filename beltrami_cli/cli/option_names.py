"""Options by name: as they are typed, in configuration files, and as environment variables."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping
from difflib import get_close_matches
from typing import Any

import click
from click.core import ParameterSource

from beltrami_cli.errors import UsageError

_PREFIX = "BELTRAMI"


def long_name(option: click.Parameter) -> str:
    return next((text for text in option.opts if text.startswith("--")), option.opts[0]).lstrip("-")


def option_key(name: str) -> str:
    return british_spelling(name).lstrip("-").replace("-", "_")


def british_spelling(name: str) -> str:
    """Return the documented spelling of an option; the American one of colour is accepted everywhere."""
    return name.replace("color", "colour")


def options_by_name(command: click.Command) -> dict[str, click.Option]:
    """Return the options of a command by all their names, without dashes in front and with _ for those within."""
    return {
        option_key(name): option
        for option in command.params
        if isinstance(option, click.Option) and option.name and not option.is_eager
        for name in (*option.opts, option.name)
    }


def values_for(options: Mapping[str, click.Option], table: Mapping[str, object]) -> dict[str, Any]:
    """Return values for a default map, by click's names of options; ValueError if one is invalid."""
    values: dict[str, Any] = {}
    for name, value in table.items():
        option = options.get(option_key(name))
        if option is None or option.name is None:
            raise ValueError(f"{name} is not an option of this command")
        if option.name in values:
            raise ValueError(f"{name} is given twice, under two names")
        values[option.name] = _value(option, name, value)
    return values


def _value(option: click.Option, name: str, value: object) -> object:
    if isinstance(value, dict) or (isinstance(value, bool) and not option.is_flag):
        raise ValueError(f"{name} can be no {'table' if isinstance(value, dict) else 'truth value'}")
    if option.multiple:
        return tuple(_scalar(option, each) for each in (value if isinstance(value, list) else [value]))
    if isinstance(value, list):  # options that take a list take it with commas
        return ",".join(str(each) for each in value)
    return _scalar(option, value)


def _scalar(option: click.Option, value: object) -> object:
    """Return a value as click can convert it, or refuse it: numbers of flags, dates and the like as text."""
    if isinstance(value, bool | str):
        return value
    # Options of whole numbers refuse the text of others, and would cut off the number itself.
    is_whole = isinstance(value, int) or (isinstance(value, float) and value.is_integer())
    return value if is_whole and not option.is_flag else str(value)


def with_variables(command: click.Command, name: str, shared: Collection[str]) -> click.Command:
    """Set the environment variables of all options; `shared` options also obey the variables of `smooth`.

    The click library could do that alone, but would name them after arguments of functions, not after options.
    """
    for option in command.params:
        if isinstance(option, click.Option) and not option.is_eager:
            commands, own = [name, "smooth"] if option.name in shared else [name], long_name(option)
            variables = [f"{_PREFIX}_{each}_{own}".upper().replace("-", "_") for each in commands]
            others = [each.replace("COLOUR", "COLOR") for each in variables if "COLOUR" in each]
            option.envvar = [*variables, *others]
    return command


def refuse_unknown_variables(command: click.Command, name: str) -> None:
    """Raise UsageError if a variable of a command belongs to none of its options."""
    prefix = f"{_PREFIX}_{name}_".upper().replace("-", "_")
    known = [each.removeprefix(prefix) for option in command.params for each in option.envvar or ()]
    for variable in sorted(os.environ):
        if variable.startswith(prefix) and variable.removeprefix(prefix) not in known:
            similar = get_close_matches(variable.removeprefix(prefix), known, 1)
            remedy = (
                f"did you mean {prefix}{similar[0]}?"
                if similar
                else f"beltrami config {name} shows all options"
            )
            raise UsageError(f"the variable {variable} belongs to no option of {name}; {remedy}")


def variable_in_force(option: click.Parameter) -> str:
    names = [option.envvar] if isinstance(option.envvar, str) else option.envvar or []
    return next((name for name in names if os.environ.get(name)), "")


def variable_behind(option: click.Parameter | None, context: click.Context | None) -> str:
    """Return the environment variable that the value of an option comes from, if any."""
    if option is None or context is None:
        return ""
    source = context.get_parameter_source(str(option.name))
    return variable_in_force(option) if source is ParameterSource.ENVIRONMENT else ""
