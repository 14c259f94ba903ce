"""Values of options that stand in files, under the names that the options have on the command line."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from collections.abc import Mapping


def options_of(command: click.Command) -> dict[str, click.Option]:
    """Return the options of a command by all their names, without dashes in front and with _ for those within."""
    found: dict[str, click.Option] = {}
    for option in command.params:
        if isinstance(option, click.Option) and option.name and not option.is_eager:
            for name in (*option.opts, option.name):
                found[plain(name)] = option
    return found


def plain(name: str) -> str:
    """Return the name of an option without dashes."""
    return name.lstrip("-").replace("-", "_")


def values_for(options: Mapping[str, click.Option], table: Mapping[str, object]) -> dict[str, Any]:
    """Return values for a default map, by the names that click has for the options.

    Raises
    ------
    ValueError
        If there is no such option, or a value can be none of it.
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
