"""Write the parts of pages that are made from the code: ``make reference``, or ``python docs/reference.py``.

The options of all commands go to the end of commands.md, the parameters to parameters.md, and the public names to
api.md, each behind the line ``<!-- made by make reference -->``. In tutorial.md each command is followed by what it
prints.
"""

from __future__ import annotations

import dataclasses
import inspect
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import click

import beltrami_cli
from beltrami_cli import (
    Access,
    BakeSettings,
    EmbeddingSettings,
    ImageSettings,
    KernelParameters,
    LevelSetSettings,
    LevelSettings,
    Limits,
    NoiseSettings,
    RenderSettings,
    SmoothSettings,
    TextureSettings,
)
from beltrami_cli.cli.main import group
from beltrami_cli.cli.registry import COMMANDS
from beltrami_cli.fields import REQUIRED, Parameter, parameters

HERE = Path(__file__).resolve().parent
MARK = "<!-- made by make reference -->\n"
RECORDS = (
    KernelParameters, SmoothSettings, TextureSettings, ImageSettings, LevelSetSettings, EmbeddingSettings,
    BakeSettings, LevelSettings, NoiseSettings, Limits, RenderSettings, Access,
)  # fmt: skip


def parameter_table() -> str:
    """Return all parameters in one table, with a row of its own for the name of each record."""
    lines = [_row("name", "option", "default", "allowed", "unit", "meaning"), _row(*["---"] * 6)]
    for record in RECORDS:
        lines.append(_row(f"**`{record.__name__}`**", f"**{record.group}**", "", "", "", ""))
        lines += (_row(f"`{each.name}`", *_cells(each), each.unit, each.help) for each in parameters(record))
    return "\n".join(lines)


def _cells(declared: Parameter) -> tuple[str, str, str]:
    flags = [flag for flag in declared.flags if flag.startswith("-")]
    default = "required" if declared.default is REQUIRED else declared.default_in_words
    return (
        ", ".join(f"`{flag}`" for flag in flags),
        default or ("off" if declared.kind is bool else ""),
        "" if declared.kind is bool else declared.range,
    )


def _row(*cells: str) -> str:
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"


def option_lists() -> str:
    """Return the options of each command; options that it shares with `smooth` are only named."""
    top = click.Context(group, info_name="beltrami", **group.context_settings)
    lists = {name: _options(group.get_command(top, name), top) for name in COMMANDS}
    parts = []
    for name, options in lists.items():
        known = {} if name == "smooth" else lists["smooth"]
        lines = [f"- `{each}`: {text}" for each, text in options.items() if known.get(each) != text]
        shared = [
            f"`{each.split(' ')[0].rstrip(',')}`" for each, text in options.items() if known.get(each) == text
        ]
        if shared:
            lines.append(f"- as for `smooth`: {', '.join(shared)}")
        if lines:
            parts.append("\n".join([f"### beltrami {name}\n", *lines]))
    return "\n\n".join(parts)


def _options(command: click.Command, top: click.Context) -> dict[str, str]:
    context = click.Context(command, top, command.name)
    options = (each for each in command.params if isinstance(each, click.Option) and each.name != "help_all")
    records = (each.get_help_record(context) for each in options)
    return {record[0]: " ".join(record[1].split()) for record in records if record is not None}


def public_names() -> str:
    """Return signatures and docstrings of all public names but the records, which are in the table of parameters."""
    parts = []
    for name in sorted(beltrami_cli.__all__, key=str.lower):
        public = getattr(beltrami_cli, name)
        if public not in RECORDS:
            described = [_signature(name, public), inspect.getdoc(public), *_members(public)]
            parts.append(f"### {name}\n\n```text\n{chr(10).join(described)}\n```")
    return "\n\n".join(parts)


def _members(public: Any) -> list[str]:
    """Describe the properties and methods of a class, which its docstring does not list."""
    found = []
    for name, member in vars(public).items() if inspect.isclass(public) else ():
        is_member = isinstance(member, property) or inspect.isfunction(member)
        if is_member and not name.startswith("_") and inspect.getdoc(member):
            arguments = "" if isinstance(member, property) else "()"
            found.append(f"\n{name}{arguments}\n    " + inspect.getdoc(member).replace("\n", "\n    "))
    return found


def _signature(name: str, public: Any) -> str:
    """Write a call with one argument a line, without the values of records."""
    if inspect.isclass(public) and issubclass(public, Exception):
        return f"{name}\n"
    signature, lines, named_only = inspect.signature(public), [], False
    for each in signature.parameters.values():
        if each.kind is each.KEYWORD_ONLY and not named_only:
            lines.append("*")
            named_only = True
        stars = {each.VAR_POSITIONAL: "*", each.VAR_KEYWORD: "**"}.get(each.kind, "")
        lines.append(f"{stars}{each.name}: {each.annotation}{_default(each.default)}")
    returned = "" if inspect.isclass(public) else f" -> {signature.return_annotation}"
    return f"{name}(" + "".join(f"\n    {line}," for line in lines) + f"\n){returned}\n"


def _default(value: Any) -> str:
    if value is inspect.Parameter.empty:
        return ""
    if dataclasses.is_dataclass(value):
        return f" = {type(value).__name__}(...)"
    return " = ..." if "<factory>" in repr(value) else f" = {value!r}"


MADE = {"api.md": public_names, "commands.md": option_lists, "parameters.md": parameter_table}


def page(name: str) -> str:
    """Return a page with its made part as the code has it now."""
    text, mark, _ = (HERE / name).read_text(encoding="utf-8").partition(MARK)
    return f"{text}{mark}\n{MADE[name]()}\n"


def tutorial() -> str:
    """Return the page with what its commands print now."""
    text = (HERE / "tutorial.md").read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as folder:
        for sample in (HERE.parent / "sample_data").glob("head-tex-*.glb"):
            shutil.copy(sample, folder)
        return re.sub(
            r"```console\n\$ (.*)\n[^`]*```",
            lambda found: f"```console\n$ {found[1]}\n{_printed(found[1], folder)}```",
            text,
        )


def _printed(line: str, folder: str) -> str:
    command = [sys.executable, "-P", "-m", "beltrami_cli", *shlex.split(line)[1:]]
    run = subprocess.run(
        command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=True, text=True
    )
    return run.stdout


if __name__ == "__main__":
    (HERE / "tutorial.md").write_text(tutorial(), encoding="utf-8")
    for name in MADE:
        (HERE / name).write_text(page(name), encoding="utf-8")
