"""The configuration file in TOML: the search for it, and the values of options in it.

A file that is merely found, and not named, may have come with someone else's archive or repository. So it sets
parameters of the method and of how results are encoded. What reaches a network, runs code, names files to read or
write, or lifts a limit on resources comes from the command line, the environment, or a file that the user names.
"""

from __future__ import annotations

import contextlib
import os
import stat
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import click

from beltrami_cli.cli.console import printable
from beltrami_cli.cli.option_names import (
    long_name,
    option_key,
    options_by_name,
    refuse_unknown_variables,
    values_for,
)
from beltrami_cli.cli.parameter_options import ParameterOption
from beltrami_cli.cli.registry import COMMANDS, command_named, inherited_from_smooth
from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.formats.files.access import unreadable
from beltrami_cli.formats.files.bounded_text import CONFIGURATION, parse_toml, read_bounded, text_in

OWN_NAME, SHARED_NAME = "beltrami.toml", "pyproject.toml"
# The options that are not parameters of a record, but of the method or of encoding. Whatever is not here is refused.
_IGNORED_OPTIONS = frozenset({
    "preset", "output_format", "unwrap", "to", "at", "iteration", "whole", "no_labels",
})  # fmt: skip


@dataclass(frozen=True)
class Configuration:
    path: str | None = None  # None: no file
    is_named: bool = False  # by the user; otherwise it was found
    common: Mapping[str, object] = field(default_factory=dict)  # options for all commands that have them
    tables: Mapping[str, Mapping[str, object]] = field(default_factory=dict)  # options by command


def load(named: str | None) -> Configuration:
    """Read the file that is named, or else the nearest one that is found; see `candidates`."""
    for path in candidates() if named is None else [Path(named)]:
        try:
            table = _table_in(path, read_found(path) if named is None else read_bounded(path, CONFIGURATION))
        except UntrustedError as error:
            if is_for_beltrami(path):
                remedy = f"to have it read, name it: --config {path}"
                click.echo(printable(f"warning: {path} is not read, because {error}; {remedy}"), err=True)
            continue
        except (OSError, ValueError) as error:
            raise unreadable(str(path), error, "repair it, or name another file") from error
        if table is not None:
            tables = {name: value for name, value in table.items() if isinstance(value, dict)}
            common = {name: value for name, value in table.items() if name not in tables}
            return Configuration(str(path) if named is None else named, named is not None, common, tables)
        if named is not None:
            raise InputError(named, "it has no table [tool.beltrami]", "add one, or name another file")
    return Configuration()


def _table_in(path: Path, text: str) -> dict[str, object] | None:
    """Return the table of options in a file; None if it is one of other programs; ValueError if it is not TOML."""
    tree = parse_toml(text)
    tool = tree.get("tool", {})
    if isinstance(tool, dict) and "beltrami" in tool:
        tree = tool["beltrami"]
    elif path.name == SHARED_NAME:
        return None
    if not isinstance(tree, dict):
        raise InputError(str(path), "[tool.beltrami] is not a table", "see beltrami config --help")
    return tree


class UntrustedError(Exception):
    """A file that other users may have written."""


def candidates() -> Iterator[Path]:
    """Yield possible paths of a configuration, nearest first: up to the home folder, a repository root or a border.

    None lies in a folder that must not be looked into; InputError if one cannot be.
    """
    try:
        yield from _candidates(Path.cwd())
    except (PermissionError, FileNotFoundError):  # the working folder was removed
        return
    except OSError as error:
        cause = f"no configuration can be looked for there ({error.strerror})"
        raise InputError(str(error.filename), cause, "check the disk") from error


def _candidates(here: Path) -> Iterator[Path]:
    home, device = None, here.stat().st_dev
    with contextlib.suppress(OSError, RuntimeError):
        home = Path.home().resolve()
    for folder in (here, *here.parents):
        if folder.stat().st_dev != device:
            return
        yield from [path for path in (folder / OWN_NAME, folder / SHARED_NAME) if path.is_file()]
        if folder == home or (folder / ".git").exists():
            return


def read_found(path: Path) -> str:
    """Read a file that only the user or root can have written; UntrustedError otherwise."""
    # No other user can have put a link there either, and the file that is checked is the one that is read.
    _require_own(path.lstat())
    descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
    with os.fdopen(descriptor, "rb") as file:
        _require_own(os.fstat(descriptor))
        return text_in(file, CONFIGURATION)


def is_for_beltrami(path: Path) -> bool:
    """Whether a rejected file may have been meant for this program."""
    if path.name == OWN_NAME:
        return True
    try:
        with path.open("rb") as file:
            return b"beltrami" in file.read(CONFIGURATION)
    except OSError:
        return False


def _require_own(status: os.stat_result) -> None:
    if not hasattr(os, "geteuid"):  # Windows, where owners are others
        return
    if status.st_uid not in (0, os.geteuid()):
        raise UntrustedError("it belongs to another user")
    if not stat.S_ISLNK(status.st_mode) and status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise UntrustedError("others than its owner may write to it (chmod go-w)")


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
