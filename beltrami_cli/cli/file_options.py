"""The options that bear on a single file of `beltrami batch`: those of `smooth` that change its result."""

from __future__ import annotations

import click

from beltrami_cli.cli import options

OF_A_FILE = click.command("file")(options.smoothing(options.unwrapping(lambda **_: None)))
NAMES = tuple(option.name for option in OF_A_FILE.params if option.name)
