"""Completion in shells: what click's scripts ask the command for, which docs/configuration.md has shells load."""

import os
import re
import select
import shutil
import signal
import sys
import time
from pathlib import Path

import click
import pytest

from beltrami_cli.cli.registry import COMMANDS
from cli.commands import beltrami, command

pty = pytest.importorskip("pty", reason="shells have no terminal here")

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


@pytest.mark.parametrize("name", sorted({*COMMANDS} - {"docs", "config"}))
def test_every_argument_and_option_that_names_files_completes_them(name):
    named = [
        each
        for each in command(name).params
        if isinstance(each, click.Argument) or "FILE" in (each.metavar or "")
    ]
    assert all(
        "file" in {item.type for item in each.shell_complete(click.Context(command(name)), "a")}
        for each in named
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "typed", ["beltrami smooth head-nois", "beltrami smooth a.ply b.ply --report head-nois"]
)
@pytest.mark.parametrize(("shell", "start"), [("bash", "--norc"), ("zsh", "-f"), ("fish", "--no-config")])
def test_a_shell_completes_file_names(shell, start, typed, tmp_path):
    """In a real one: what documented line it loads, Tab after the beginning of a name, and what it then prints."""
    if shutil.which(shell) is None:
        pytest.skip(f"{shell} is not installed")
    (tmp_path / "head-noisy.ply").touch()
    loads = {"zsh": "autoload -U compinit; compinit -u; ", "bash": "", "fish": ""}[shell]
    line = re.search(rf"`([^`]*_BELTRAMI_COMPLETE={shell}_source[^`]*)`", PAGE.read_text(encoding="utf-8"))[1]
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    pid, terminal = pty.fork()
    if pid == 0:
        os.chdir(tmp_path)
        os.execvpe(
            shell, [shell, start, "-i"], {"PATH": path, "TERM": "dumb", "HOME": str(tmp_path), "PS1": "> "}
        )
    try:
        said = b""
        for text, wait in (
            (f"{loads}{line}\n", b""),
            ("echo rea''dy\n", b"ready"),
            (f"{typed}\t", b"head-noisy.ply"),
        ):
            os.write(terminal, text.encode())
            said, end = b"", time.monotonic() + 20
            while wait not in said and time.monotonic() < end:
                if select.select([terminal], [], [], 0.2)[0]:
                    said += os.read(terminal, 65536)
        assert b"head-noisy.ply" in said, said
    finally:
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
        os.close(terminal)


@pytest.mark.parametrize("shell", SHELLS)
def test_the_script_of_a_shell_asks_the_command(shell):
    script = beltrami(env={"_BELTRAMI_COMPLETE": f"{shell}_source"}, text=True).stdout
    assert f"_BELTRAMI_COMPLETE={shell}_complete" in script
