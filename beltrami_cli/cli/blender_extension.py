"""The command `beltrami blender-extension`."""

from __future__ import annotations

import click

from beltrami_cli.cli import options
from beltrami_cli.cli.commands import HelpfulCommand
from beltrami_cli.cli.console import Messages

EPILOG = """\b
Examples:
  beltrami blender-extension beltrami.zip
  blender --command extension install-file -r user_default -e beltrami.zip

\b
In Blender: Edit > Preferences > Get Extensions > Install from Disk. The panel is in the sidebar of the 3D view
(N), under Beltrami. It runs this program on temporary files; nothing leaves the machine.
"""


@click.command("blender-extension", cls=HelpfulCommand, epilog=EPILOG)
@click.argument("target", metavar="OUT.zip")
@options.overwrite
@options.messages
def blender_extension(target: str, overwrite: bool, messages: Messages) -> None:
    """Write the extension for Blender 4.2 and newer, which smooths colour attributes and image textures.

    Its panel has the parameters of `beltrami smooth`, and calls the program that wrote it.
    """
    from beltrami_cli.jobs.blender_extension import write_blender_extension

    count = write_blender_extension(target, overwrite=overwrite)
    messages.say(f"{target}: an extension for Blender 4.2 and newer, with {count} parameters")
