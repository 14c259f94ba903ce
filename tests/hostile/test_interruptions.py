"""Whenever the command is ended, by Ctrl-C, by a signal or without warning, files are old or new, and whole."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from beltrami_cli.signals import signals_deferred
from cli.commands import beltrami
from formats.tile_files import tiled_model
from hostile.textured_models import OTHER, PICTURE, write_model


def folder_with_model(tmp_path):
    """An OBJ file with its texture in a folder, and what an earlier run may have left in another."""
    folder = tmp_path / "source"
    (folder / "out" / "maps").mkdir(parents=True)
    write_model(folder, "obj", "maps/skin.png", "maps.mtl")
    (folder / "maps").mkdir()
    (folder / "maps" / "skin.png").write_bytes(PICTURE)
    for name, content in {"result.obj": b"old", "maps.mtl": b"old", "maps/skin.png": OTHER}.items():
        (folder / "out" / name).write_bytes(content)
    (folder / "precious.txt").write_text("precious")
    return folder


TARGETS = ("out/result.obj", "new/result.obj")  # over what an earlier run left, and into an empty folder


@pytest.mark.slow
@pytest.mark.parametrize("name", ["SIGINT", "SIGKILL"])
@pytest.mark.parametrize("target", TARGETS)
def test_a_signal_at_any_step_that_touches_files(target, name, tmp_path):
    folder = folder_with_model(tmp_path)
    (folder / "new").mkdir()
    # A probe that comes and goes, and three or more files.
    assert ended_at_every_step(folder, getattr(signal, name), target) >= 7


# Up to 4 s: the command runs twice at each of some forty steps.
@pytest.mark.slow
@pytest.mark.parametrize(("kind", "has_links"), [("gltf", False), ("tiles", True)])
def test_a_run_after_one_that_was_killed_writes_the_same_files(kind, has_links, tmp_path, monkeypatch):
    if not has_links:  # on file systems where no file has two names
        monkeypatch.setenv("NO_LINKS", "1")
    folder = tmp_path / "source"
    if kind == "tiles":
        model = tiled_model(folder, size=1)
    else:
        model = write_model(folder, kind, "maps/skin.png")
        (folder / "maps").mkdir()
        (folder / "maps" / "skin.png").write_bytes(PICTURE)
    (folder / "out").mkdir()
    target = f"out/result{model.suffix}"
    command = ["noise", model.name, target, "--sigma", "5", "--report", "out/report.json"]
    if kind == "gltf":  # over the files of an earlier run
        beltrami(*command, "--seed", "2", cwd=folder)
        command.append("--overwrite")
    assert ended_at_every_step(folder, signal.SIGKILL, target, command) >= 7


def run_python(program, *arguments):
    command = [sys.executable, "-c", program, *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)


def ended_at_every_step(folder, number, target, command=()):
    """Check what a signal leaves at each step of a command, and return how many there are."""
    script = Path(__file__).with_name("interrupting.py")
    where = [str(script.parents[1]), *filter(None, [os.environ.get("PYTHONPATH")])]
    run = subprocess.run(
        [sys.executable, script, folder, str(int(number)), target, *command],
        capture_output=True, text=True, check=True, timeout=300,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(where), "OPENBLAS_NUM_THREADS": "1"},
    )  # fmt: skip
    *wrong, steps = run.stdout.splitlines()
    assert wrong == []
    return int(steps)


# Ends itself at the n-th line that the command runs of its own, from the first one to the last; 77: there is none.
AT_A_LINE = """
import os, signal, sys
import beltrami_cli.cli.main as command
from beltrami_cli.cli import interruption
number, files = int(sys.argv[1]), (command.__file__, interruption.__file__)

def child(at):
    left = at
    def trace(frame, event, argument):
        nonlocal left
        if frame.f_code.co_filename not in files:
            return None
        left -= event == "line"
        if event == "line" and left == 0:
            os.kill(os.getpid(), number)
        return trace
    signal.signal(number, signal.SIG_DFL)
    command.group.main = lambda **_: 0
    sys.argv = ["beltrami"]
    sys.settrace(trace)
    try:
        command.main()
    finally:
        sys.settrace(None)
        if left > 0:
            os._exit(77)

for at in range(1, 500):
    pid = os.fork()
    if pid == 0:
        child(at)
    code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    if code == 77:
        break
    print(code)
"""


# 2 s: a fork for each of some fifty lines.
@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=lambda number: number.name)
def test_a_signal_at_any_line_of_the_command(number):
    run = run_python(AT_A_LINE, str(int(number)))
    codes = [int(code) for code in run.stdout.split()]
    assert len(codes) > 30
    assert set(codes) <= {0, 128 + number, -number}
    assert "Traceback" not in run.stderr


# Ways to run a function in which exceptions do not come out, or come out as others.
HIDING = {
    "destructor": """
class Last:
    def __del__(self):
        signal_comes()
