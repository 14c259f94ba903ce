"""Options from the fields of parameter records, the records back from the options' values, and options of files."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import wraps
from typing import Any, TypeVar

import click
from click.core import ParameterSource
from click.shell_completion import CompletionItem

from beltrami_cli.cli.commands import GroupedOption, variable_behind
from beltrami_cli.cli.console import Messages
from beltrami_cli.errors import UsageError
from beltrami_cli.fields import REQUIRED, Parameter, parameters, parts, requiring_effect
from beltrami_cli.flow.parameters import PRESETS, KernelParameters, parameters_with
from beltrami_cli.formats.access import Access
from beltrami_cli.formats.registry import OUTPUT_FORMATS
from beltrami_cli.jobs.job import Job
from beltrami_cli.jobs.settings import BakeSettings
from beltrami_cli.layers.settings import IMAGE_FORMATS, SmoothSettings, TextureSettings, given_values
from beltrami_cli.surface.memory import default_memory, limited_memory

Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]

Record = TypeVar("Record")

# Where the value of an option can come from that is not its default.
_BY_DIRECTNESS = (ParameterSource.COMMANDLINE, ParameterSource.ENVIRONMENT, ParameterSource.DEFAULT_MAP)


class ParameterOption(GroupedOption):
    """An option made from the field of a parameter."""

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
    """Return a decorator that adds the options of parameters."""

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


def _given_to(record: type, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of the parameters of a record, by their names, that options have a value for."""
    given = ((each, values.get(_destination(each))) for each in parameters(record))
    return {
        each.name: tuple(parsed(each, text) for text in value) if each.repeatable else parsed(each, value)
        for each, value in given
        if value not in (None, ())
    }


def record_from(record: type[Record], values: Mapping[str, Any], **made: Any) -> Record:
    """Make a record from the values of its options; other fields have their defaults."""
    nested: dict[str, Any] = {
        name: record_from(kind, values) for name, kind in parts(record).items() if name not in made
    }
    return record(**{**_given_to(record, values), **nested, **made})


def parsed(declared: Parameter, text: str) -> Any:
    """Make the value of a parameter from the text of its option."""
    if declared.parse is None:
        return text
    try:
        return declared.parse(text)
    except ValueError as error:
        raise UsageError(f"{declared.flag} {error}") from None


def _destination(declared: Parameter) -> str:
    """Return the name that click has for the option of a parameter; empty if there is none."""
    last = declared.flags[-1] if declared.flags else ""
    return next(
        filter(str.isidentifier, declared.flags), last.partition("/")[0].lstrip("-").replace("-", "_")
    )


preset = click.option(
    "--preset", type=click.Choice(sorted(PRESETS)), cls=GroupedOption, group=KernelParameters.group,
    help="Parameters as a set, which single options still override. 'paper' is the paper's kernel to the letter: "
    "one iteration, t 0.5, threshold 0.01, a window of 7, on textures and images its parametric fast marching.",
)  # fmt: skip


