"""Help of commands: `--help` shows the options that matter daily, `--help-all` all of them in groups."""

from __future__ import annotations

import inspect
from typing import Any

import click

_FEW = 12  # up to this many options are shown at once
_EXAMPLES = 8  # lines of examples in the short help

DAILY = "Options"  # the group of options without one


class GroupedOption(click.Option):
    """An option with the group under which `--help-all` shows it; without a group it matters daily."""

    def __init__(self, *arguments: Any, group: str = "", **attributes: Any) -> None:
        super().__init__(*arguments, **attributes)
        self.group = group


class HelpfulCommand(click.Command):
    """A command with a short and a full help if it has many options."""

    def __init__(self, *arguments: Any, **attributes: Any) -> None:
        super().__init__(*arguments, **attributes)
        options = [each for each in self.params if isinstance(each, click.Option)]
        self._is_long = len(options) > _FEW and any(map(_group, options))
        self.params.append(_help_all(hidden=not self._is_long))

    def option_groups(self, context: click.Context) -> dict[str, list[click.Option]]:
        """Return the options by their groups, those that matter daily first."""
        options = [each for each in self.get_params(context) if isinstance(each, click.Option)]
        if not self._is_long:
            return {DAILY: options}
        groups: dict[str, list[click.Option]] = {DAILY: []}
        for option in options:
            groups.setdefault(_group(option) or DAILY, []).append(option)
        return groups

    def format_help_text(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the description: in the short help, its first paragraph."""
        text = inspect.cleandoc(self.help or "")
        formatter.write_paragraph()
        with formatter.indentation():
            formatter.write_text(text if self._is_full(ctx) else text.partition("\n\n")[0])

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options: in the short help, those that matter daily, and which others there are."""
        groups = self.option_groups(ctx)
        for title, options in groups.items():
            if title == DAILY or self._is_full(ctx):
                records = [option.get_help_record(ctx) for option in options]
                with formatter.section(title):
                    formatter.write_dl([record for record in records if record is not None])
        if not self._is_full(ctx):
            others = ", ".join(title for title in groups if title != DAILY).lower()
            formatter.write_paragraph()
            formatter.write_text(f"--help-all shows more options: {others}.")

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write examples and notes: in the short help, the first examples."""
        text = inspect.cleandoc(self.epilog or "")
        formatter.write_paragraph()
        with formatter.indentation():
            formatter.write_text(text if self._is_full(ctx) else _first_examples(text))

    def _is_full(self, context: click.Context) -> bool:
        return not self._is_long or bool(context.meta.get(_ALL))


_ALL = "help_all"


def _help_all(*, hidden: bool) -> click.Option:
    return click.Option(
        ["--help-all"], is_flag=True, expose_value=False, is_eager=True, callback=_show_all,
        hidden=hidden,
        help="Show all options, examples and notes, and exit.",
    )  # fmt: skip


def _show_all(context: click.Context, option: click.Parameter, wanted: bool) -> None:
    if wanted and not context.resilient_parsing:
        context.meta[_ALL] = True
        click.echo(context.get_help(), color=context.color)
        context.exit()


def _group(option: click.Option) -> str:
    return option.group if isinstance(option, GroupedOption) else ""


def _first_examples(text: str) -> str:
    """Return the first lines of the examples, and of a command in several lines all of them."""
    head, *lines = text.partition("\n\n")[0].split("\n")
    count = min(_EXAMPLES + 1, len(lines))  # after the heading
    while count < len(lines) and lines[count - 1].endswith("\\"):
        count += 1
    return "\n".join([head, *lines[:count]])
