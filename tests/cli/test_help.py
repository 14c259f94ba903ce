"""--help shows what matters daily and names the rest, --help-all shows every option under its group."""

import re
import subprocess
import sys
from importlib.metadata import version

import click
import pytest

from beltrami_cli.cli.command import DEFAULT_GROUP
from beltrami_cli.cli.main import group
from beltrami_cli.cli.option_names import options_by_name, values_for
from beltrami_cli.cli.registry import COMMANDS
from cli.commands import SAMPLES, beltrami, command


def shown(*arguments):
    run = beltrami(*arguments, env={"COLUMNS": 80}, text=True)
    return run.stdout


def groups_of(name):
    return command(name).option_groups(click.Context(command(name), info_name=name))


def listed(text, option):
    return re.search(rf"^  (-\w, )?{max(option.opts, key=len)}\b", text, re.MULTILINE) is not None


LONG = [name for name in COMMANDS if len(groups_of(name)) > 1]


def test_summaries_fit_a_line_of_80_columns():
    lines = shown("--help").splitlines()
    for name, summary in COMMANDS.items():
        (line,) = [each for each in lines if each.startswith(f"  {name} ")]
        assert line.endswith(summary)
        assert len(line) <= 80
        assert not summary.endswith("..")


# Each takes as long to be imported as some iterations on five thousand vertices.
LIBRARIES = {"jinja2", "scipy", "OpenImageIO", "rich", "trimesh", "xatlas"}


@pytest.mark.parametrize(
    ("words", "needless"),
    [
        (["--help"], {*LIBRARIES, "numpy", *(f"beltrami_cli.cli.commands.{name}" for name in COMMANDS)}),
        (["bake", "--help"], {*LIBRARIES, "numpy", "beltrami_cli._native"}),
        (["smooth", "--help"], {*LIBRARIES, "numpy", "beltrami_cli._native"}),
        pytest.param(
            ["smooth", str(SAMPLES / "knot-noisy.ply"), "clean.ply"], LIBRARIES, marks=pytest.mark.slow
        ),
        pytest.param(
            ["smooth", str(SAMPLES / "mirrored-noisy.obj"), "clean.obj"],
            {"scipy", "numpy.f2py"},
            marks=pytest.mark.slow,
        ),
    ],
    ids=lambda words: " ".join(words[:2]) if isinstance(words, list) else "",
)
def test_no_command_loads_what_it_does_not_need(words, needless, tmp_path):
    run = f"import sys; from beltrami_cli.cli.main import group; group.main({words!r}, standalone_mode=False)"
    check = f"{run}; found = {needless!r} & set(sys.modules); assert not found, found"
    program = [sys.executable, "-P", "-c", check]
    ended = subprocess.run(program, cwd=tmp_path, capture_output=True, check=False)
    assert ended.returncode == 0, ended.stderr
    assert words[-1] == "--help" or (tmp_path / words[-1]).exists()


@pytest.mark.parametrize("name", COMMANDS)
def test_help_describes_oklab_only_where_it_can_be_chosen(name):
    for option in command(name).params:
        if option.name == "space":
            assert ("Oklab" in option.help) == ("oklab" in option.type.choices)


@pytest.mark.parametrize("name", LONG)
def test_help_shows_what_matters_daily_and_names_the_other_groups(name):
    text = shown(name, "--help")
    for title, options in groups_of(name).items():
        assert [each.name for each in options if listed(text, each) != (title == DEFAULT_GROUP)] == []
        assert title == DEFAULT_GROUP or title.lower() in " ".join(text.split())
    assert "--help-all" in text
    assert len(text.splitlines()) <= (75 if name in ("batch", "sweep") else 60)


def test_the_help_of_smooth_begins_with_what_needs_no_knowledge_of_the_method():
    first = re.findall(r"^  (?:-\w, )?(--[\w-]+)", shown("smooth", "--help"), re.MULTILINE)[:6]
    assert first == ["--strength", "--noise", "--fast", "--iterations", "--time-step", "--beta"]


@pytest.mark.parametrize("name", COMMANDS)
def test_examples_take_no_option_that_the_help_does_not_list(name):
    text, _, examples = shown(name, "--help").partition("Examples:")
    calls = [
        line.partition(" #")[0]
        for line in examples.splitlines()
        if line.strip().startswith(f"beltrami {name}")
    ]
    assert calls
    options = {option for call in calls for option in re.findall(r"(?<= )--?[a-z][\w-]*", call)}
    assert [each for each in options if not re.search(rf"^  (-\w, )?{each}\b", text, re.MULTILINE)] == []


@pytest.mark.parametrize("name", COMMANDS)
def test_help_all_shows_every_option_below_its_group(name):
    text = shown(name, "--help-all")
    assert text == shown(name, "--help") or name in LONG
    for title, options in groups_of(name).items():
        section = re.search(rf"^{title}:\n((?:  .*\n|\n(?=  -))*)", text, re.MULTILINE)[1]
        assert [each.name for each in options if not (each.hidden or listed(section, each))] == []


def test_the_version_is_that_of_the_package_and_has_a_letter():
    assert shown("-V") == shown("--version")
    assert version("beltrami-cli") in shown("-V")


def test_the_american_spelling_of_colour_is_understood_everywhere_and_documented_nowhere(tmp_path):
    option = command("smooth").make_context("smooth", ["a", "b"], parent=click.Context(group))
    assert option.params["colours"] is None
    parent = click.Context(group, token_normalize_func=group.context_settings["token_normalize_func"])
    typed = command("smooth").make_context("smooth", ["a", "b", "--colors", "c.ply"], parent=parent)
    assert typed.params["colours"] == "c.ply"
    assert values_for(options_by_name(command("smooth")), {"colors": "c.ply"}) == {"colours": "c.ply"}
    (tmp_path / "own.toml").write_text('[smooth]\ncolors = "c.ply"\n')
    assert 'colours = "c.ply"' in shown("--config", str(tmp_path / "own.toml"), "config", "smooth")
    run = beltrami("config", "smooth", env={"BELTRAMI_SMOOTH_COLORS": "d.ply"}, text=True)
    assert 'colours = "d.ply"  # BELTRAMI_SMOOTH_COLORS' in run.stdout
    assert "color" not in shown("smooth", "--help-all").replace("baseColor", "").replace("COLOR_0", "")
