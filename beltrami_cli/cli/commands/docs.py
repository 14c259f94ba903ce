"""The command `beltrami docs`."""

from __future__ import annotations

import re
import sys
from difflib import get_close_matches
from typing import Any

import click

from beltrami_cli.cli.command import command
from beltrami_cli.cli.documentation import page_text, pages


class _Topic(click.Choice):  # type: ignore[type-arg]  # generic only in newer versions
    """The name of a page; for a wrong one the error suggests similar names, or pages with such a heading."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        try:
            return super().convert(value, param, ctx)
        except click.BadParameter as error:
            heading = re.compile(rf"^## .*\b{re.escape(value)}", re.IGNORECASE | re.MULTILINE)
            found = get_close_matches(value, pages())
            found = found or [name for name, path in pages().items() if heading.search(page_text(path))]
            hint = f" Did you mean {' or '.join(found)}?" if found else ""
            raise click.BadParameter(f"{error.message}{hint}", ctx, param) from None


@command("docs")
@click.argument("topic", type=_Topic(list(pages())), metavar="[TOPIC]", required=False)
def docs(topic: str | None) -> None:
    """Show a page of the documentation, formatted on a terminal and as Markdown elsewhere; or list the pages."""
    if topic is None:
        for name, path in pages().items():
            click.echo(f"{name:<16}{page_text(path).partition('# ')[2].splitlines()[0]}")
        return
    text = page_text(pages()[topic])
    if not sys.stdout.isatty():
        click.echo(text, nl=False)
        return
    from rich.console import Console
    from rich.markdown import Markdown

    console = Console()
    with console.capture() as formatted:
        console.print(Markdown(text, hyperlinks=False))
    click.echo_via_pager(formatted.get())
