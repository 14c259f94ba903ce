"""Work on chunks, in a module that worker processes can import; tests themselves cannot be."""

import os
import signal
import time

from beltrami_cli.errors import ProcessingError


def add(part, stacks, threads):
    return [stacks[0] + part], (1.0, threads)


def die_once(part, stacks, threads, trace):
    """Die with one of the chunks, the first time."""
    if part == 2 and not trace.exists():
        trace.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return add(part, stacks, threads)


def die(part, stacks, threads):
    os.kill(os.getpid(), signal.SIGKILL)


def refuse(part, stacks, threads):
    raise ProcessingError("no such chunk")


def sleep(part, stacks, threads):
    time.sleep(60)
