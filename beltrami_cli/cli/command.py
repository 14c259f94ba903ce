"""Commands and their help: `--help` shows the options that matter daily, `--help-all` all of them in groups."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable
from typing import Any

import click
from click.shell_completion import CompletionItem

from beltrami_cli.cli.documentation import notes_on
from beltrami_cli.errors import UsageError

DEFAULT_GROUP = "Options"  # the group of options without one
HELP_ALL = "help_all"  # key in the meta of contexts

_MAX_UNGROUPED = 12  # up to this many options are shown at once
_EXAMPLES = 8  # lines of examples in the short help
_OPTION = re.compile(r"(?<=\s)--?[a-zA-Z][\w-]*")
# How the help shows values that are files or folders.
_NAMES_FILES = re.compile(r"FILE|OUT\.|DIR")


def write_notes(formatter: click.HelpFormatter, text: str) -> None:
    formatter.write_paragraph()
    with formatter.indentation():
        formatter.write_text(text)


def complete_files(_context: click.Context, _parameter: click.Parameter, typed: str) -> list[CompletionItem]:
    """Let the shell complete names of files and folders."""
    return [CompletionItem(typed, type="file")]


class GroupedOption(click.Option):
    """An option with its group in `--help-all`; options without a group are for daily use."""

    def __init__(self, *arguments: Any, group: str = "", **attributes: Any) -> None:
        super().__init__(*arguments, **attributes)
        self.group = group

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Return words, and file names where the help shows that they are taken."""
        files = _NAMES_FILES.search(self.metavar or "")
        return [
            *super().shell_complete(ctx, incomplete),
            *(complete_files(ctx, self, incomplete) if files else []),
        ]


class HelpfulCommand(click.Command):
    """A command with a short and a full help if it has many options."""

    def __init__(self, *arguments: Any, **attributes: Any) -> None:
        super().__init__(*arguments, **attributes)
        options = [each for each in self.params if isinstance(each, click.Option)]
        self._is_long = len(options) > _MAX_UNGROUPED and any(getattr(each, "group", "") for each in options)
        help_all = click.Option(
            ["--help-all"], is_flag=True, expose_value=False, is_eager=True, callback=_show_all,
            hidden=not self._is_long, help="Show all options, examples and notes.",
        )  # fmt: skip
        self.params.append(help_all)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        try:
            self._refuse_repeated_lists(ctx, args)
            return super().parse_args(ctx, args)
        except click.NoSuchOption as error:
            raise _misplaced(error.option_name, ctx) or error from None

    def _refuse_repeated_lists(self, ctx: click.Context, args: list[str]) -> None:
        """Refuse a list option that is repeated, as click would silently take the last list."""
        _, _, order = self.make_parser(ctx).parse_args([*args])
        for option, times in Counter(order).items():
            declared = getattr(option, "declared", None)
            is_list = declared is not None and declared.kind is str and declared.several
            if times > 1 and is_list and not option.multiple and not ctx.resilient_parsing:
                cause = f"{option.opts[0]} is given {times} times"
                raise UsageError(f"{cause}; give one list, with commas between its names")

    def option_groups(self, context: click.Context) -> dict[str, list[click.Option]]:
        """Return the options by group, the daily ones first."""
        options = [each for each in self.get_params(context) if isinstance(each, click.Option)]
        if not self._is_long:
            return {DEFAULT_GROUP: options}
        groups: dict[str, list[click.Option]] = {DEFAULT_GROUP: []}
        for option in options:
            groups.setdefault(getattr(option, "group", "") or DEFAULT_GROUP, []).append(option)
        return groups

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        groups, shown = self.option_groups(ctx), str if self._is_full(ctx) else _in_short
        for title, options in groups.items():
            if title == DEFAULT_GROUP or self._is_full(ctx):
                records = filter(None, (option.get_help_record(ctx) for option in options))
                with formatter.section(title):
                    formatter.write_dl([(name, shown(text)) for name, text in records])
        if not self._is_full(ctx):
            others = ", ".join(title for title in groups if title != DEFAULT_GROUP).lower()
            formatter.write_paragraph()
            formatter.write_text(f"--help-all says more, and shows more options: {others}.")

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        text = notes_on(str(self.name))
        write_notes(formatter, text if self._is_full(ctx) else self._first_examples(text, ctx))

    def _first_examples(self, text: str, context: click.Context) -> str:
        """Return the first complete examples that use only options of the short help."""
        head, title, *lines = text.partition("\n\n")[0].split("\n")
        shown = {name for option in self.option_groups(context)[DEFAULT_GROUP] for name in option.opts}
        chosen: list[str] = []
        for example in re.findall(r"(?:.*\\\n)*.+", "\n".join(lines)):
            if len(chosen) < _EXAMPLES and {*_OPTION.findall(example.partition(" #")[0])} <= shown:
                chosen += example.split("\n")
        return "\n".join([head, title, *chosen])

    def _is_full(self, context: click.Context) -> bool:
        return not self._is_long or bool(context.meta.get(HELP_ALL))


def command(called: str, /, **arguments: str) -> Callable[[Callable[..., Any]], HelpfulCommand]:
    """Declare a command and its arguments, as the help shows them: FILE... takes several, [TOPIC] may be left out."""

    def decorate(function: Callable[..., Any]) -> HelpfulCommand:
        for name, metavar in reversed(arguments.items()):
            nargs = -1 if metavar.endswith("...") else 1
            function = click.argument(
                name, metavar=metavar, nargs=nargs, required=metavar[0] != "[", shell_complete=complete_files
            )(function)
        return click.command(called, cls=HelpfulCommand)(function)

    return decorate


def _misplaced(name: str, context: click.Context) -> click.UsageError | None:
    """Return an error that says where an unknown option of a command belongs; None: nowhere."""
    reports = [each for each in context.command.params if name == "--json" and "--report" in each.opts]
    if reports:
        cause = f"No such option: --json. The JSON goes into a file: --report {reports[0].metavar}"
        return click.UsageError(cause, context)
    program = context.parent
    if program is None:
        return None
    for option in program.command.params:
        if name in option.opts:
            behind = f" {option.metavar} {context.info_name} ..." if option.metavar else ""
            cause = f"{name} goes before the command: {program.info_name} {name}{behind}"
            return click.UsageError(cause, context)
    return None


def _show_all(context: click.Context, option: click.Parameter, wanted: bool) -> None:
    if wanted and not context.resilient_parsing:
        context.meta[HELP_ALL] = True
        click.echo(context.get_help(), color=context.color)
        context.exit()


def _in_short(text: str) -> str:
    """Return the first sentence of the help of an option, and its notes in brackets."""
    return re.sub(r"(?<=\.) (?! ).*?(?=  \[|$)", "", text, count=1, flags=re.DOTALL)
