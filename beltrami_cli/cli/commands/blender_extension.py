"""The command `beltrami blender-extension`: the sources in `beltrami_cli/blender`, with the parameters, as a file."""

from __future__ import annotations

import io
import json
import sys
import zipfile
from collections.abc import Iterator
from importlib import resources
from typing import Any

from beltrami_cli.cli import options
from beltrami_cli.cli.command import command
from beltrami_cli.cli.console import Messages
from beltrami_cli.fields import Parameter, parameters
from beltrami_cli.layers.settings import SmoothSettings

_FILES = {"addon.py": "__init__.py"}  # all others keep their names
# Blender chooses the colours, their files and their surface itself, and has nothing else that could guide.
_GROUPS = ("Kernel", "Colours", "Textures")
_OMITTED_OPTIONS = ("on", "slots", "materials", "names", "image_suffix", "jpeg_quality", "small")
_TIMESTAMP = (1980, 1, 1, 0, 0, 0)  # the date of every file, so that equal programs write equal files


@command("blender-extension", target="OUT.zip")
@options.overwrite
@options.messages
def blender_extension(target: str, overwrite: bool, messages: Messages) -> None:
    """Write the extension for Blender 4.2 and newer, which smooths colour attributes and image textures."""
    count = write_blender_extension(target, overwrite=overwrite)
    messages.say(f"{target}: an extension for Blender 4.2 and newer, with {count} parameters")


def write_blender_extension(target: str, *, overwrite: bool) -> int:
    """Write the extension as a .zip file; return the number of its parameters."""
    # Later, since these need NumPy, and manual pages are written where only what builds the package is installed.
    from beltrami_cli.formats.changes import Written
    from beltrami_cli.jobs.writing.output import Output

    output = Output(target, overwrite=overwrite, what="extension")
    declared = list(declared_parameters())
    about = {"command": [sys.executable, "-P", "-m", "beltrami_cli"], "parameters": declared}
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for source in sorted(resources.files("beltrami_cli").joinpath("blender").iterdir(), key=str):
            if source.is_file():
                name = _FILES.get(source.name, source.name)
                archive.writestr(zipfile.ZipInfo(name, _TIMESTAMP), source.read_bytes())
        archive.writestr(zipfile.ZipInfo("parameters.json", _TIMESTAMP), json.dumps(about, indent=1))
    output.write(Written(main=[buffer.getvalue()]))
    return len(declared)


def declared_parameters() -> Iterator[dict[str, Any]]:
    """Yield the parameters of smoothing that the extension shows, in JSON types."""
    for each in parameters(SmoothSettings, deep=True):
        if not each.flags or each.group not in _GROUPS or each.name in _OMITTED_OPTIONS:
            continue
        flag = each.flag.partition("/")[0]
        is_number = each.kind in (bool, int, float) and each.parse is None and not each.several
        yield {
            "name": each.name,
            "flag": flag,
            "label": flag.lstrip("-").replace("-", " ").capitalize(),
            "kind": each.kind.__name__ if is_number else "text",
            "default": _default(each),
            "choices": list(each.choices) if each.parse is None else [],
            "low": each.low,
            "high": each.high,
            "help": f"{each.help}{f' In {each.unit}.' if each.unit else ''}",
            "unset": each.unset.format(default=each.default),
            "daily": each.is_daily,
            "group": each.group,
            "of": list(each.of),
        }


def _default(declared: Parameter) -> Any:
    if declared.parse is not None:
        return None if declared.unset else declared.show(declared.default)
    return None if declared.default in (None, ()) else declared.default
