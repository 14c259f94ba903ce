"""The command `beltrami view`."""

from __future__ import annotations

import atexit
import os
import shlex
import sys
from typing import Any

import click

from beltrami_cli.cli import options
from beltrami_cli.cli.command import command
from beltrami_cli.cli.console import Messages
from beltrami_cli.cli.parameter_options import record_from
from beltrami_cli.fields import Parameter, parameters, parts
from beltrami_cli.flow.parameters import PRESETS
from beltrami_cli.formats.files.access import Access
from beltrami_cli.jobs.job import Job
from beltrami_cli.layers.settings import SmoothSettings, given_values


@command("view", source="MODEL")
@click.option("--no-open", is_flag=True, help="Print the address of the page, and open no browser.")
@options.smoothing
@options.reading
@options.messages
def view(source: str, no_open: bool, messages: Messages, **smoothing: Any) -> None:
    """Show MODEL in the browser, and smooth it there while parameters are changed."""
    settings = options.settings_from(smoothing)
    from beltrami_cli.view.live.live import Live
    from beltrami_cli.view.live.server import PageServer

    def typed(settings: SmoothSettings, target: str) -> str:
        words = [*words_of(settings, smoothing["preset"]), *_words_on(record_from(Access, smoothing))]
        return shlex.join(["beltrami", "smooth", source, target, *words])

    with options.reading_from(smoothing, source) as access:
        live = Live(source, settings, Job(access), typed)
        try:
            server = PageServer(live.files, live.answer)
            messages.say(f"{source}: shown at {server.address} until the page is closed, or Ctrl-C")
            if not no_open:
                import webbrowser

                webbrowser.open(server.first_address)
            server.run()
        finally:
            if not live.close():  # threads of the core would make Python abort as it ends
                error = sys.exc_info()[1]
                atexit.register(os._exit, 0 if error is None else getattr(error, "exit_code", 1))


def words_of(settings: SmoothSettings, preset: str | None = None) -> list[str]:
    """Return the options that `settings_from` makes such settings of, as they are typed."""
    usual: dict[str, Any] = dict(PRESETS[preset]) if preset else {}
    words, given = ["--preset", preset] if preset else [], given_values(settings)
    for record in (settings, *(getattr(settings, name) for name in parts(settings))):
        for declared in parameters(record):
            value, default = getattr(record, declared.name), usual.get(declared.name, declared.default)
            is_given = value != default if preset else declared.name in given
            if is_given and declared.flags:
                words += _typed(declared, value)
    return words


def _words_on(access: Access) -> list[str]:
    """Return the options that `reading_from` makes an access of."""
    values = ((declared, getattr(access, declared.name)) for declared in parameters(access))
    return [
        word for declared, value in values if value != declared.default for word in _typed(declared, value)
    ]


def _typed(declared: Parameter, value: Any) -> list[str]:
    flag = declared.flags[0].partition("/")[0]
    if declared.kind is bool:
        return [flag]
    if declared.repeatable:
        return [word for each in value for word in (flag, _in_short(each))]
    if declared.several:
        return [flag, ",".join(map(_in_short, value)) or "none"]
    return [flag, _in_short(value) if declared.parse is None else declared.show(value)]


def _in_short(value: Any) -> str:
    return str(int(value)) if isinstance(value, float) and value.is_integer() else str(value)
