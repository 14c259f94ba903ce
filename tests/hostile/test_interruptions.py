"""Whenever the command is ended, by Ctrl-C, by a signal or without warning, files are old or new, and whole."""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from cli.commands import COMMAND
from hostile.folders import snapshot
from hostile.interrupting import faults
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


@pytest.mark.slow
@pytest.mark.parametrize(
    "number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL], ids=lambda number: number.name
)
@pytest.mark.parametrize("target", ["out/result.obj", "new/result.obj", "model.obj"])
def test_a_signal_at_any_step_that_touches_files(target, number, tmp_path):
    folder = folder_with_model(tmp_path)
    (folder / "new").mkdir()
    script = Path(__file__).with_name("interrupting.py")
    where = [str(script.parents[1]), *filter(None, [os.environ.get("PYTHONPATH")])]
    run = subprocess.run(
        [sys.executable, script, folder, str(int(number)), target],
        capture_output=True, text=True, check=True, timeout=300,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(where), "OPENBLAS_NUM_THREADS": "1"},
    )  # fmt: skip
    *wrong, steps = run.stdout.splitlines()
    assert wrong == []
    assert int(steps) >= 7  # a probe that comes and goes, and three or more files written and renamed


@pytest.mark.slow
@pytest.mark.parametrize(
    "number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL], ids=lambda number: number.name
)
def test_a_signal_at_a_random_moment(number, tmp_path):
    folder = folder_with_model(tmp_path)
    work = tmp_path / "work"
    arguments = [*COMMAND, "smooth", "model.obj", "out/result.obj", "--overwrite", "-n", "20"]
    shutil.copytree(folder, work)
    start = time.monotonic()
    subprocess.run(arguments, cwd=work, check=True, capture_output=True)
    duration = time.monotonic() - start
    before, finished = snapshot(folder), snapshot(work)
    moments = random.Random(int(number))
    for _ in range(3):
        shutil.rmtree(work)
        shutil.copytree(folder, work)
        process = subprocess.Popen(arguments, cwd=work, stderr=subprocess.PIPE)
        time.sleep(moments.uniform(0.05, 1.1) * duration)
        process.send_signal(number)
        said = process.communicate(timeout=60)[1]
        assert process.returncode in (0, 128 + number, -number)
        assert b"Traceback" not in said
        assert faults(before, snapshot(work), finished, number) == []


# Ends itself at the n-th line that the command runs of its own, from the first one to the last; 77: there is none.
AT_A_LINE = """
import os, signal, sys
import beltrami_cli.cli.main as command
from beltrami_cli.cli import console
number, files = int(sys.argv[1]), (command.__file__, console.__file__)

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


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=lambda number: number.name)
def test_a_signal_at_any_line_of_the_command(number):
    run = subprocess.run(
        [sys.executable, "-c", AT_A_LINE, str(int(number))],
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
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
    "library": """
try:
    signal_comes()
except BaseException:
    pass
""",
    "library that says otherwise": """
try:
    signal_comes()
except BaseException:
    other = ImportError("numpy.core failed to import")
raise other
""",
    "class in the making": """
class Part:
    def __set_name__(self, owner, name):
        signal_comes()
class Whole:
    part = Part()
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
    run = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False, timeout=10
    )
    assert run.returncode == 128 + signal.SIGTERM
    assert run.stderr == "beltrami: interrupted; files are as they were, or complete\n"
