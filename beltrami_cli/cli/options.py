"""Options that several commands share, and what their values make: settings, access and jobs."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import wraps
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from beltrami_cli.cli.command import GroupedOption
from beltrami_cli.cli.console import Messages
from beltrami_cli.cli.parameter_options import (
    destination,
    options_of,
    record_from,
    refuse_typed,
    typed_parameters,
    values_given_to,
)
from beltrami_cli.errors import UsageError
from beltrami_cli.fields import parameters
from beltrami_cli.flow.parameters import PRESETS, KernelParameters, parameters_from
from beltrami_cli.formats.files.access import Access
from beltrami_cli.formats.registry import OUTPUT_FORMATS
from beltrami_cli.jobs.job import Job
from beltrami_cli.jobs.settings import BakeSettings
from beltrami_cli.layers.settings import IMAGE_FORMATS, SmoothSettings, TextureSettings
from beltrami_cli.surface.memory import default_memory, limited_memory

if TYPE_CHECKING:
    from beltrami_cli.jobs.writing.output import Overwrite

# Where the value of an option can come from that is not its default.
_BY_DIRECTNESS = (ParameterSource.COMMANDLINE, ParameterSource.ENVIRONMENT, ParameterSource.DEFAULT_MAP)

preset = click.option(
    "--preset", type=click.Choice(sorted(PRESETS)), cls=GroupedOption, group=KernelParameters.group,
    help="Parameters as a set, which single options still override. 'paper' is the paper's kernel to the letter: "
    "one iteration, t 0.5, threshold 0.01, a window of 7, on textures and images its parametric fast marching.",
)  # fmt: skip


def smoothing(command: Callable[..., Any]) -> Callable[..., Any]:
    return options_of(SmoothSettings)(preset(command))


SMOOTHING = ("preset", *filter(None, map(destination, parameters(SmoothSettings, deep=True))))
"""The names that click has for the options that `smoothing` adds."""


def settings_from(values: Mapping[str, Any]) -> SmoothSettings:
    return record_from(SmoothSettings, values, kernel=_kernel_from(values))


def _kernel_from(values: Mapping[str, Any]) -> KernelParameters:
    preset: dict[str, Any] = dict(PRESETS[values["preset"]]) if values["preset"] else {}
    found = values_given_to(KernelParameters, values)
    given = preset | {name: found[name] for name in found if is_given(name) or name not in preset}
    if given["units"] == "world" and not is_given("t"):
        raise UsageError("--units world needs -t, in squared units of the file")
    fast = given.pop("fast", True)  # where nothing is written, trying would take longer than the rest
    return parameters_from(given, choose=not values["preset"], fast=fast)


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


reading = options_of(Access)
"""Adds the options that `reading_from` takes."""


def writing(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of reading and replacing files, for `job_from`, and the options of `messages`."""
    return reading(overwrite(messages(command)))


@contextmanager
def reading_from(values: Mapping[str, Any], source: str, *, is_one: bool = True) -> Iterator[Access]:
    """Yield the access of a job, with limited memory; if `is_one`, all options must apply to this file."""
    access = record_from(Access, values)
    typed = tuple(typed_parameters()) if is_one else ()
    access = dataclasses.replace(access, memory=access.memory or default_memory(), typed=typed)
    with limited_memory(access.memory, source):
        yield access


@contextmanager
def job_from(values: Mapping[str, Any], source: str, messages: Messages) -> Iterator[Job]:
    """Yield the `Job` of the options that `reading`, `overwrite` and `output_format` add."""
    with reading_from(values, source) as access, messages.progress() as progress:
        yield Job(access, progress, values.get("overwrite", False), format=values.get("output_format"))


def overwrite_at(option: str, *, overwrite: bool) -> Overwrite:
    """Whether a file may be replaced: what this program did not write only if the command line itself says so."""
    sources = [click.get_current_context().get_parameter_source(name) for name in (option, "overwrite")]
    is_direct = all(source is ParameterSource.COMMANDLINE for source in sources)
    return "own" if overwrite and not is_direct else overwrite
