"""Commands that take a while say how far they are, on a terminal only, and on the standard error."""

import contextlib
import os
import pickle
import re
import subprocess
import sys
from contextlib import contextmanager

import pytest

from beltrami_cli.batch.item import Attempt, Outcome
from beltrami_cli.cli.commands.batch import Display
from beltrami_cli.cli.console import Messages
from beltrami_cli.jobs.job import Job
from beltrami_cli.jobs.progress import Label, Share, Work, phase_of
from beltrami_cli.jobs.smooth import smooth_file
from cli.commands import COMMAND, SAMPLES, beltrami

NOISY, CLEAN = SAMPLES / "head-tex-noisy.glb", SAMPLES / "head-tex-clean.glb"
SMALL = SAMPLES / "nonmanifold-noisy.ply"
COMMANDS = {
    "info": (["info", NOISY], {"reading", "laying out", "choosing parameters"}),
    "infos": (["info", SMALL, NOISY, "--fast"], {"files"}),
    "batch": (["batch", SMALL, "--out-dir", ".", "-j", "1", "--fast"], {"files"}),
    "smooth": (["smooth", NOISY, "x.glb"], {"reading", "laying out", "choosing parameters", "smoothing", "writing"}),
    "noise": (["noise", SMALL, "x.ply", "--sigma", "5"], {"reading", "laying out", "writing"}),
    "compare": (["compare", NOISY, CLEAN], {"reading", "comparing", "measuring"}),
    "report": (["report", NOISY, CLEAN, "page.html"], {"comparing", "counting changes", "drawing seams"}),
    "render": (["render", SMALL, SMALL, "x.png", "--size", "40"], {"reading", "drawing"}),
    "sweep": (["sweep", SMALL, "x.png", "--size", "40", "-n", "1,2", "--fast"], {"trials"}),
}  # fmt: skip


@pytest.fixture
def shown(monkeypatch):
    """What the bar would show, as (label, share), after each report."""
    states = []

    @contextmanager
    def progress(messages, *_):
        yield Share(forward=lambda label, done, total: states.append((label, done / total)))

    monkeypatch.setattr(Messages, "progress", progress)
    return states


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_the_bar_goes_from_nothing_to_all_and_never_back(name, shown, tmp_path):
    arguments, labels = COMMANDS[name]
    if name in ("render", "sweep"):
        pytest.importorskip("embreex")
    beltrami(*arguments, cwd=tmp_path)
    assert labels <= {phase_of(label) for label, _ in shown}
    shares = [share for _, share in shown]
    assert shares == sorted(shares)
    assert shares[0] < 0.1
    assert shares[-1] <= 1


class Simulated:
    """A job whose phases take given times of a clock that only it moves."""

    def __init__(self, factor, monkeypatch):
        self.now, self.factor = 0.0, factor
        monkeypatch.setattr("time.process_time", lambda: self.now)
        self.work = Work()
        self.shares = []

    def run(self, phases, reports):
        """Work for the times of phases, with so many reports each; note ten times a second what the bar shows."""
        self.work("reading", 0, 1)
        self._pass(0.5)
        self.work.expect(phases)
        for name, seconds in phases:
            for number in range(reports):
                self.work(name, number, reports)
                self._pass(self.factor * seconds / reports)
        self.work(phases[-1][0], 1, 1)
        self._pass(0.1)

    def _pass(self, seconds):
        for _ in range(round(10 * seconds)):
            self.now += 0.1
            self.shares.append(self.work.share())


@pytest.mark.parametrize("factor", [0.5, 1, 2, 4])
@pytest.mark.parametrize("reports", [1, 7, 100])
def test_the_bar_moves_steadily_whatever_phases_say_and_take(factor, reports, monkeypatch):
    phases = [("laying out", 6.0), ("choosing parameters", 20.0), ("smoothing", 40.0), ("writing", 8.0)]
    job = Simulated(factor, monkeypatch)
    job.run(phases, reports)
    assert job.shares == sorted(job.shares)
    assert job.shares[9] > 0  # a second after the start
    # It never stands for 3 seconds, in tenths of per cent where the job takes four times as long as expected.
    assert all(later > before + 1e-4 for before, later in zip(job.shares, job.shares[30:], strict=False))
    assert job.shares[-1] == pytest.approx(1, abs=0.05)


@pytest.mark.parametrize(
    "label", ["laying out", Label("2 of 3 files", "files"), Label("a: b: smoothing", "smoothing")]
)
def test_labels_show_what_they_say_and_keep_their_phase_on_the_way_to_another_process(label):
    sent = pickle.loads(pickle.dumps(label))
    assert (str(sent), phase_of(sent)) == (label, phase_of(label))


def test_a_file_named_like_a_count_is_part_of_its_phase():
    work = Work()
    work.expect([("smoothing", 1.0), ("writing", 1.0)])
    work(Label("3 of 4 : writing: smoothing", "smoothing"), 1, 2)
    assert work.share() == pytest.approx(0.25, abs=0.1)


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
        if not label.endswith(": choosing parameters"):
            return
        shares.append(done / total)
        if len(shares) == 5:
            raise StopError

    with pytest.raises(StopError):
        smooth_file(SAMPLES / name, target, job=Job(progress=stop))
    assert shares[0] == 0
    assert shares == sorted(set(shares))
    assert shares[-1] < 1
    assert list(tmp_path.iterdir()) == []


def test_a_batch_counts_files_that_are_finished_and_is_at_100_per_cent_only_then():
    items, shown = [None] * 5, []
    display = Display(
        items,
        Messages(quiet=True, verbose=0),
        Share(forward=lambda label, done, _: shown.append((label, done))),
    )
    for key in range(5):
        display.advanced(key, "writing", 1000, 1000)
    assert shown[-1][0] == "0 of 5 files"
    for key in range(5):
        assert shown[-1][1] < 1
        display.finished(key, Attempt(Outcome("a.ply", "b.ply", "done")))
    assert shown[-1] == ("5 of 5 files", 1)


def on_a_terminal(*arguments, cwd):
    """Run a command whose standard error is a terminal; return its exit code, and what is drawn and printed."""
    import pty

    ours, theirs = pty.openpty()
    command = [*COMMAND, *map(str, arguments)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=theirs, cwd=cwd) as run:
        os.close(theirs)
        drawn = bytearray()
        with contextlib.suppress(OSError):  # as Linux reports the end
            while part := os.read(ours, 1 << 16):
                drawn += part
        printed = run.stdout.read().decode()
    os.close(ours)
    return run.returncode, drawn.decode(), printed


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="there are no pseudo terminals")
def test_messages_stand_in_lines_of_their_own_while_a_bar_is_drawn(tmp_path):
    for name in "abc":
        (tmp_path / f"{name}.ply").write_text("ply\n")
    _, drawn, _ = on_a_terminal("batch", ".", "--out-dir", "out", "-j", 1, cwd=tmp_path)
    lines = [re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", line) for line in re.split(r"[\r\n]+", drawn)]
    assert sum(line.startswith("failed: ") for line in lines) == 3
    assert not any("failed: " in line[1:] for line in lines)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="there are no pseudo terminals")
def test_on_a_terminal_one_bar_shows_per_cent_and_is_gone_in_the_end(tmp_path):
    code, shown, printed = on_a_terminal("info", SMALL, cwd=tmp_path)
    assert code == 0
    assert re.search(r"reading|choosing parameters", shown)
    assert "%" in shown
    assert "\x1b" not in printed
    assert shown.rstrip().endswith("\x1b[2K")  # the line is cleared
