"""Work on blocks by several threads: all of it is done, or an error is raised."""

import subprocess
import sys
import threading

import pytest

from beltrami_cli.flow.manifolds.blocks import in_parallel

_AT_THE_LIMIT = """
import re, resource
from pathlib import Path
from beltrami_cli.flow.manifolds.blocks import in_parallel

done = bytearray(12)
outcomes = set()


def work(block):
    bytearray(4096)
    done[block] = 1


for kilobytes in range(0, 30_000, 30):
    done[:] = bytes(12)
    used = int(re.search(r"VmData:\\s+(\\d+)", Path("/proc/self/status").read_text())[1])
    try:
        resource.setrlimit(resource.RLIMIT_DATA, (used + kilobytes << 10, resource.RLIM_INFINITY))
        in_parallel(work, 4, ((block,) for block in range(12)))
        all_done = all(done)
    except MemoryError:
        all_done = None
    resource.setrlimit(resource.RLIMIT_DATA, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    outcomes.add(all_done)
print(False not in outcomes and True in outcomes)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux limits data, and counts it in /proc")
def test_threads_that_lack_memory_are_not_waited_for():
    run = [sys.executable, "-P", "-c", _AT_THE_LIMIT]
    assert subprocess.run(run, capture_output=True, text=True, timeout=60, check=True).stdout == "True\n"


def test_an_error_ends_the_work_and_is_raised():
    begun = []
    both = threading.Barrier(2, timeout=10)

    def work(block):
        begun.append(block)
        if block < 2:
            both.wait()
        if block == 1:
            raise ValueError("block 1")

    with pytest.raises(ValueError, match="block 1"):
        in_parallel(work, 2, ((block,) for block in range(1000)))
    assert len(begun) < 1000
