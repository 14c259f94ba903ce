"""The settings for each file of a batch: those of the command line, and what a manifest says besides."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from beltrami_cli.batch.item import Item
from beltrami_cli.cli import options
from beltrami_cli.cli.file_options import OF_A_FILE
from beltrami_cli.cli.named_values import options_of, values_for
from beltrami_cli.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from beltrami_cli.batch.plan import Request
    from beltrami_cli.samples.settings import BakeSettings, SmoothSettings

_PATHS = ("height", "positions", "mask", "colours")  # always a file; a guide may be one


def jobs_for(
    requests: Iterable[Request], values: dict[str, Any], *, outside: bool, overwrite: bool
) -> list[Item]:
    """Make the jobs of a batch.

    Parameters
    ----------
    requests : iterable of Request
        The files.
    values : dict
        Values of the options that `options.smoothing` and `options.unwrapping` add, in the current context.
    outside, overwrite : bool
        As for `Item`.

    Raises
    ------
    UsageError
        If a value is out of its range; it says for which file.
    """
    common = options.settings_from(values), options.unwrapping_from(values)
    given = _given(values)
    jobs = []
    for request in requests:
        try:
            settings, unwrap = _settings(request, given) if request.options else common
        except (click.UsageError, UsageError, ValueError) as error:
            cause = error.format_message() if isinstance(error, click.UsageError) else str(error)
            raise UsageError(f"{request.origin}: {cause}") from error
        jobs.append(Item(request.source, request.target, settings, unwrap, outside, overwrite))
    return jobs


def _given(values: dict[str, Any]) -> dict[str, Any]:
    """Return the values that are not defaults, without those that a preset takes the place of."""
    return {name: value for name, value in values.items() if options.is_given(name)}


def _settings(request: Request, given: dict[str, Any]) -> tuple[SmoothSettings, BakeSettings | None]:
    own = values_for(options_of(OF_A_FILE), request.options)
    for name in _PATHS:
        if name in own:
            own[name] = str(request.folder / str(own[name]))
    if "guides" in own:
        own["guides"] = tuple(_guide(request.folder, str(guide)) for guide in own["guides"])
    context = OF_A_FILE.make_context("file", [], default_map={**given, **own})
    for name in own:  # counts for more than what is for all files, also beside a preset
        context.set_parameter_source(name, ParameterSource.COMMANDLINE)
    with context.scope():
        return options.settings_from(context.params), options.unwrapping_from(context.params)


def _guide(folder: Path, guide: str) -> str:
    return str(folder / guide) if (folder / guide).is_file() else guide
