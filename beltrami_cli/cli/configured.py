"""Values of options from the configuration file.

A file that is merely found, and not named, may have come with someone else's archive or repository. So it sets
parameters of the method and of how results are encoded. What reaches a network, runs code, names files to read or
write, or lifts a limit on resources comes from the command line, the environment, or a file that the user names.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import click

from beltrami_cli.cli.configuration import Configuration
from beltrami_cli.cli.option_names import (
    long_name,
    option_key,
    options_by_name,
    refuse_unknown_variables,
    values_for,
)
from beltrami_cli.cli.parameter_options import ParameterOption
from beltrami_cli.cli.registry import COMMANDS, command_named, inherited_from_smooth
from beltrami_cli.errors import UsageError

# The options that are not parameters of a record, but of the method or of encoding. Whatever is not here is refused.
_IGNORED_OPTIONS = frozenset({
    "preset", "output_format", "unwrap", "to", "at", "iteration", "whole", "no_labels",
})  # fmt: skip


def configured_values(configuration: Configuration, name: str) -> dict[str, Any]:
    """Return the values of a command's options; batches also obey the table and the variables of `smooth`."""
    inherited = inherited_from_smooth(name)
    for each in [name, "smooth"] if inherited else [name]:
        refuse_unknown_variables(command_named(each), each)
    if configuration.path is None:
        return {}
    try:
        for table in set(configuration.tables) - set(COMMANDS):
            raise ValueError(f"there is no command {table}")
        known = options_by_name(command_named(name))
        values = values_for(known, _common_values(configuration, known))
        if inherited:
            shared = values_for(
                options_by_name(command_named("smooth")), configuration.tables.get("smooth", {})
            )
            values |= {key: value for key, value in shared.items() if key in inherited}
        values |= values_for(known, configuration.tables.get(name, {}))
        _check(configuration, command_named(name), values)
    except ValueError as error:
        raise UsageError(f"{configuration.path}: {error}; see beltrami config --help") from error
    return values


def _common_values(configuration: Configuration, known: Mapping[str, click.Option]) -> dict[str, object]:
    """Return the values outside of tables that are for a command; ValueError if one is for no command at all."""
    common = {key: value for key, value in configuration.common.items() if option_key(key) in known}
    for key in set(configuration.common) - set(common):
        if not any(option_key(key) in options_by_name(command_named(each)) for each in COMMANDS):
            raise ValueError(f"{key} is not an option of any command")
    return common


def _check(configuration: Configuration, command: click.Command, values: Mapping[str, object]) -> None:
    """Raise ValueError if a value does not fit its option, or may not be set by such a file."""
    context = click.Context(command)
    for option in command.params:
        if option.name not in values:
            continue
        if not configuration.is_named and not may_be_found(option, values[option.name]):
            raise ValueError(
                f"{long_name(option)} may not be set by a file that was only found, since it is not a parameter of the "
                f"method; give it on the command line, or name the file: --config {configuration.path}"
            )
        try:
            option.type_cast_value(context, values[option.name])
        except click.BadParameter as error:
            raise ValueError(f"{long_name(option)}: {error.message.rstrip('.')}") from error
        except UsageError as error:
            raise ValueError(str(error)) from error


def may_be_found(option: click.Parameter, value: object = None) -> bool:
    """Whether a discovered file may set an option: not one that names a file or lifts a limit."""
    if isinstance(option, ParameterOption):
        return not option.declared.is_deliberate(value)
    return option.name in _IGNORED_OPTIONS
