"""Commands that take a while say how far they are, on a terminal only, and on the standard error."""

from __future__ import annotations

import re
from contextlib import contextmanager

import pytest

from beltrami_cli.cli.console import Messages
from beltrami_cli.jobs.job import Job
from beltrami_cli.jobs.smooth import smooth_file
from cli.commands import SAMPLES, beltrami

NOISY, CLEAN = SAMPLES / "head-tex-noisy.glb", SAMPLES / "head-tex-clean.glb"
SMALL = SAMPLES / "nonmanifold-noisy.ply"
COMMANDS = {
    "compare": (["compare", NOISY, CLEAN], {"reading", "comparing", "measuring"}),
    "report": (["report", NOISY, CLEAN, "page.html"], {"reading", "comparing", "drawing seams", "packing models"}),
    "render": (["render", SMALL, SMALL, "x.png", "--size", "40", "--turntable", "2"], {"reading", "drawing"}),
    "sweep": (["sweep", SMALL, "x.png", "--size", "40", "-n", "1,2", "--fast"], {"trials", "drawing"}),
}  # fmt: skip


@pytest.fixture
def shown(monkeypatch):
    """What bars would show, as (label, done, total)."""
    calls = []

    @contextmanager
    def progress(messages):
        yield lambda *call: calls.append(call)

    monkeypatch.setattr(Messages, "progress", progress)
    return calls


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_bars_go_from_nothing_to_all(name, shown, tmp_path):
    arguments, labels = COMMANDS[name]
    if name in ("render", "sweep"):
        pytest.importorskip("embreex")
    beltrami(*arguments, cwd=tmp_path)
    assert labels <= {label for label, _, _ in shown}
    for label in labels:
        done = [share for each, share, _ in shown if each == label]
        total = max(whole for each, _, whole in shown if each == label)
        assert done[0] == 0
        assert done[-1] == total
        runs = done if name != "sweep" else done[: done.index(total) + 1]
        assert runs == sorted(runs)


def test_without_a_terminal_nothing_is_shown(tmp_path):
    run = beltrami("compare", SMALL, SMALL, cwd=tmp_path)
    assert run.stderr == b""


def test_other_programs_can_ask_for_lines(tmp_path, monkeypatch):
    monkeypatch.setenv("BELTRAMI_PROGRESS", "lines")
    run = beltrami("smooth", SMALL, "out.ply", "-q", "-n", "2", "--beta", "8", cwd=tmp_path)
    lines = run.stderr.decode().splitlines()
    assert lines
    assert all(re.fullmatch(r"progress: [^\n]+ \d+%", line) for line in lines)
    assert lines[-1].endswith(" 100%")
    assert len(lines) == len(set(lines))


@pytest.mark.parametrize("name", ["knot-noisy.ply", "scan-noisy.jpg"])
def test_the_choice_of_parameters_says_how_far_it_is_and_can_be_stopped(name, tmp_path):
    shares, target = [], tmp_path / f"out{name[-4:]}"

    class StopError(Exception):
        pass

    def stop(label, done, total):
        assert label.endswith(": choosing parameters")
        shares.append(done / total)
        if len(shares) == 5:
            raise StopError

    with pytest.raises(StopError):
        smooth_file(SAMPLES / name, target, job=Job(progress=stop))
    assert shares[0] == 0
    assert shares == sorted(set(shares))
    assert shares[-1] < 1
    assert list(tmp_path.iterdir()) == []
