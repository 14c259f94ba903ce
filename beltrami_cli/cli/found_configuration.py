"""Configuration files that are merely found, and not named: where they are looked for, whose count, what they may set.

Such a file may have come with an archive or a repository of somebody else. So it sets parameters of the method and of
how results are encoded. What reaches a network, runs code, names files to read or write, or lifts a limit on resources
comes from the command line, the environment, or a file that the user names.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import TYPE_CHECKING

from beltrami_cli.cli.options import ParameterOption

if TYPE_CHECKING:
    from collections.abc import Iterator

    import click

OWN_NAME, SHARED_NAME = "beltrami.toml", "pyproject.toml"

# The options that are no parameters of a record, but of the method or of encoding. Whatever is not here is refused.
_HARMLESS = frozenset({
    "preset", "output_format", "unwrap", "to", "at", "iteration", "whole", "view", "no_labels",
})  # fmt: skip

_LONGEST = 1 << 20  # bytes in which the name of this program is looked for


class UntrustedError(Exception):
    """A file that others than the user can have written."""


def may_be_found(option: click.Parameter) -> bool:
    """Whether a file that was only found may set an option: not one that names a file or lifts a limit."""
    if isinstance(option, ParameterOption):
        return not option.declared.is_deliberate
    return option.name in _HARMLESS


def candidates(here: Path) -> Iterator[Path]:
    """Give the places of a configuration, nearest first: up to the home folder, a repository's root or a border."""
    home, device = _home(), here.stat().st_dev
    for folder in (here, *here.parents):
        if folder.stat().st_dev != device:
            return
        yield from (path for path in (folder / OWN_NAME, folder / SHARED_NAME) if path.is_file())
        if folder == home or (folder / ".git").exists():
            return


def read_found(path: Path) -> bytes:
    """Read a file that only the user or root can have written; UntrustedError otherwise."""
    # Nobody else can have put a link there either, and what is looked at is what is read.
    _require_own(path.lstat())
    descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
    with os.fdopen(descriptor, "rb") as file:
        _require_own(os.fstat(descriptor))
        return file.read()


def mentions_us(path: Path) -> bool:
    """Whether a file that is not read may have been meant for this program."""
    if path.name == OWN_NAME:
        return True
    try:
        with path.open("rb") as file:
            return b"beltrami" in file.read(_LONGEST)
    except OSError:
        return False


def _require_own(status: os.stat_result) -> None:
    if not hasattr(os, "geteuid"):  # Windows, where owners are others
        return
    if status.st_uid not in (0, os.geteuid()):
        raise UntrustedError("it belongs to another user")
    if not stat.S_ISLNK(status.st_mode) and status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise UntrustedError("others than its owner may write to it (chmod go-w)")


def _home() -> Path | None:
    try:
        return Path.home().resolve()
    except (OSError, RuntimeError):
        return None
