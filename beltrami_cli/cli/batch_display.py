"""Progress of a batch: lines that move while it runs, and a table in the end."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from beltrami_cli.cli.console import NO_NOISE, Messages, printable

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

    from beltrami_cli.batch.item import Attempt, Item, Outcome

_WIDTH = 140  # of the table, where it goes to a file
_COLOURS = {"done": "green", "skipped": "dim", "failed": "bold red", "not started": "yellow"}


class Display:
    """Shows a line for each file in work and one for all, on a terminal only; prints failures at once."""

    def __init__(self, jobs: Sequence[Item], messages: Messages) -> None:
        self._jobs, self._messages = jobs, messages
        self._bar = _bar(is_shown=not messages.quiet and sys.stderr.isatty())
        self._all = self._bar.add_task("all files", total=len(jobs))
        self._lines: dict[int, TaskID] = {}

    def __enter__(self) -> Display:
        self._bar.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._bar.stop()

    def started(self, key: int) -> None:
        self._lines[key] = self._bar.add_task(self._name(key), total=None)

    def advanced(self, key: int, label: str, done: int, total: int) -> None:
        if key not in self._lines:  # others had it waiting, and have begun
            self.started(key)
        description = f"{self._name(key)}: {printable(label)}"
        self._bar.update(self._lines[key], description=description, completed=done, total=total)

    def postponed(self, key: int) -> None:
        self._end(key)
        if self._messages.verbose:
            self._print(f"{self._jobs[key].source}: wants more than its share of memory, so it waits")

    def finished(self, key: int, attempt: Attempt) -> None:
        self._end(key)
        self._bar.advance(self._all)
        outcome = attempt.outcome
        if attempt.traceback and self._messages.verbose >= 2:
            self._print(*attempt.traceback.splitlines())
        if outcome.status == "failed":  # also with --quiet, as every error
            self._print(f"failed: {outcome.error}")
        elif self._messages.verbose and not self._messages.quiet:
            self._print(f"{outcome.status}: {outcome.output}, {outcome.seconds:.1f} s")

    def _print(self, *lines: str) -> None:
        """Print lines above the progress bars."""
        for line in map(printable, lines):
            self._bar.console.print(line, markup=False, highlight=False, soft_wrap=True)

    def _end(self, key: int) -> None:
        if key in self._lines:
            self._bar.remove_task(self._lines.pop(key))

    def _name(self, key: int) -> str:
        return printable(self._jobs[key].source)


def show_table(outcomes: Sequence[Outcome]) -> None:
    """Print what came of every file to the standard error."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, header_style="bold", pad_edge=False)
    table.add_column("output", overflow="fold")
    table.add_column("result", no_wrap=True)
    for name in ("time", "noise", "change"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("remark", overflow="fold")
    for outcome in outcomes:
        cells = [outcome.output, outcome.status, *_figures(outcome), _remark(outcome)]
        texts = [Text(printable(cell)) for cell in cells]
        texts[1].stylize(_COLOURS.get(outcome.status, ""))
        table.add_row(*texts)
    Console(stderr=True, width=None if sys.stderr.isatty() else _WIDTH).print(table)


def _figures(outcome: Outcome) -> tuple[str, str, str]:
    seconds = f"{outcome.seconds:.1f} s" if outcome.seconds else ""
    report: dict[str, Any] = outcome.report or {}
    parts = _parts(report)
    if outcome.status == "failed" or not parts:
        return seconds, "", ""
    noise = max((max(part["noise"].values(), default=0.0) for part in parts), default=0.0)
    change = max(part["change"]["mean"] for part in parts)
    return seconds, f"{255 * noise:.1f}/255", f"{255 * change:.1f}/255"


def _parts(report: dict[str, Any]) -> list[dict[str, Any]]:
    parts = [report.get("vertices"), report.get("image"), *report.get("textures", [])]
    return [part for part in parts if part]


def _remark(outcome: Outcome) -> str:
    if outcome.status == "failed":
        return "see above"  # where `finished` reported it
    report: dict[str, Any] = outcome.report or {}
    remarks = list(report.get("warnings", []))
    parts = _parts(report)
    is_chosen = "iterations" in report.get("parameters", {}).get("free", ())
    if parts and is_chosen and not any(part["iterations"] for part in parts):
        is_changed = any(part["change"]["mean"] for part in parts)  # by levelling
        remarks.append(f"noise {NO_NOISE}, so it is {'not smoothed' if is_changed else 'left as it is'}")
    return "; ".join(remarks)


def _bar(*, is_shown: bool) -> Progress:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    name = TextColumn("{task.description}", markup=False)  # names of files may have brackets
    columns = (name, BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    return Progress(*columns, console=Console(stderr=True), transient=True, disable=not is_shown)
