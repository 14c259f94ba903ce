"""Files at the root name commands, options and extras that exist, and the versions that are tested."""

import os
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.version import Version

import beltrami_cli
from beltrami_cli.cli.main import group
from beltrami_cli.cli.registry import COMMANDS
from requirements import requirements

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS = PROJECT["optional-dependencies"]
ALL = Requirement(*EXTRAS["all"]).extras


def options_of(command):
    return {name for option in group.get_command(None, command).params for name in option.opts}


def test_hooks_run_commands_that_exist():
    entries = re.findall(r"entry: (.*)", (ROOT / ".pre-commit-hooks.yaml").read_text(encoding="utf-8"))
    assert [shlex.split(entry)[0] for entry in entries] == ["beltrami"] * len(entries)
    assert {shlex.split(entry)[1] for entry in entries} == {"check", "compare"}
    assert {"check", "compare"} <= set(COMMANDS)


def test_the_action_uses_options_that_exist():
    text = (ROOT / "action.yml").read_text(encoding="utf-8")
    named = set(re.findall(r"(?<=\s)--(?:junit|overwrite|min-[\w-]+|max-[\w-]+)", text))
    assert named <= options_of("compare")


def test_the_image_installs_extras_that_exist():
    (extras,) = re.findall(r"/source\[(.*?)\]", (ROOT / "Dockerfile").read_text(encoding="utf-8"))
    assert {*extras.split(",")} <= {*EXTRAS}


def test_lower_bounds_are_the_versions_that_are_tested_as_the_oldest():
    lines = (ROOT / "tests" / "minimum-versions.txt").read_text(encoding="utf-8").splitlines()
    pinned = dict(line.split("==") for line in lines if not line.startswith("#"))
    needed = [*PROJECT["dependencies"], *(text for name in ALL for text in EXTRAS[name])]
    requirements = [Requirement(text) for text in needed]
    bounds = {each.name: specifier for each in requirements for specifier in each.specifier}
    assert {specifier.operator for specifier in bounds.values()} == {">="}
    assert {name: Version(each.version) for name, each in bounds.items()} == {
        name: Version(version) for name, version in pinned.items()
    }


def test_environments_get_what_the_extras_of_an_extra_need():
    needed = {*requirements(PROJECT, "fuzz")}
    assert {*EXTRAS["textures"], *PROJECT["dependencies"], "pytest>=8.2", "atheris>=2.3"} <= needed
    assert not any(line.startswith(PROJECT["name"]) for line in needed)


def test_extras_that_messages_name_are_there_and_in_all():
    sources = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "beltrami_cli").rglob("*.py"))
    named = set(re.findall(r"beltrami-cli\[(\w+)\]", sources))
    assert len(named) >= 5
    assert named <= ALL <= set(EXTRAS)


@pytest.mark.skipif(sys.platform == "win32", reason="make is not there")
@pytest.mark.parametrize(
    ("name", "called"), [("beltrami", "beltrami"), ("python3", "python3 -P -m beltrami_cli")]
)
def test_the_demo_takes_what_is_installed(name, called, tmp_path):
    (tmp_path / name).write_text("#!/bin/sh\n")
    (tmp_path / name).chmod(0o700)
    path = os.pathsep.join([str(tmp_path), *os.defpath.split(os.pathsep)])
    demo = subprocess.run(
        ["make", "-n", "demo", f"PYTHON={tmp_path}/python3"],
        cwd=ROOT,
        env={**os.environ, "PATH": path},
        capture_output=True,
        text=True,
        check=True,
    )
    assert f"{tmp_path}/{called} render" in demo.stdout
    assert "pip" not in demo.stdout


@pytest.mark.parametrize("name", beltrami_cli.__all__)
def test_every_public_name_has_its_module(name):
    assert getattr(beltrami_cli, name).__name__ == name


def test_one_header_of_the_core_depends_on_the_compiler():
    """Apart from the question which instruction sets the processor has, which others do not have to answer."""
    extensions = re.compile(
        r"__builtin|__attribute__|\bgnu::|__GNUC__|__clang__|_MSC_VER|\b_mm|\b__m\d|__SSE|__AVX"
    )
    sources = (ROOT / "beltrami_cli" / "native").rglob("*.?pp")
    depend = {each.name for each in sources if extensions.search(each.read_text(encoding="utf-8"))}
    assert depend == {"lanes.hpp", "instruction_set.cpp"}
