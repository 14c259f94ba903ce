"""Which tests run on which system, the Hypothesis profile, and processor time by file, with a budget (`--cpu FILE`)."""

from __future__ import annotations

import collections
import os
import signal
import sys
from pathlib import Path

import pytest
from hypothesis import settings

from installation import ensure_current, imported_distribution

if "PYTEST_XDIST_WORKER" in os.environ:
    imported_distribution()  # which takes the checkout off the path
else:
    ensure_current()

# A shell that starts tests in the background has them ignore these signals, and nohup the third, as would the commands
# that they start.
for number, handler in (
    (signal.SIGINT, signal.default_int_handler),
    (getattr(signal, "SIGQUIT", 0), signal.SIG_DFL),
    (getattr(signal, "SIGHUP", 0), signal.SIG_DFL),
):
    if number and signal.getsignal(number) == signal.SIG_IGN:
        signal.signal(number, handler)

# Another process on the same processors makes any example last.
settings.register_profile("patient", settings(deadline=None))
settings.load_profile("patient")

# Signals, FIFOs, limits of resources, terminals and shells as POSIX has them.
_OF_POSIX = [
    "batch/test_batch_command.py",
    "batch/test_shell_and_make.py",
    "cli/test_memory_option.py",
    "cli/test_smooth_command.py",
    "hostile",
]

collect_ignore = _OF_POSIX if sys.platform == "win32" else []


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--cpu", metavar="FILE", help="write the processor time of each test and each test file to FILE"
    )
    parser.addoption(
        "--cpu-budget",
        metavar="SECONDS",
        type=float,
        help="fail if the tests of one file take more processor time",
    )


def pytest_configure(config: pytest.Config) -> None:
    os.umask(0o022)  # configuration that others may write to is not read
    config.pluginmanager.register(_ProcessorTime(config.getoption("--cpu"), config.getoption("--cpu-budget")))


class _ProcessorTime:
    """Processor time of each test, its fixtures and the child processes that ended during it."""

    def __init__(self, path: str | None, budget: float | None) -> None:
        self.path, self.budget = path, budget
        self.last = self.now()
        self.by_test: collections.Counter[str] = collections.Counter()

    @staticmethod
    def now() -> float:
        return sum(os.times()[:4])

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self):
        self.last = self.now()
        return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self):
        report = yield
        before, self.last = self.last, self.now()
        report.cpu_seconds = self.last - before  # which xdist passes to the process that reports
        return report

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self.by_test[report.nodeid] += getattr(report, "cpu_seconds", 0.0)  # none where the process died

    def by_file(self) -> collections.Counter[str]:
        seconds: collections.Counter[str] = collections.Counter()
        for test, own in self.by_test.items():
            seconds[test.partition("::")[0]] += own
        return seconds

    def over_budget(self) -> list[str]:
        most = self.budget or float("inf")
        return [f"{name}: {own:.0f} s" for name, own in self.by_file().most_common() if own > most]

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        if hasattr(session.config, "workerinput"):
            return
        if self.path:
            by_file = self.by_file()
            rows = [("total", by_file.total()), *by_file.most_common(), *self.by_test.most_common()]
            Path(self.path).write_text("".join(f"{seconds:8.2f}  {name}\n" for name, seconds in rows))
        if self.over_budget():
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        for line in self.over_budget():
            terminalreporter.write_line(
                f"{line} of processor time, more than the budget of {self.budget:g} s", red=True
            )
