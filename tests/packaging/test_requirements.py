"""What the package says that it needs agrees with what is tested, and with what is documented."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.version import Version

import beltrami_cli

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS = PROJECT["optional-dependencies"]
ALL = Requirement(*EXTRAS["all"]).extras


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


def test_extras_that_messages_name_are_there_and_in_all():
    sources = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "beltrami_cli").rglob("*.py"))
    named = set(re.findall(r"beltrami-cli\[(\w+)\]", sources))
    assert len(named) >= 5
    assert named <= ALL <= set(EXTRAS)


@pytest.mark.parametrize("name", beltrami_cli.__all__)
def test_every_public_name_has_its_module(name):
    assert getattr(beltrami_cli, name).__name__ == name
