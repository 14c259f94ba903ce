"""No process outlives the one that started it, however that one ends."""

import os
import signal
import subprocess
import sys

import pytest

from cli.commands import COMMAND, SAMPLES
from processes import children, is_running, wait_for

pytestmark = [pytest.mark.slow, pytest.mark.skipif(sys.platform != "linux", reason="only Linux can do it")]
STARTS = {
    "for a library, which hears no signal in native code": """
from beltrami_cli.surface.worker_process import ask, serve

def work(*question):
    open("started", "w").close()
    sum(range(10**11))

if __name__ == "__main__":
    serve(work, 100)
else:
    ask("work", (None, {}), seconds=100)
""",
    "for a task": """
from multiprocessing import parent_process
from time import sleep
from beltrami_cli.batch.processes import Processes

def work(progress):
    open("started", "w").close()
    sleep(100)

if parent_process() is None:
    pool = Processes(2)
    pool.start(0, work)
    list(pool.events())
""",
    "by a program that asks the command for it": f"""
import os, subprocess

command = {[*COMMAND, "view", str(SAMPLES / "scan-noisy.ply"), "--no-open"]}
with subprocess.Popen(command, env=os.environ | {{"BELTRAMI_PARENT": str(os.getpid())}}, stderr=-1) as process:
    process.stderr.readline()
    open("started", "w").close()
    process.wait()
""",
}


@pytest.mark.parametrize("start", STARTS)
def test_a_process_ends_with_the_one_that_started_it(start, tmp_path):
    (tmp_path / "work.py").write_text(STARTS[start])
    environment = os.environ | {"PYTHONPATH": str(tmp_path)}
    with subprocess.Popen([sys.executable, "-c", "import work"], cwd=tmp_path, env=environment) as leader:
        wait_for((tmp_path / "started").exists)
        started = children(leader.pid)
        leader.kill()
    assert started
    try:
        wait_for(lambda: not any(map(is_running, started)))
    finally:
        for process in filter(is_running, started):
            os.kill(process, signal.SIGKILL)
