"""Chunks in worker processes: whichever of them dies, and whatever the work raises."""

import contextlib
import errno
import multiprocessing
import os
import pickle
import re
import signal
import time
from concurrent.futures import Future
from functools import partial
from unittest.mock import Mock

import numpy as np
import pytest

from batch.batches import batch, files_in
from batch.chunk_work import add, die, die_once, refuse, sleep
from beltrami_cli.batch.chunks import ChunkRunner
from beltrami_cli.batch.cluster import OnDask
from beltrami_cli.batch.processes import Processes
from beltrami_cli.batch.worker import Channel
from beltrami_cli.errors import InputError, NoColoursError, OutputError, ProcessingError
from beltrami_cli.flow import cuts
from beltrami_cli.flow.chunks import Chunk
from cli.commands import copy_samples

MADE = []  # the parts that were cut for a worker
CUT = [Chunk(lambda part=part: MADE.append(part) or part, slice(None), part) for part in range(5)]


def done(runner, operation):
    answers = runner(CUT, operation, [np.zeros(1, np.float32)])
    return sorted((number, values.tolist(), figures) for number, (values,), figures in answers)


@pytest.fixture
def runner():
    """Give two processes, which take a second to start."""
    pool = Processes(2)
    yield ChunkRunner(pool)
    pool.close()


@pytest.mark.slow
def test_a_chunk_whose_process_dies_is_done_by_another(runner, tmp_path):
    expected = [(number, [number], (1.0, 1)) for number in range(5)]
    MADE.clear()
    assert done(runner, add) == done(runner, add) == done(runner, add) == expected
    assert len(MADE) <= 10  # of 15: each of two workers keeps its parts
    assert done(runner, partial(die_once, trace=tmp_path / "died")) == expected
    assert done(runner, add) == expected
    with pytest.raises(ProcessingError, match="no such chunk"):
        done(runner, refuse)
    assert done(runner, add) == expected


@pytest.mark.slow
def test_a_chunk_that_every_process_dies_with_fails():
    with contextlib.closing(Processes(2)) as pool:
        runner = ChunkRunner(pool, tries=2)
        with pytest.raises(
            ProcessingError, match="workers died or failed 2 times with one piece of the surface"
        ):
            done(runner, die)


@pytest.mark.slow
def test_work_that_is_given_up_ends_at_once(runner):
    answers = runner(CUT, sleep, [])
    start, before = time.monotonic(), signal.signal(signal.SIGALRM, Mock(side_effect=KeyboardInterrupt))
    signal.setitimer(signal.ITIMER_REAL, 2)
    with pytest.raises(KeyboardInterrupt):
        next(answers)
    signal.signal(signal.SIGALRM, before)
    assert time.monotonic() - start < 30


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "posix_fallocate"), reason="only POSIX says so before pages are written")
def test_storage_that_is_full_is_reported(runner, monkeypatch):
    full = Mock(side_effect=OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))
    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(ProcessingError, match=r"no room for a piece in work \(No space left"):
        done(runner, add)


def test_arrays_of_messages_are_exchanged_and_can_be_changed(tmp_path):
    (tmp_path / "file").touch()
    ours, theirs = (Channel(pipe, tmp_path / "file") for pipe in multiprocessing.Pipe())
    for size in (2, 0, 3, 1):
        transposed = np.arange(4 * size, dtype=np.float32).reshape(2, -1).T
        arrays = [transposed, np.ones((size, 3)), np.ones(size, bool)]
        for sender, receiver in ((ours, theirs), (theirs, ours)):
            sender.send({"arrays": arrays, "name": "a"})
            got = receiver.receive()
            assert got["name"] == "a"
            assert all(map(np.array_equal, got["arrays"], arrays))
            assert all(each.flags.aligned and each.flags.writeable for each in got["arrays"])


@pytest.mark.slow
def test_a_file_in_pieces_is_the_same(tmp_path, monkeypatch):
    monkeypatch.setattr(cuts, "MIN_CELLS", 1)
    copy_samples(tmp_path / "in", "mirrored-noisy.*")
    said = []
    for name, options in (("whole", ()), ("pieces", ("--pieces", 4, "-j", 2))):
        options = *options, "-n", 2, "--patches", "on", "-v"
        said.append(batch(tmp_path / "in", "--out-dir", tmp_path / name, *options))
    in_pieces = re.compile(r"done: .*mirrored-noisy\.obj, [0-9.]+ s, in 4 pieces\n")
    assert [in_pieces.search(each) is not None for each in said] == [False, True]
    assert files_in(tmp_path / "pieces") == files_in(tmp_path / "whole")


class Client:
    """Stands for a Dask client whose scheduler fails, or whose workers fail some times with one of the chunks."""

    status = "running"

    def __init__(self, error, times=10**6, nthreads=None):
        self.error, self.times, self.nthreads = error, times, nthreads or (lambda: {"one": 1, "two": 1})

    def scatter(self, value, **_):
        return value

    def submit(self, on_worker, task, topic, key, version, *arguments, **_):
        future = Future()
        if key == 1 and self.times:
            self.times -= 1
            future.set_exception(self.error)
        else:
            future.set_result(task(*arguments, None))
        return future

    def subscribe_topic(self, *_):
        pass

    def cancel(self, *_, **__):
        raise OSError("no scheduler")


def done_on_dask(client):
    return done(ChunkRunner(OnDask(client, per_worker=2)), add)


@pytest.mark.parametrize("kind", [KeyError, OSError, ValueError, RuntimeError, AssertionError, TimeoutError])
def test_a_chunk_is_sent_again_whatever_dask_raises_and_not_for_ever(kind):
    """Dask raises many kinds of exceptions when a worker dies; exceptions of the work itself are its answer."""
    pytest.importorskip("distributed")
    expected = [(number, [number], (1.0, 1)) for number in range(5)]
    assert done_on_dask(Client(kind("two"), times=1)) == expected
    with pytest.raises(ProcessingError, match="workers died or failed 5 times"):
        done_on_dask(Client(kind("two")))


def test_the_message_names_what_failed_on_dask():
    pytest.importorskip("distributed")
    with pytest.raises(ProcessingError, match="ModuleNotFoundError"):
        done_on_dask(Client(ModuleNotFoundError("beltrami_cli")))
    with pytest.raises(ProcessingError, match="scheduler"):
        done_on_dask(Client(None, nthreads=Mock(side_effect=OSError("timed out"))))


@pytest.mark.parametrize("kind", [InputError, OutputError, NoColoursError])
def test_an_error_of_a_file_comes_back_from_another_process(kind):
    error = kind("scan.ply", "the file is cut off", "copy it again")
    again = pickle.loads(pickle.dumps(error))
    assert (type(again), str(again), vars(again)) == (kind, str(error), vars(error))
