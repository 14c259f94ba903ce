"""Options from the fields of parameter records, and the records back from the values of options."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, TypeVar

import click
from click.core import ParameterSource
from click.shell_completion import CompletionItem

from beltrami_cli.cli.command import GroupedOption
from beltrami_cli.cli.option_names import variable_behind
from beltrami_cli.errors import UsageError
from beltrami_cli.fields import REQUIRED, Parameter, parameters, parts

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]
Record = TypeVar("Record")


class ParameterOption(GroupedOption):
    def __init__(self, *arguments: Any, declared: Parameter, **attributes: Any) -> None:
        super().__init__(*arguments, group="" if declared.is_daily else declared.group, **attributes)
        self.declared = declared


class _Value(click.ParamType):  # type: ignore[type-arg]  # generic only in newer versions
    """What the field of a parameter allows; text that it parses stays text, as configuration files have it."""

    def __init__(self, declared: Parameter) -> None:
        self._declared = declared
        # Errors name the option, which may be called otherwise than the field.
        self._named = dataclasses.replace(declared, name=declared.flag)
        self.name = {int: "integer", float: "float"}.get(declared.kind, "text")

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        return [CompletionItem(word) for word in self._declared.words if word.startswith(incomplete)]

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the value, or its text; UsageError if it is out of its range."""
        declared = self._declared
        kind: Any = {int: click.INT, float: click.FLOAT}.get(declared.kind, click.STRING)
        try:
            made = kind.convert(value, param, ctx) if declared.parse is None else parsed(declared, str(value))
            self._named.check((made,) if declared.repeatable else made)
        except UsageError as error:
            variable = variable_behind(param, ctx)
            origin = f" (from the environment: {variable})" if variable else ""
            raise UsageError(f"{error}{origin}") from None
        return made if declared.parse is None else str(value)


def options_of(
    record: type,
    only: Collection[str] | None = None,
    without: Collection[str] = (),
    changed: Mapping[str, Mapping[str, Any]] | None = None,
) -> Decorator:
    """Return a decorator that adds the options of a record; `changed`: attributes of parameters that differ."""
    chosen = [
        dataclasses.replace(each, **(changed or {}).get(each.name, {}))
        for each in parameters(record, deep=True)
        if each.flags and (only is None or each.name in only) and each.name not in without
    ]
    return adding(chosen)


def adding(parameters: Sequence[Parameter]) -> Decorator:

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        for declared in reversed(parameters):
            command = _option_of(declared)(command)
        return command

    return decorate


def _option_of(declared: Parameter) -> Decorator:
    attributes: dict[str, Any] = {}
    if declared.kind is bool:
        attributes = {"is_flag": True, "default": declared.default}
    elif declared.choices and declared.parse is None:
        attributes = {"type": click.Choice(declared.choices)}
    else:
        attributes = {"type": _Value(declared), "metavar": declared.metavar}
    if declared.repeatable:
        attributes["multiple"] = True
    elif declared.default is REQUIRED:
        attributes["required"] = True
    elif not declared.unset and declared.default is not None:
        attributes["default"] = declared.show(declared.default) if declared.parse else declared.default
    return click.option(
        *declared.flags, cls=ParameterOption, declared=declared, help=_help(declared), **attributes
    )


def _help(declared: Parameter) -> str:
    notes = [f"in {declared.unit}"] if declared.unit else []
    if declared.default_in_words:
        notes.append(f"default: {declared.default_in_words}")
    if declared.kind in (int, float) and (declared.low, declared.high) != (None, None):
        notes.append(declared.range)
    return f"{declared.help}  [{'; '.join(notes)}]" if notes else declared.help


def record_from(record: type[Record], values: Mapping[str, Any], **made: Any) -> Record:
    """Make a record from the values of its options; other fields have their defaults."""
    nested: dict[str, Any] = {
        name: record_from(kind, values) for name, kind in parts(record).items() if name not in made
    }
    return record(**{**values_given_to(record, values), **nested, **made})


def values_given_to(record: type, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of the parameters of a record, by their names, that options have a value for."""
    given = ((each, values.get(destination(each))) for each in parameters(record))
    return {
        each.name: tuple(parsed(each, text) for text in value) if each.repeatable else parsed(each, value)
        for each, value in given
        if value not in (None, ())
    }


def parsed(declared: Parameter, text: str) -> Any:
    if declared.parse is None:
        return text
    try:
        return declared.parse(text)
    except ValueError as error:
        raise UsageError(f"{declared.flag} {error}") from None


def destination(declared: Parameter) -> str:
    """Return the name that click has for the option of a parameter; empty if there is none."""
    last = declared.flags[-1] if declared.flags else ""
    return next(
        filter(str.isidentifier, declared.flags), last.partition("/")[0].lstrip("-").replace("-", "_")
    )


def typed_parameters() -> list[Parameter]:
    """Return the parameters whose options stand on the command line."""
    context = click.get_current_context()
    return [
        option.declared
        for option in context.command.params
        if isinstance(option, ParameterOption)
        and context.get_parameter_source(str(option.name)) is ParameterSource.COMMANDLINE
    ]


def refuse_typed(record: type, why: str) -> None:
    """Raise UsageError if an option of a record stands on the command line, where it has no effect."""
    for each in typed_parameters():
        if each.group == getattr(record, "group", ""):
            raise UsageError(f"{each.flag} is {why}")
