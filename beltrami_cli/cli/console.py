"""Messages, tables and progress for the user, on standard error."""

from __future__ import annotations

import math
import os
import shutil
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

import click

from beltrami_cli.errors import one_line

if TYPE_CHECKING:
    from rich.progress import Progress

    from beltrami_cli.jobs.progress import Work

printable = one_line
"""Text that moves no cursor and fits any terminal."""


def show_table(head: Sequence[str], rows: Sequence[Sequence[str]], *, err: bool = False) -> None:
    """Print a table, as wide as a terminal if it goes to one."""
    is_terminal = (sys.stderr if err else sys.stdout).isatty()
    width = shutil.get_terminal_size().columns if is_terminal else None
    for line in table_lines(head, [[printable(cell) for cell in row] for row in rows], width):
        click.echo(line, err=err)


def table_lines(head: Sequence[str], rows: Sequence[Sequence[str]], width: int | None) -> Iterator[str]:
    """Yield the lines of a table without breaking numbers: if lines are too short, names get lines of their own."""
    lines = _aligned([head, *rows])
    if width is None or len(lines[0]) <= width:
        yield from lines
        return
    parted = [name.partition(" ") for name in head[1:]]
    first, second = ([words[k] for words in parted] for k in (0, 2))
    numbers = _aligned([["", *first], ["", *second], *(["", *row[1:]] for row in rows)])
    if len(numbers[0]) <= width:
        yield from numbers[:2]
        for row, line in zip(rows, numbers[2:], strict=True):
            yield from (row[0], line)
        return
    for name, *cells in rows:
        yield name
        yield from (f"  {line}" for line in _aligned(list(zip(head[1:], cells, strict=True))))


def _aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return rows as lines: the first column to the left, the others to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    aligned = ([row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])] for row in rows)
    return ["  ".join(cells).rstrip() for cells in aligned]


def _progress_in_lines() -> Callable[[str, float, float], None]:
    """Return a function that prints a line for each label and percentage, which other programs can read."""
    printed: set[tuple[str, int]] = set()

    def update(label: str, done: float, total: float) -> None:
        line = label, int(100 * done / total)
        if line not in printed:
            printed.add(line)
            click.echo(f"progress: {printable(label)} {line[1]}%", err=True)

    return update


def _progress_bar(work: Work) -> Progress:
    """Return a progress bar of some work, updated ten times a second."""
    from rich.console import Console, RenderableType
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    class ProgressBar(Progress):
        def get_renderables(self) -> Iterable[RenderableType]:
            for task in self.task_ids:
                done = math.floor(100 * work.share()) / 100  # 100 % is not shown before all is done
                self.update(task, description=printable(work.label) or "starting", completed=done)
            yield from super().get_renderables()

    # Names of files may have brackets.
    columns = TextColumn("{task.description}", markup=False), BarColumn(), TaskProgressColumn()
    bar = ProgressBar(*columns, TimeRemainingColumn(), console=Console(stderr=True), transient=True)
    bar.add_task("starting", total=1.0)
    return bar


class Messages:
    """Messages to the user: none if quiet; results and warnings; details if verbose."""

    def __init__(self, *, quiet: bool, verbose: int) -> None:
        self.quiet, self.verbose = quiet, verbose
        self._bar: Progress | None = None  # which is drawn now

    def show(self, *lines: str) -> None:
        """Print lines whatever was asked for, above the bar."""
        for line in map(printable, lines):
            if self._bar is None:
                click.echo(line, err=True)
            else:
                self._bar.console.out(line, highlight=False)

    def say(self, text: str) -> None:
        if not self.quiet:
            self.show(text)

    def detail(self, text: str) -> None:
        if self.verbose:
            self.say(text)

    def warn(self, text: str) -> None:
        self.say(f"warning: {text}")

    def warn_of(self, name: str, warnings: Iterable[str]) -> None:
        """Print warnings about a file; those about images may start with its name already."""
        shown = "<stdin>" if name == "-" else name
        for text in warnings:
            self.warn(text if text.startswith(shown) else f"{shown}: {text}")

    @contextmanager
    def log_shown(self, *, work: bool) -> Iterator[None]:
        """Print what the package logs: warnings, and with `work` how much of it is ahead."""
        import logging

        def show(record: logging.LogRecord) -> None:
            (self.warn if record.levelno >= logging.WARNING else self.say)(record.getMessage())

        handler, log = logging.Handler(), logging.getLogger("beltrami_cli")
        handler.emit, level = show, log.level  # type: ignore[method-assign]
        log.addHandler(handler)
        log.setLevel(logging.INFO if work else level)
        try:
            yield
        finally:
            log.removeHandler(handler)
            log.setLevel(level)

    @contextmanager
    def progress(self) -> Iterator[Work | None]:
        """Yield a callback that draws a bar with label and time left on a terminal, or prints lines for programs."""
        if os.environ.get("BELTRAMI_PROGRESS") == "lines":
            from beltrami_cli.jobs.progress import Share

            lines = _progress_in_lines()
            yield Share(forward=lines)
            lines("done", 1.0, 1.0)
            return
        if self.quiet or not sys.stderr.isatty():
            yield None
            return
        from beltrami_cli.jobs.progress import Work

        work = Work()
        try:
            with _progress_bar(work) as self._bar:
                yield work
        finally:
            self._bar = None
