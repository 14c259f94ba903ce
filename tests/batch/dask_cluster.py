"""A Dask scheduler and two workers: processes of their own on loopback, without dashboards."""

import os
import signal
import subprocess
import sys
import time

_DASK = [sys.executable, "-P", "-m", "dask"]
_LOCAL = ["--host", "127.0.0.1", "--no-dashboard"]


class Cluster:
    """A scheduler, whose address is in a file, and workers that can be killed and replaced."""

    def __init__(self, folder, *options):
        self.folder, self.address = folder, folder / "scheduler.json"
        self._processes, self._workers = [], {}
        self._start("scheduler", "--port", "0", "--scheduler-file", self.address, *options)

    def grow(self, count):
        """Have `count` workers, which are named by numbers."""
        for name in [name for name, process in self._workers.items() if process.poll() is not None]:
            del self._workers[name]
        while len(self._workers) < count:
            self.start_worker()
        with self.client() as client:
            client.wait_for_workers(count, timeout=60)

    def start_worker(self):
        name = f"worker{len(self._processes)}"
        place = ("--local-directory", self.folder / name, "--name", name)
        file = ("--scheduler-file", self.address)
        self._workers[name] = self._start("worker", *file, "--nthreads", "1", "--no-nanny", *place)

    def client(self):
        from distributed import Client

        return Client(scheduler_file=str(self.address), timeout=60, set_as_default=False)

    def kill(self, name):
        """Kill a worker, -9."""
        self._workers[name].kill()
        self._workers[name].wait()

    def kill_first(self):
        self.kill(min(self._workers))

    def kill_busy(self, busy_for=0.2):
        """Kill a worker, -9, that has been in the middle of something for a while; return what it had in work."""
        with self.client() as client:
            seen = {}
            deadline = time.monotonic() + 60
            while time.monotonic() < deadline:
                workers = client.scheduler_info()["workers"]
                for address, keys in client.processing().items():
                    first = seen.setdefault((address, tuple(keys)), time.monotonic())
                    if keys and time.monotonic() - first >= busy_for:
                        self.kill(workers[address]["name"])
                        return list(keys)
                time.sleep(0.02)
        raise AssertionError("no worker had anything to do")

    def close(self):
        for process in reversed(self._processes):
            process.send_signal(signal.SIGKILL)
            process.wait()

    def _start(self, *arguments):
        with (self.folder / f"{len(self._processes)}.log").open("w") as log:
            process = subprocess.Popen(
                [*_DASK, *map(str, arguments), *_LOCAL], stdout=log, stderr=log,
                env={**os.environ, "OMP_NUM_THREADS": "1"},
            )  # fmt: skip
        self._processes.append(process)
        return process
