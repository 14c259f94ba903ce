"""Processes as Linux lists them, and waiting for what they do."""

import time
from pathlib import Path


def wait_for(condition):
    deadline = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def is_running(pid):
    status = described(pid, "stat")
    return bool(status) and b") Z " not in status  # a zombie


def children(pid):
    """Return the numbers of the running processes that a process started."""
    found = (each.read_text().split() for each in Path(f"/proc/{pid}/task").glob("*/children"))
    return [int(child) for numbers in found for child in numbers if is_running(child)]


def described(pid, what):
    """Return a file of /proc on a process, or nothing if that has ended."""
    try:
        return Path(f"/proc/{pid}/{what}").read_bytes()
    except OSError:
        return b""
