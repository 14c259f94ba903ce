"""A worker process, from its own side."""

from __future__ import annotations

import contextlib
import copy
import multiprocessing
import signal
import sys
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from beltrami_cli.batch.channel import Channel, Order
from beltrami_cli.batch.pool import Advance
from beltrami_cli.jobs.progress import at_intervals
from beltrami_cli.signals import end_with_parent, unhandled_signals

_PROGRESS_INTERVAL = 0.1  # seconds between two messages on progress


def serve(pipe: Connection[Any, Any], path: Path) -> None:
    """Run the tasks from a channel until it is closed."""
    for number in unhandled_signals():
        signal.signal(number, lambda number, _: sys.exit(128 + number))
    if (leader := multiprocessing.parent_process()) is not None and leader.pid is not None:
        end_with_parent(leader.pid, signal.SIGTERM)  # a signal on which it removes its files
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all processes; the leading one decides
    channel, held = Channel(pipe, path), dict[int, Any]()  # parts by key

    def report(label: str, done: int, total: int) -> None:
        try:
            channel.send(Advance(label, done, total))
        except ConnectionError:  # the leading process is gone, which is not an error of the task
            sys.exit()

    progress = at_intervals(_PROGRESS_INTERVAL, report)
    with contextlib.suppress(EOFError, ConnectionError):
        while True:
            order: Order = channel.receive()
            held = {key: held[key] for key in order.held}
            if order.key is not None and order.part is not None:
                # The arrays of a message are valid until the next one.
                held[order.key] = copy.deepcopy(order.part)
            parts = () if order.key is None else (held[order.key],)
            channel.send(order.task(*parts, *order.arguments, progress))