Last()
""",
    "library that says otherwise": """
try:
    signal_comes()
except BaseException:
    other = ImportError("numpy.core failed to import")
raise other
""",
}


@pytest.mark.parametrize("way", HIDING)
def test_a_signal_is_not_lost_where_its_exception_does_not_come_out(way):
    program = f"""
import os, signal, sys, time
import beltrami_cli.cli.main as command
def signal_comes():
    os.kill(os.getpid(), signal.SIGTERM)
    for _ in range(1000):
        pass
def work(**_):
    exec({HIDING[way]!r}, globals())
    time.sleep(20)
command.group.main = work
sys.argv = ["beltrami"]
command.main()
"""
    run = run_python(program)
    assert run.returncode == 128 + signal.SIGTERM
    assert run.stderr == "beltrami: interrupted; files are as they were, or complete\n"


# A command that gets each signal whose default ends a process, in a child for each; then once more, ignored.
EVERY_SIGNAL = """
import os, signal, sys, time
import beltrami_cli.cli.main as command
faults = signal.SIGSEGV, signal.SIGBUS, signal.SIGFPE, signal.SIGILL, signal.SIGTRAP, signal.SIGSYS
stops = signal.SIGSTOP, signal.SIGTSTP, signal.SIGTTIN, signal.SIGTTOU
sys.argv = ["beltrami"]

def ended(child, *arguments):
    source, target = os.pipe()
    pid = os.fork()
    if pid == 0:
        os.dup2(target, 2)
        child(*arguments)
    os.close(target)
    said = os.read(source, 1000)
    os.close(source)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), said

def plainly(number):
    signal.signal(number, signal.SIG_DFL)
    os.kill(os.getpid(), number)
    os._exit(0)

def in_command(number, handler):
    def work(**_):
        os.kill(os.getpid(), number)
        time.sleep(0 if handler == signal.SIG_IGN else 1)
        return 0
    signal.signal(number, handler)
    command.group.main = work
    command.main()

for number in sorted(signal.valid_signals() - {signal.SIGKILL, *stops, *faults}):
    if ended(plainly, number)[0] < 0:
        print(int(number), *(ended(in_command, number, each) for each in (signal.SIG_DFL, signal.SIG_IGN)))
"""


@pytest.mark.slow
def test_every_signal_that_ends_a_process_and_can_be_caught_ends_the_command_in_one_line():
    found = run_python(EVERY_SIGNAL).stdout.splitlines()
    numbers = [int(line.partition(" ")[0]) for line in found]
    said = b"beltrami: interrupted; files are as they were, or complete\n"
    assert found == [f"{number} {(128 + number, said)} {(0, b'')}" for number in numbers]
    names = ("HUP", "INT", "QUIT", "ABRT", "USR1", "USR2", "ALRM", "TERM", "XCPU", "VTALRM", "PROF")
    assert {getattr(signal, f"SIG{name}") for name in names} <= set(numbers)


# A process of a batch in the middle of a file that is partly written.
WORKER = """
import multiprocessing, sys, time
from pathlib import Path
from beltrami_cli.batch.worker import Channel, Order
from beltrami_cli.batch.worker import serve
from beltrami_cli.formats.image.opening import scratch_file
from beltrami_cli.formats.changes import Written
from beltrami_cli.jobs.writing.file_set import FileSet
from beltrami_cli.jobs.writing.output import Output

def work(progress):
    with FileSet() as files:
        Output(sys.argv[1], overwrite=True, files=files).write(Written([b"new"], {}))
        print(len(list(Path(sys.argv[1]).parent.iterdir())), flush=True)
        for _ in range(6000):
            time.sleep(0.01)  # a signal that comes just before a wait is heard after it

ours, theirs = multiprocessing.Pipe()
with scratch_file() as path:
    Channel(ours, path).send(Order(work))
    serve(theirs, path)
"""


@pytest.mark.slow
@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP", "SIGQUIT", "SIGALRM", "SIGUSR1", "SIGXCPU"])
def test_a_process_of_a_batch_removes_its_temporary_files_whichever_signal_ends_it(name, tmp_path):
    number = getattr(signal, name)
    command = [sys.executable, "-P", "-c", WORKER, str(tmp_path / "out.ply")]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        try:
            assert int(process.stdout.readline()) > 0
            process.send_signal(number)
            assert process.wait(timeout=30) == 128 + number
        finally:
            process.kill()  # which waits for more files otherwise
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["SIGINT", "SIGQUIT", "SIGALRM", "SIGUSR1", "SIGXCPU"])
def test_signals_wait_while_files_are_put_in_place(name):
    number, heard = getattr(signal, name), []
    before = signal.signal(number, lambda *_: heard.append(number))
    try:
        with signals_deferred():
            signal.raise_signal(number)
            assert heard == []
        assert heard == [number]
    finally:
        signal.signal(number, before)
