"""The command `beltrami view`."""

from __future__ import annotations

import atexit
import os
import shlex
import sys
from typing import Any

import click

from beltrami_cli.cli import options
from beltrami_cli.cli.commands import HelpfulCommand
from beltrami_cli.cli.console import Messages
from beltrami_cli.jobs.job import Job
from beltrami_cli.layers.settings import SmoothSettings

EPILOG = """\b
Examples:
  beltrami view scan.ply                         in the browser, with all parameters chosen
  beltrami view model.glb --strength gentle      start with other parameters, as for smooth
  beltrami view photo.jpg --no-open              print the address, and open no browser

\b
The page is served on this machine only, to those who know its address, until it is closed or Ctrl-C is pressed. A part
of the model is smoothed at once while a control is moved, and the whole when it rests. Nothing is written unless
"Save" is pressed; "Copy command" gives the call of `beltrami smooth` that does the same.
"""


@click.command("view", cls=HelpfulCommand, epilog=EPILOG)
@click.argument("source", metavar="MODEL")
@click.option("--no-open", is_flag=True, help="Print the address of the page, and open no browser.")
@options.smoothing
@options.reading
@options.messages
def command(source: str, no_open: bool, messages: Messages, **smoothing: Any) -> None:
    """Show MODEL in the browser, and smooth it there while parameters are changed.

    MODEL is what `beltrami smooth` takes: a mesh, a textured model, points, an image or a level set. The page has it
    before and after with a line between them, the difference, and what was chosen.
    """
    settings = options.settings_from(smoothing)
    from beltrami_cli.view.live import Live
    from beltrami_cli.view.server import PageServer

    def typed(settings: SmoothSettings, target: str) -> str:
        words = options.words_of(settings, smoothing["preset"])
        words += ["--allow-outside"] if smoothing["allow_outside"] else []
        columns = smoothing["columns"]
        words += ["--columns", columns] if columns else []
        words += ["--max-memory", str(smoothing["max_memory"])] if smoothing["max_memory"] else []
        return shlex.join(["beltrami", "smooth", source, target, *words])

    with options.reading_from(smoothing, source) as access:
        live = Live(source, settings, Job(access), typed)
        try:
            server = PageServer(live)
            messages.say(f"{source}: shown at {server.address} until the page is closed, or Ctrl-C")
            if not no_open:
                import webbrowser

                webbrowser.open(server.first_address)
            server.run()
        finally:
            if not live.close():  # threads of the core would make Python abort as it ends
                error = sys.exc_info()[1]
                atexit.register(os._exit, 0 if error is None else getattr(error, "exit_code", 1))
