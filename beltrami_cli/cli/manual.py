"""The manual pages, which the wheel holds: the whole help of each command for man(7).

`python -m beltrami_cli.cli.manual DIR VERSION` writes the manual.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

import click

from beltrami_cli.cli.command import DEFAULT_GROUP, HELP_ALL
from beltrami_cli.cli.main import group
from beltrami_cli.cli.registry import COMMANDS

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


class _Roff(click.HelpFormatter):
    """Writes for man(7) what click writes for a terminal."""

    def write_usage(self, prog: str, args: str = "", prefix: str | None = None) -> None:
        self.write(f".SH SYNOPSIS\n.B {_text(prog)}\n.I {_text(args)}\n.SH DESCRIPTION\n")

    def write_heading(self, heading: str) -> None:
        self.write(
            f".SH {heading.upper()}\n"
            if heading in (DEFAULT_GROUP, "Commands")
            else f'.SS "{_text(heading)}"\n'
        )

    def write_paragraph(self) -> None:
        pass

    def write_text(self, text: str) -> None:
        """Write paragraphs; after a line with a backspace they have a title and keep their lines, see `notes_on`."""
        for block in re.split(r"\n\s*\n", text.strip()):
            first, *lines = block.strip().split("\n")
            if first.strip() != "\b":
                self.write(f".PP\n{_text(' '.join(block.split()))}\n")
                continue
            title = lines[0].strip()
            self.write(".SH EXAMPLES\n" if title == "Examples:" else f".PP\n{_text(title)}\n.PP\n")
            self.write("\n".join([".nf", *(_text(line.strip()) for line in lines[1:]), ".fi\n"]))

    def write_dl(self, rows: Iterable[tuple[str, str]], col_max: int = 30, col_spacing: int = 2) -> None:
        for term, meaning in rows:
            self.write(f".TP\n.B {_text(term)}\n{_text(' '.join(meaning.split()))}\n")


def manual(version: str) -> Iterator[tuple[str, str]]:
    """Yield the names of the manual pages, such as ``beltrami-smooth.1``, and their text for man(7)."""
    top = click.Context(group, info_name="beltrami", **group.context_settings)
    yield "beltrami.1", _page(top, version)
    for name in COMMANDS:
        known = group.get_command(top, name)
        assert known is not None
        yield f"beltrami-{name}.1", _page(click.Context(known, top, name), version)


def _page(context: click.Context, version: str) -> str:
    """Return the whole help of a command as a page."""
    name, page = context.command_path.replace(" ", "-"), _Roff()
    page.write(f'.TH "{_text(name.upper())}" 1 "" "beltrami {_text(version)}" "User Commands"\n')
    page.write(f".SH NAME\n{_text(name)} \\- {_text(context.command.get_short_help_str(300).rstrip('.'))}\n")
    context.meta[HELP_ALL] = True
    context.command.format_help(context, page)
    page.write(".SH EXIT STATUS\n")
    page.write_dl(_EXIT_STATUS)
    shown = "smooth" if context.command is group else str(context.info_name)
    page.write(
        f".SH ENVIRONMENT\n.PP\n{_text(_ENVIRONMENT.format(f'BELTRAMI_{shown.upper()}_OPTION', shown))}\n"
    )
    page.write(f".SH FILES\n.PP\n{_text(_FILES)}\n")
    others = sorted({"beltrami", *(f"beltrami-{each}" for each in COMMANDS)} - {name})
    page.write(f".SH SEE ALSO\n.PP\n{', '.join(f'{_text(other)}(1)' for other in others)}\n")
    return page.getvalue()


def _text(text: str) -> str:
    """Return text in which nothing is a request to roff, and a dash can be searched for and pasted."""
    safe = text.replace("\\", "\\[rs]").replace("-", "\\-").replace("`", "\\[ga]").replace("'", "\\[aq]")
    safe = re.sub(r"[^\x00-\x7f]", lambda found: f"\\[u{ord(found[0]):04X}]", safe)
    return f"\\&{safe}" if safe.startswith(".") else safe


def main(target_name: str, version: str) -> None:
    target = Path(target_name)
    target.mkdir(parents=True, exist_ok=True)
    for name, text in manual(version):
        (target / name).write_text(text, encoding="ascii")


if __name__ == "__main__":
    main(*sys.argv[1:])
