"""Options are the fields of the parameter records: the same defaults, ranges and refusals; and the last resort."""

import math
import os
from functools import partial

import pytest

from beltrami_cli.cli import options
from beltrami_cli.cli.parameter_options import ParameterOption, record_from
from beltrami_cli.errors import UsageError
from beltrami_cli.fields import override, parameters
from beltrami_cli.jobs.settings import BakeSettings, Limits, NoiseSettings
from beltrami_cli.layers.settings import DEFAULTS, SmoothSettings
from beltrami_cli.view.settings import RenderSettings
from cli.commands import SAMPLES, beltrami, command, run_command

NOISY = SAMPLES / "terrain-noisy.ply"
RECORDS = {
    "smooth": DEFAULTS, "bake": BakeSettings(), "render": RenderSettings(), "noise": NoiseSettings(0.1),
    "compare": Limits(),
}  # fmt: skip
PARAMETERS = [
    pytest.param(name, each, id=f"{name}-{each.name}")
    for name, record in RECORDS.items()
    for each in parameters(record, deep=True)
]
ARGUMENTS = {"smooth": ["a", "b"], "bake": ["a", "b", "--to", "texture"], "noise": ["a", "b", "--sigma", "9"]}


def values_of(name, *arguments):
    """The values of a command's options, and the context in which they were found."""
    return command(name).make_context(name, [*ARGUMENTS.get(name, ["a", "b"]), *arguments])


@pytest.mark.parametrize("option", ["--slots", "--channels", "--metric-channels"])
def test_of_a_list_in_parts_none_is_dropped(option):
    with pytest.raises(UsageError, match=f"{option} is given 2 times; give one list, with commas"):
        values_of("smooth", option, "normal", f"{option}=emissive")
    others = ("--beta", "2", "--beta", "3", "--guide", "a", "--guide", "b")
    values_of("smooth", option, "normal,emissive", *others)


def option_for(name, declared):
    of_parameters = (each for each in command(name).params if isinstance(each, ParameterOption))
    return next((each for each in of_parameters if each.declared.name == declared.name), None)


def beyond(declared):
    """Numbers just outside the range of a parameter, and texts that are not numbers."""
    outside = [math.nan, math.inf] if declared.kind is float else []
    if declared.low is not None:
        outside.append(declared.low if declared.is_open else declared.low - 1)
    if declared.high is not None:
        outside.append(declared.high if declared.is_open else declared.high + 1)
    return [*outside, 4] if declared.is_odd else outside


@pytest.mark.parametrize(("name", "declared"), PARAMETERS)
def test_every_parameter_is_an_option_with_its_help_and_range(name, declared):
    option = option_for(name, declared)
    if not declared.flags:
        assert option is None
        return
    assert declared.help in option.help
    if declared.kind in (int, float) and (declared.low, declared.high) != (None, None):
        assert declared.range in option.help


@pytest.mark.parametrize(
    "declared", [each for each in parameters(SmoothSettings, deep=True) if "FILE" in (each.metavar or "")],
    ids=lambda each: each.name,
)  # fmt: skip
def test_files_that_parameters_name_are_guarded_and_named_by_users_only(declared, tmp_path):
    path = tmp_path / "named.npy"
    path.touch()
    settings = override(DEFAULTS, **{declared.name: (str(path),) if declared.several else str(path)})
    assert settings.input_files() == [str(path)]
    assert settings.input_files(str(path)) == []
    assert declared.is_deliberate(str(path))


@pytest.mark.parametrize("record", [SmoothSettings, BakeSettings, RenderSettings, Limits])
def test_options_that_are_not_given_make_the_record_as_it_is_by_default(record):
    name = next(name for name, made in RECORDS.items() if isinstance(made, record))
    make = options.settings_from if record is SmoothSettings else partial(record_from, record)
    context = values_of(name)
    with context.scope():
        assert make(context.params) == record()


@pytest.mark.parametrize(("name", "declared"), [each for each in PARAMETERS if beyond(each.values[1])])
def test_what_is_out_of_range_is_refused_as_an_option_and_as_a_keyword_in_the_same_words(name, declared):
    option = option_for(name, declared)
    if declared.is_odd:
        for bound in (declared.low, declared.high):
            override(RECORDS[name], **{declared.name: bound})
    for value in beyond(declared):
        wanted = (value,) if declared.several else value
        with pytest.raises(UsageError, match=rf"{declared.name} is .*, but must be") as refused:
            override(RECORDS[name], **{declared.name: wanted})
        if declared.parse is None:
            with pytest.raises(UsageError) as typed:
                values_of(name, f"{option.opts[-1]}={value}")
            flag = next(each for each in option.opts if each.startswith("--"))
            assert str(typed.value).startswith((f"{flag} is", f"one of {flag} is"))
            assert str(typed.value).partition(" must ")[2] == str(refused.value).partition(" must ")[2]


@pytest.mark.parametrize(("name", "declared"), PARAMETERS)
def test_what_is_of_another_type_or_no_choice_is_refused(name, declared):
    wrong = ["much"] if declared.kind in (int, float, bool) else [3, *(["pink"] if declared.choices else [])]
    wrong += [2.5] if declared.kind is int else []
    for value in wrong:
        with pytest.raises(UsageError, match=f"{declared.name} is "):
            override(RECORDS[name], **{declared.name: (value,) if declared.several else value})


def test_overrides_reach_the_records_within_and_leave_the_rest_to_be_chosen():
    settings = override(DEFAULTS, t=3.0, slots=("normal",), space="linear")
    assert (settings.kernel.t, settings.textures.slots, settings.space) == (3.0, ("normal",), "linear")
    assert set(DEFAULTS.kernel.free) - set(settings.kernel.free) == {"t"}
    with pytest.raises(UsageError, match="height is of type list, but must be text"):
        override(DEFAULTS, height=[[1.0, 2.0]])
    with pytest.raises(UsageError, match="slots is of type str, but must be a tuple"):
        override(DEFAULTS, slots="normal")
    with pytest.raises(UsageError, match="no parameter iteration; did you mean iterations"):
        override(DEFAULTS, iteration=3)


@pytest.mark.slow
@pytest.mark.parametrize(("flags", "traceback"), [(["-v"], False), (["-v", "--verbose"], True)])
def test_an_unexpected_error_ends_in_one_line_and_the_traceback_on_demand(flags, traceback, tmp_path):
    words = ("smooth", SAMPLES / "mirrored-noisy.obj", tmp_path / "out.obj", *flags)
    run = run_command(*words, env={**os.environ, "BELTRAMI_SIMD": "foo"})
    assert run.returncode == 1
    *before, last = run.stderr.decode().splitlines()
    assert last.startswith("beltrami: unexpected error: ")
    assert last.endswith("run again with -vv and report it")
    assert ("Traceback" in "\n".join(before)) == traceback


def test_no_iterations_say_that_the_file_was_copied(tmp_path):
    copied = beltrami("smooth", NOISY, tmp_path / "out.ply", "-n", "0")
    assert b"copied unchanged" in copied.stderr
    converted = beltrami("smooth", NOISY, tmp_path / "out.obj", "-n", "0")
    assert b"copied" not in converted.stderr
    assert b"colours are unchanged" in converted.stderr
