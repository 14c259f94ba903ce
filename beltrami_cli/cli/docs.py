"""The command `beltrami docs`: the pages of the documentation, which every installation holds."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import click

from beltrami_cli.cli.commands import HelpfulCommand, docs_folder

_LEFT_OUT = {"index", "changelog"}  # they consist of links and of another file
# Markup for the site alone: what its plug-ins insert, and marks for scripts.
_FOR_THE_SITE = re.compile(r"^(?:::: .*\n(?: {4}.*\n)*|<!--.*-->\n)", re.MULTILINE)


def pages() -> dict[str, Path]:
    """Return the topics and their files."""
    return {path.stem: path for path in sorted(docs_folder().glob("*.md")) if path.stem not in _LEFT_OUT}


def page_text(path: Path) -> str:
    """Return a page as Markdown without the markup that only the site can show, and with the table of parameters."""
    text = _FOR_THE_SITE.sub("", path.read_text(encoding="utf-8"))
    if path.stem == "parameters":
        from beltrami_cli.cli.manual import parameter_table

        text += f"\n{parameter_table()}"
    return text


@click.command("docs", cls=HelpfulCommand)
@click.argument("topic", type=click.Choice(list(pages())), metavar="[TOPIC]", required=False)
def docs(topic: str | None) -> None:
    """Show a page of the documentation, formatted on a terminal and as Markdown elsewhere; or list the pages."""
    if topic is None:
        for name, path in pages().items():
            click.echo(f"{name:<16}{page_text(path).partition('# ')[2].splitlines()[0]}")
    elif not sys.stdout.isatty():
        click.echo(page_text(pages()[topic]), nl=False)
    else:
        from rich.console import Console
        from rich.markdown import Markdown

        console = Console()
        with console.capture() as formatted:
            console.print(Markdown(page_text(pages()[topic]), hyperlinks=False))
        click.echo_via_pager(formatted.get())
