"""Completion in shells: what click's scripts ask the command for, which docs/configuration.md has shells load."""

import re
from pathlib import Path

import pytest

from cli.commands import beltrami

PAGE = Path(__file__).parents[2] / "docs" / "configuration.md"
SHELLS = re.findall(r"_BELTRAMI_COMPLETE=(\w+)_source beltrami", PAGE.read_text(encoding="utf-8"))


@pytest.mark.parametrize("shell", SHELLS)
@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("sm", "smooth"), ("smooth --beta-g", "--beta-growth"), ("smooth --weights u", "uniform"),
        ("smooth --strength g", "gentle"), ], ids=["command", "option", "value", "word or number"],
)  # fmt: skip
def test_shells_complete_what_is_typed(shell, typed, offered):
    last = typed.split()[-1] if shell == "fish" else len(typed.split())
    asked = {"COMP_WORDS": f"beltrami {typed}", "COMP_CWORD": last}
    answer = beltrami(env={"_BELTRAMI_COMPLETE": f"{shell}_complete", **asked}, text=True).stdout
    assert offered in answer
    assert len(re.findall(r"^plain\b", answer, re.MULTILINE)) == 1  # to other kinds shells add files


@pytest.mark.parametrize("shell", SHELLS)
def test_the_script_of_a_shell_asks_the_command(shell):
    script = beltrami(env={"_BELTRAMI_COMPLETE": f"{shell}_source"}, text=True).stdout
    assert f"_BELTRAMI_COMPLETE={shell}_complete" in script
