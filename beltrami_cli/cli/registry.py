"""The commands by name; the module of a command is imported when the command is asked for."""

from __future__ import annotations

import importlib
from collections.abc import Collection

import click

from beltrami_cli.cli.option_names import with_variables

# Summaries, which fit 80 columns. A command is a function in a module of its name.
COMMANDS = {
    "bake": "Move colours from vertices to a texture, or back.",
    "batch": "Smooth many files at the same time.",
    "blender-extension": "Write the extension for Blender.",
    "check": "List all differences between two files except colours.",
    "compare": "Measure how much colours differ from a reference.",
    "config": "Show the options in force, and where each comes from.",
    "docs": "Show the documentation by topic.",
    "info": "Show the coloured parts of files, and their noise.",
    "kernel": "Write the distances and the weights of one kernel.",
    "level": "Remove exposure steps between the charts of textures.",
    "noise": "Add noise to colours, for tests.",
    "render": "Draw models, points and images as one picture.",
    "report": "Write a page that compares two files in the browser.",
    "smooth": "Smooth the colours of a model, of points or of an image.",
    "sweep": "Smooth with many settings, and show all results together.",
    "view": "Show a model in the browser, and smooth it there.",
}


def command_named(name: str) -> click.Command:
    function = name.replace("-", "_")
    command: click.Command = getattr(
        importlib.import_module(f"beltrami_cli.cli.commands.{function}"), function
    )
    command.short_help = COMMANDS[name]
    return with_variables(command, name, inherited_from_smooth(name))


def inherited_from_smooth(name: str) -> Collection[str]:
    """Return the options that a command inherits from `smooth`, so that both write equal files."""
    if name != "batch":
        return ()
    from beltrami_cli.cli.batch_items import SHARED_WITH_SMOOTH

    return SHARED_WITH_SMOOTH