def smoothing(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add all options that make up `SmoothSettings`."""
    return options_of(SmoothSettings)(preset(command))


SMOOTHING = ("preset", *filter(None, map(_destination, parameters(SmoothSettings, deep=True))))
"""The names that click has for the options that `smoothing` adds."""


def settings_from(values: Mapping[str, Any]) -> SmoothSettings:
    """Make the settings from the values of `preset` and options of `SmoothSettings`."""
    return record_from(SmoothSettings, values, kernel=_kernel_from(values))


def words_of(settings: SmoothSettings, preset: str | None = None) -> list[str]:
    """Return the options that `settings_from` makes such settings of, as they are typed."""
    usual: dict[str, Any] = dict(PRESETS[preset]) if preset else {}
    words, given = ["--preset", preset] if preset else [], given_values(settings)
    for record in (settings, *(getattr(settings, name) for name in parts(settings))):
        for declared in parameters(record):
            value, default = getattr(record, declared.name), usual.get(declared.name, declared.default)
            is_given = value != default if preset else declared.name in given
            if is_given and declared.flags:
                words += _typed(declared, value)
    return words


def _typed(declared: Parameter, value: Any) -> list[str]:
    flag = declared.flags[0].partition("/")[0]
    if declared.kind is bool:
        return [flag]
    if declared.repeatable:
        return [word for each in value for word in (flag, _in_short(each))]
    if declared.several:
        return [flag, ",".join(map(_in_short, value)) or "none"]
    return [flag, _in_short(value) if declared.parse is None else declared.show(value)]


def _in_short(value: Any) -> str:
    return str(int(value)) if isinstance(value, float) and value.is_integer() else str(value)


def _kernel_from(values: Mapping[str, Any]) -> KernelParameters:
    preset: dict[str, Any] = dict(PRESETS[values["preset"]]) if values["preset"] else {}
    found = _given_to(KernelParameters, values)
    given = preset | {name: found[name] for name in found if is_given(name) or name not in preset}
    if given["units"] == "world" and not is_given("t"):
        raise UsageError("--units world needs -t, in squared units of the file")
    fast = given.pop("fast", True)  # where nothing is written, trying would take longer than the rest
    return parameters_with(given, choose=not values["preset"], fast=fast)


def is_given(name: str) -> bool:
    """Whether an option was given at least as directly as a preset that it overrides."""
    context = click.get_current_context()
    source, preset_source = context.get_parameter_source(name), context.get_parameter_source("preset")
    if source not in _BY_DIRECTNESS:
        return False
    if name not in PRESETS.get(context.params.get("preset") or "", {}) or preset_source not in _BY_DIRECTNESS:
        return True
    return _BY_DIRECTNESS.index(source) <= _BY_DIRECTNESS.index(preset_source)


# Which colours are meant, and how they are written, for the commands that do not smooth them.
TEXTURES = ("threads", "space", "channels", "on", "slots", "materials", "names")
COLOURS = (*TEXTURES, "mask", "iso", "inside", "colours", "max_voxels")
ENCODING = ("gutter", "image_suffix", "jpeg_quality", "small")
# Averages alone can be taken in Oklab.
_SPACE_HELP = (
    "What colours are taken as: display values, linear light, or with data the stored numbers as they are."
)
SPACE_WITHOUT_OKLAB = {"space": {"choices": ("srgb", "linear", "data"), "help": _SPACE_HELP}}
COMPARED: dict[str, dict[str, Any]] = {
    **SPACE_WITHOUT_OKLAB,
    "weights": {"of": ("vertex colours", "textures")},  # samples of textures can count by their area, too
    "on": {"help": "The vertex colours, the textures, or both; auto takes what there is."},
    "slots": {"unset": "all that the files have"},
}


def compared_from(values: Mapping[str, Any]) -> SmoothSettings:
    """Make the settings of a comparison, of all slots if none are given."""
    made = {} if values["slots"] else {"slots": ()}
    return record_from(SmoothSettings, values, textures=record_from(TextureSettings, values, **made))


UNWRAPPING = ("unwrap", "texture_size", "max_unwrap_faces")
"""The names that click has for the options that `unwrapping` adds."""


def unwrapping(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of a new texture, which `unwrapping_from` takes."""
    wanted = click.option(
        "--unwrap", is_flag=True, cls=GroupedOption, group=BakeSettings.group,
        help="Lay the mesh out on a new texture, and put its smoothed colours there: for meshes without texture "
        "coordinates, or with hopeless ones. OUTPUT is then a new file with the triangles and the texture.",
    )  # fmt: skip
    changed = {"size": {"flags": ("--texture-size",)}}
    return wanted(options_of(BakeSettings, only=("size", "max_unwrap_faces"), changed=changed)(command))


def unwrapping_from(values: Mapping[str, Any]) -> BakeSettings | None:
    """Make the settings of a new texture; None: no new texture."""
    if values["unwrap"]:
        return record_from(BakeSettings, values, size=values["texture_size"])
    refuse_typed(BakeSettings, "of the new texture that --unwrap makes; add --unwrap")
    return None


overwrite = click.option(
    "--overwrite",
    is_flag=True,
    help="Replace OUTPUT and the files that it names.",
)
output_format = click.option(
    "--format", "output_format", type=click.Choice([*OUTPUT_FORMATS, *IMAGE_FORMATS]),
    cls=GroupedOption, group=Access.group,
    help="Format of OUTPUT where its name does not say it, as with -.",
)  # fmt: skip
as_json = click.option("--json", "as_json", is_flag=True, help="Print JSON on the standard output.")
quiet = click.option("-q", "--quiet", is_flag=True, help="Print nothing but errors.")
verbose = click.option("-v", "--verbose", count=True, help="Print details; twice: with tracebacks.")


def messages(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add -q and -v; the command gets the `Messages` that they make."""

    @wraps(command)
    def with_messages(*, quiet: bool, verbose: int, **given: Any) -> Any:
        messages = Messages(quiet=quiet, verbose=verbose)
        with messages.log_shown(work=verbose > 0 or given.get("dry_run", False)):
            return command(messages=messages, **given)

    return quiet(verbose(with_messages))


def writing(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of reading and replacing files, for `job_from`, and the options of `messages`."""
    return reading(overwrite(messages(command)))


reading = options_of(Access)
"""Adds all options that `reading_from` takes."""


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


@contextmanager
def reading_from(values: Mapping[str, Any], source: str, *, is_one: bool = True) -> Iterator[Access]:
    """Yield the access of a job, with limited memory; if `is_one`, all options must apply to this file."""
    access = record_from(Access, values)
    access = dataclasses.replace(access, memory=access.memory or default_memory())
    with limited_memory(access.memory, source), requiring_effect(typed_parameters() if is_one else []):
        yield access


@contextmanager
def job_from(values: Mapping[str, Any], source: str, messages: Messages) -> Iterator[Job]:
    """Yield the `Job` of the options that `reading`, `overwrite` and `output_format` add."""
    with reading_from(values, source) as access, messages.progress() as progress:
        yield Job(access, progress, values.get("overwrite", False), format=values.get("output_format"))


def _help(declared: Parameter) -> str:
    notes = [f"in {declared.unit}"] if declared.unit else []
    if declared.default_in_words:
        notes.append(f"default: {declared.default_in_words}")
    if declared.kind in (int, float) and (declared.low, declared.high) != (None, None):
        notes.append(declared.range)
    return f"{declared.help}  [{'; '.join(notes)}]" if notes else declared.help
