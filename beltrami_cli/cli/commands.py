"""Commands and their options: names as they are typed, in files and as variables of the environment; and the help.

`--help` shows the options that matter daily, `--help-all` all of them in groups.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Callable, Collection, Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource
from click.shell_completion import CompletionItem

from beltrami_cli.errors import UsageError

if TYPE_CHECKING:
    from beltrami_cli.jobs.output import Overwrite

_PREFIX = "BELTRAMI"

# How the help shows values that are files or folders.
_NAMES_FILES = re.compile(r"FILE|OUT\.|DIR")


def long_name(option: click.Parameter) -> str:
    """Return the documented name of an option, without leading dashes."""
    return next((text for text in option.opts if text.startswith("--")), option.opts[0]).lstrip("-")


def plain(name: str) -> str:
    """Return the name of an option without dashes."""
    return spelled(name).lstrip("-").replace("-", "_")


def spelled(name: str) -> str:
    """Return the documented spelling of an option; the American one of colour is accepted everywhere."""
    return name.replace("color", "colour")


def options_by_name(command: click.Command) -> dict[str, click.Option]:
    """Return the options of a command by all their names, without dashes in front and with _ for those within."""
    return {
        plain(name): option
        for option in command.params
        if isinstance(option, click.Option) and option.name and not option.is_eager
        for name in (*option.opts, option.name)
    }


def values_for(options: Mapping[str, click.Option], table: Mapping[str, object]) -> dict[str, Any]:
    """Return values for a default map, by click's names of options; ValueError if one is invalid."""
    values: dict[str, Any] = {}
    for name, value in table.items():
        option = options.get(plain(name))
        if option is None or option.name is None:
            raise ValueError(f"{name} is not an option of this command")
        if option.name in values:
            raise ValueError(f"{name} is given twice, under two names")
        values[option.name] = _value(option, name, value)
    return values


def _value(option: click.Option, name: str, value: object) -> object:
    if isinstance(value, dict) or (isinstance(value, bool) and not option.is_flag):
        raise ValueError(f"{name} can be no {'table' if isinstance(value, dict) else 'truth value'}")
    if option.multiple:
        return tuple(_scalar(option, each) for each in (value if isinstance(value, list) else [value]))
    if isinstance(value, list):  # options that take a list take it with commas
        return ",".join(str(each) for each in value)
    return _scalar(option, value)


def _scalar(option: click.Option, value: object) -> object:
    """Return a value as click can convert it, or refuse it: numbers of flags, dates and the like as text."""
    if isinstance(value, bool | str):
        return value
    # Options of whole numbers refuse the text of others, and would cut off the number itself.
    is_whole = isinstance(value, int) or (isinstance(value, float) and value.is_integer())
    return value if is_whole and not option.is_flag else str(value)


def with_variables(command: click.Command, name: str, shared: Collection[str]) -> click.Command:
    """Set the environment variables of all options; `shared` options also obey the variables of `smooth`.

    The click library could do that alone, but would name them after arguments of functions, not after options.
    """
    for option in command.params:
        if isinstance(option, click.Option) and not option.is_eager:
            commands, own = [name, "smooth"] if option.name in shared else [name], long_name(option)
            variables = [f"{_PREFIX}_{each}_{own}".upper().replace("-", "_") for each in commands]
            others = [each.replace("COLOUR", "COLOR") for each in variables if "COLOUR" in each]
            option.envvar = [*variables, *others]
    return command


def refuse_unknown_variables(command: click.Command, name: str) -> None:
    """Raise UsageError if a variable of a command belongs to none of its options."""
    prefix = f"{_PREFIX}_{name}_".upper().replace("-", "_")
    known = [each.removeprefix(prefix) for option in command.params for each in option.envvar or ()]
    for variable in sorted(os.environ):
        if variable.startswith(prefix) and variable.removeprefix(prefix) not in known:
            similar = get_close_matches(variable.removeprefix(prefix), known, 1)
            remedy = (
                f"did you mean {prefix}{similar[0]}?"
                if similar
                else f"beltrami config {name} shows all options"
            )
            raise UsageError(f"the variable {variable} belongs to no option of {name}; {remedy}")


def variable_in_force(option: click.Parameter) -> str:
    """Return the environment variable of an option that is set."""
    names = [option.envvar] if isinstance(option.envvar, str) else option.envvar or []
    return next((name for name in names if os.environ.get(name)), "")


def variable_behind(option: click.Parameter | None, context: click.Context | None) -> str:
    """Return the environment variable that the value of an option comes from, if any."""
    if option is None or context is None:
        return ""
    source = context.get_parameter_source(str(option.name))
    return variable_in_force(option) if source is ParameterSource.ENVIRONMENT else ""


def overwrite_at(option: str, *, overwrite: bool) -> Overwrite:
    """Whether a file may be replaced: what this program did not write only if the command line itself says so."""
    sources = [click.get_current_context().get_parameter_source(name) for name in (option, "overwrite")]
    is_direct = all(source is ParameterSource.COMMANDLINE for source in sources)
    return "own" if overwrite and not is_direct else overwrite


def docs_folder() -> Path:
    """Return the folder of the documentation: in the package, or in the sources that it runs from."""
    package = Path(__file__).parents[1]
    installed = package / "docs"
    return installed if installed.is_dir() else package.parent / "docs"


def notes_on(command: str) -> str:
    """Return the examples and notes of a command, for click, from its section of the page of commands."""
    text = (docs_folder() / "commands.md").read_text(encoding="utf-8")
    section = text.partition(f"\n## {command}\n")[2].partition("\n## ")[0]
    notes: list[str] = []
    for block in section.strip().split("\n\n"):
        if not block.startswith("```"):
            notes.append(block)
            continue
        title = notes.pop() if notes and notes[-1].endswith(":") else "Examples:"
        notes.append("\n".join(["\b", title, *(f"  {line}" for line in block.split("\n")[1:-1])]))
    return "\n\n".join(notes)


def write_notes(formatter: click.HelpFormatter, text: str) -> None:
    """Write the end of a help."""
    formatter.write_paragraph()
    with formatter.indentation():
        formatter.write_text(text)


_MAX_UNGROUPED = 12  # up to this many options are shown at once
_EXAMPLES = 8  # lines of examples in the short help
_OPTION = re.compile(r"(?<=\s)--?[a-zA-Z][\w-]*")

DEFAULT_GROUP = "Options"  # the group of options without one


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
    """Return the error that an option of the program stands behind the command; None if it has no such option."""
    program = context.parent
    if program is None:
        return None
    for option in program.command.params:
        if name in option.opts:
            behind = f" {option.metavar} {context.info_name} ..." if option.metavar else ""
            cause = f"{name} goes before the command: {program.info_name} {name}{behind}"
            return click.UsageError(cause, context)
    return None


HELP_ALL = "help_all"


def _show_all(context: click.Context, option: click.Parameter, wanted: bool) -> None:
    if wanted and not context.resilient_parsing:
        context.meta[HELP_ALL] = True
        click.echo(context.get_help(), color=context.color)
        context.exit()


def _in_short(text: str) -> str:
    """Return the first sentence of the help of an option, and its notes in brackets."""
    return re.sub(r"(?<=\.) (?! ).*?(?=  \[|$)", "", text, count=1, flags=re.DOTALL)
