"""Pages made from the program: its manual, which the wheel holds, and the table of all parameters.

`python -m beltrami_cli.cli.manual DIR VERSION` writes the manual.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path

import click

from beltrami_cli.cli.commands import DAILY, HelpfulCommand, notes_on
from beltrami_cli.cli.main import ALL_COMMANDS, COMMANDS, group
from beltrami_cli.fields import REQUIRED, Parameter, parameters
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.formats.access import Access
from beltrami_cli.jobs.job import BakeSettings, Limits, NoiseSettings
from beltrami_cli.layers.settings import (
    EmbeddingSettings,
    ImageSettings,
    LevelSetSettings,
    LevelSettings,
    SmoothSettings,
    TextureSettings,
)
from beltrami_cli.view.settings import RenderSettings

_ENVIRONMENT = (
    "Every option has a variable: {}, with _ for - in the option. Options come from a file, too. The command "
    "line overrides variables, these the file, and that the default; beltrami config {} shows the values in force."
)
_FILES = (
    "beltrami.toml, or [tool.beltrami] in pyproject.toml, in the working folder or above it; or --config FILE"
)
_EXIT_STATUS = (
    ("0", "Done."), ("1", "Processing failed, or a limit is broken."), ("2", "Wrong usage."),
    ("3", "An input is unreadable or not fit."), ("4", "An output is not writable."), ("130", "Interrupted."),
)  # fmt: skip
_SECTIONS = (
    KernelParameters, SmoothSettings, TextureSettings, ImageSettings, LevelSetSettings, EmbeddingSettings,
    BakeSettings, LevelSettings, NoiseSettings, Limits, RenderSettings, Access,
)  # fmt: skip


def parameter_table() -> str:
    """All parameters in one table, with a row of its own for the name of each record."""
    lines = [
        "| name | option | default | allowed | unit | meaning |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for record in _SECTIONS:
        lines.append(f"| **`{record.__name__}`** | **{record.group}** |  |  |  |  |")
        for declared in parameters(record):
            cells = [f"`{declared.name}`", *_cells(declared), declared.unit, declared.help]
            lines.append(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |")
    return "\n".join([*lines, ""])


def _cells(declared: Parameter) -> tuple[str, str, str]:
    flags = [flag for flag in declared.flags if flag.startswith("-")]
    default = "required" if declared.default is REQUIRED else declared.default_in_words
    return (
        ", ".join(f"`{flag}`" for flag in flags),
        default or ("off" if declared.kind is bool else ""),
        "" if declared.kind is bool else declared.range,
    )


def manual(version: str) -> Iterator[tuple[str, str]]:
    """Yield the names of the manual pages, such as ``beltrami-smooth.1``, and their text for man(7)."""
    top = click.Context(group, info_name="beltrami", **group.context_settings)
    known = {name: each for name in COMMANDS if (each := group.get_command(top, name)) is not None}
    listed = [(f"beltrami-{name}(1)", each.get_short_help_str(300)) for name, each in known.items()]
    lines = [*_page(top, version), ".SH COMMANDS", *_pairs(listed), *_ending("beltrami")]
    yield "beltrami.1", "\n".join(lines)
    for name, command in known.items():
        context = click.Context(command, top, name)
        yield f"beltrami-{name}.1", "\n".join([*_page(context, version), *_ending(name)])


def _page(context: click.Context, version: str) -> Iterator[str]:
    """Yield what the help of a command says, as sections."""
    command, name = context.command, context.command_path.replace(" ", "-")
    usage = " ".join(command.collect_usage_pieces(context))
    yield f'.TH "{_text(name.upper())}" 1 "" "beltrami {_text(version)}" "User Commands"'
    yield from (".SH NAME", f"{_text(name)} \\- {_text(command.get_short_help_str(300).rstrip('.'))}")
    yield from (".SH SYNOPSIS", f".B {_text(context.command_path)}", f".I {_text(usage)}")
    yield ".SH DESCRIPTION"
    yield from _blocks(command.help or "")
    yield ".SH OPTIONS"
    others = [each for each in command.get_params(context) if isinstance(each, click.Option)]
    groups = command.option_groups(context) if isinstance(command, HelpfulCommand) else {DAILY: others}
    for title, options in groups.items():
        if title != DAILY:
            yield f'.SS "{_text(title)}"'
        records = [option.get_help_record(context) for option in options]
        yield from _pairs([record for record in records if record is not None])
    notes = notes_on(ALL_COMMANDS if command is group else str(command.name))
    examples, _, rest = notes.partition("\n\n")
    yield ".SH EXAMPLES"
    yield from _verbatim(examples.split("\n")[2:])
    if rest.strip():
        yield ".SH NOTES"
        yield from _blocks(rest)


def _ending(name: str) -> Iterator[str]:
    yield ".SH EXIT STATUS"
    yield from _pairs(list(_EXIT_STATUS))
    shown = "smooth" if name == "beltrami" else name
    yield from (".SH ENVIRONMENT", ".PP")
    yield _text(_ENVIRONMENT.format(f"BELTRAMI_{shown.upper()}_OPTION", shown))
    yield from (".SH FILES", ".PP", _text(_FILES))
    others = sorted(({"beltrami"} | {f"beltrami-{each}" for each in COMMANDS}) - {name, f"beltrami-{name}"})
    yield from (".SH SEE ALSO", ".PP", ", ".join(f"\\fB{_text(other)}\\fR(1)" for other in others), "")


def _pairs(pairs: list[tuple[str, str]]) -> Iterator[str]:
    for term, meaning in pairs:
        yield from (".TP", f".B {_text(term)}", _text(" ".join(meaning.split())))


def _blocks(text: str) -> Iterator[str]:
    """Yield paragraphs; those after a line with a backspace keep their lines, as click has it."""
    for block in re.split(r"\n\s*\n", text.strip()):
        lines = block.strip().split("\n")
        if lines[0].strip() != "\b":
            yield from (".PP", _text(" ".join(block.split())))
        elif len(lines) > 2 and lines[1].rstrip().endswith(":"):
            yield from (".PP", _text(lines[1].strip()), ".PP")
            yield from _verbatim(lines[2:])
        else:
            yield from (".PP", _text(" ".join(" ".join(lines[1:]).split())))


def _verbatim(lines: list[str]) -> Iterator[str]:
    yield from (".nf", *(_text(line.strip()) for line in lines if line.strip()), ".fi")


def _text(text: str) -> str:
    """Return text in which nothing is a request to roff, and a dash can be searched for and pasted."""
    safe = text.replace("\\", "\\[rs]").replace("-", "\\-").replace("`", "\\[ga]").replace("'", "\\[aq]")
    safe = re.sub(r"[^\x00-\x7f]", lambda found: f"\\[u{ord(found[0]):04X}]", safe)
    return f"\\&{safe}" if safe.startswith(".") else safe


def main(target_name: str, version: str) -> None:
    """Write the manual pages into a folder, which is made."""
    target = Path(target_name)
    target.mkdir(parents=True, exist_ok=True)
    for name, text in manual(version):
        (target / name).write_text(text, encoding="ascii")


if __name__ == "__main__":
    main(*sys.argv[1:])
