"""Completion in shells: the lines of docs/configuration.md make them complete commands, options and values."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess

import pytest

from cli.commands import COMMAND

# What zsh and bash are to show is taken from the functions that complete; fish prints it.
BASH = """
eval "$(_BELTRAMI_COMPLETE=bash_source beltrami)"
complete -p beltrami > /dev/null || exit 1
COMP_WORDS=({words}) COMP_CWORD={last}
_beltrami_completion beltrami
printf '%s\\n' "${{COMPREPLY[@]}}"
"""
ZSH = """
autoload -Uz compinit && compinit -u -D
eval "$(_BELTRAMI_COMPLETE=zsh_source beltrami)"
[[ $_comps[beltrami] == _beltrami_completion ]] || exit 1
compadd() {{ print -l -- $completions }}
_describe() {{ print -l -- ${{completions_with_descriptions%%:*}} }}
words=({words}) CURRENT={last_from_one}
_beltrami_completion
"""
FISH = """
_BELTRAMI_COMPLETE=fish_source beltrami | source
complete -C {line} | string replace -r '\\t.*' '' ; true
"""
SCRIPTS = {"bash": BASH, "zsh": ZSH, "fish": FISH}


@pytest.mark.slow
@pytest.mark.parametrize("shell", SCRIPTS)
@pytest.mark.parametrize(
    ("words", "offered"),
    [
        (["beltrami", "sm"], {"smooth"}),
        (["beltrami", "smooth", "--beta-g"], {"--beta-growth"}),
        (["beltrami", "smooth", "--weights", "u"], {"uniform"}),
        (["beltrami", "smooth", "--strength", "g"], {"gentle"}),
    ],
    ids=["command", "option", "value", "word or number"],
)
def test_shells_complete_what_is_typed(shell, words, offered, tmp_path):
    if shutil.which(shell) is None:
        pytest.skip(f"there is no {shell}")
    script = tmp_path / "beltrami"
    script.write_text(f'#!/bin/sh\nexec {shlex.join(COMMAND)} "$@"\n')
    script.chmod(0o755)
    asked = SCRIPTS[shell].format(
        words=shlex.join(words),
        last=len(words) - 1,
        last_from_one=len(words),
        line=shlex.quote(" ".join(words)),
    )
    done = subprocess.run(
        [shell, "-c", asked], capture_output=True, check=False, timeout=60, cwd=tmp_path,
        env={**os.environ, "PATH": f"{tmp_path}{os.pathsep}{os.environ['PATH']}", "HOME": str(tmp_path)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr.decode()
    assert set(done.stdout.decode().split()) == offered
