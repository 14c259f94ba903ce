"""Progress and messages of a batch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from beltrami_cli.cli.console import Messages
from beltrami_cli.jobs.progress import Label, Work

if TYPE_CHECKING:
    from beltrami_cli.batch.item import Attempt, Item

_FILES = "files"  # which progress counts


class Display:
    """Shows how far all files are together; prints failures at once."""

    def __init__(self, jobs: Sequence[Item], messages: Messages, work: Work | None) -> None:
        self._jobs, self.messages, self._work = jobs, messages, work
        self._finished = self._skipped = 0
        self._shares: dict[int, float] = {}  # of the files in work that are done
        if work is not None:
            work.expect([(_FILES, float(len(jobs)))])
        self._show()

    def advanced(self, key: int, label: str, done: float, total: float) -> None:
        self._shares[key] = done / total
        self._show()

    def _show(self) -> None:
        # Files that are skipped take no time, and say nothing about that of others.
        count, done = len(self._jobs), self._finished - self._skipped + sum(self._shares.values())
        if self._work is not None:
            label = Label(f"{self._finished} of {count} {_FILES}", _FILES)
            # What remains of a file whose work is done, such as reading it back, takes some time too.
            whole = count - self._skipped
            self._work(label, done if self._finished == count else min(done, whole - 0.001), whole)

    def postponed(self, key: int) -> None:
        self._shares.pop(key, None)
        if self.messages.verbose:
            self.messages.show(f"{self._jobs[key].source}: wants more than its share of memory, so it waits")

    def finished(self, key: int, attempt: Attempt) -> None:
        self._shares.pop(key, None)
        outcome = attempt.outcome
        self._finished += 1
        self._skipped += outcome.status == "skipped"
        self._show()
        if attempt.traceback and self.messages.verbose >= 2:
            self.messages.show(*attempt.traceback.splitlines())
        if outcome.status == "failed":  # also with --quiet, as every error
            self.messages.show(f"failed: {outcome.error}")
        elif not self.messages.quiet:
            warnings = (outcome.report or {}).get("warnings", ()) if outcome.status == "done" else ()
            self.messages.show(*(f"warning: {outcome.input}: {text}" for text in warnings))
            if self.messages.verbose:
                pieces = f", in {attempt.chunks} pieces" if attempt.chunks else ""
                self.messages.show(f"{outcome.status}: {outcome.output}, {outcome.seconds:.1f} s{pieces}")
