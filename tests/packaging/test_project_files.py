"""Files at the root that other services read: they name commands and options that exist."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import beltrami_cli
from beltrami_cli.cli.main import COMMANDS, group

ROOT = Path(__file__).parents[2]


def options_of(command):
    return {name for option in group.get_command(None, command).params for name in option.opts}


def test_hooks_run_commands_that_exist():
    entries = re.findall(r"entry: (.*)", (ROOT / ".pre-commit-hooks.yaml").read_text(encoding="utf-8"))
    assert [shlex.split(entry)[0] for entry in entries] == ["beltrami"] * len(entries)
    assert {shlex.split(entry)[1] for entry in entries} == {"check", "compare"}
    assert {"check", "compare"} <= set(COMMANDS)


def test_the_action_uses_options_that_exist():
    text = (ROOT / "action.yml").read_text(encoding="utf-8")
    assert set(re.findall(r"(?<=\s)--(?:junit|overwrite|min-[\w-]+|max-[\w-]+)", text)) <= options_of(
        "compare"
    )


def test_the_image_installs_extras_that_exist():
    (extras,) = re.findall(r"/source\[(.*?)\]", (ROOT / "Dockerfile").read_text(encoding="utf-8"))
    declared = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    assert all(re.search(rf"^{extra} = \[", declared, re.MULTILINE) for extra in extras.split(","))


def test_every_name_of_the_interface_is_where_the_package_looks_for_it():
    assert [name for name in beltrami_cli.__all__ if not hasattr(beltrami_cli, name)] == []
