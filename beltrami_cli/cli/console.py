"""Messages and progress on stderr; stdout carries data only."""

from __future__ import annotations

import os
import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import click

from beltrami_cli.errors import one_line

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from rich.progress import TaskID

printable = one_line
"""Text that moves no cursor and fits any terminal."""

NO_NOISE = "no more than rounding makes"
ALL_THE_SAME = "to smooth all the same, give --strength strong, or the noise, as in --noise 5"


def counted(number: int, noun: str) -> str:
    """Return a number of things in words."""
    plural = f"{noun[:-2]}ices" if noun.endswith("vertex") else f"{noun}s"
    return f"{number} {noun if number == 1 else plural}"


def choice_in_words(choice: dict[str, Any]) -> str:
    """Return what was chosen, by what estimate, and how sure that is."""
    chosen = ", ".join(f"{name} {value:.3g}" for name, value in choice["chosen"].items())
    if choice["psnr"] is None:
        return f"{chosen}; by the fixed rule of --fast"
    least, most = choice["interval"]
    within = f"at least {least:.1f}" if most is None else f"{least:.1f} to {most:.1f}"
    shared = ""
    if choice["correlated"]:
        shared = "; neighbours share noise, as in JPEG pictures, so it is known less well: give --noise if you know it"
    return (
        f"{chosen}; estimated PSNR {choice['psnr']:.1f} dB (90 %: {within}), {choice['gain']:+.1f} dB "
        f"against the input; the best of {choice['candidates']} on {choice['samples']} samples{shared}"
    )


def _progress_in_lines() -> Callable[[str, int, int], None]:
    """Return a function that prints a line for each label and percentage, which other programs can read."""
    printed: set[tuple[str, int]] = set()

    def update(label: str, done: int, total: int) -> None:
        share = label, 100 * done // max(1, total)
        if share not in printed:
            printed.add(share)
            click.echo(f"progress: {printable(label)} {share[1]}%", err=True)

    return update


class Messages:
    """Messages to the user: none if quiet; results and warnings; details if verbose."""

    def __init__(self, *, quiet: bool, verbose: int) -> None:
        self.quiet = quiet
        self.verbose = verbose

    def say(self, text: str) -> None:
        if not self.quiet:
            click.echo(printable(text), err=True)

    def detail(self, text: str) -> None:
        """Print what only --verbose shows."""
        if self.verbose and not self.quiet:
            click.echo(printable(text), err=True)

    def warn(self, text: str) -> None:
        self.say(f"warning: {text}")

    def warn_of(self, name: str, warnings: Iterable[str]) -> None:
        """Print warnings about a file; those about images may start with its name already."""
        shown = "<stdin>" if name == "-" else name
        for text in warnings:
            self.warn(text if text.startswith(shown) else f"{shown}: {text}")

    @contextmanager
    def work_shown(self, *, wanted: bool) -> Iterator[None]:
        """Show how much work is ahead, which the package logs before it starts."""
        import logging

        handler, log = logging.Handler(logging.INFO), logging.getLogger("beltrami_cli")
        handler.emit = lambda record: self.say(record.getMessage())  # type: ignore[method-assign]
        if not wanted:
            yield
            return
        before = log.level
        log.addHandler(handler)
        log.setLevel(logging.INFO)
        try:
            yield
        finally:
            log.removeHandler(handler)
            log.setLevel(before)

    @contextmanager
    def progress(self) -> Iterator[Callable[[str, int, int], None] | None]:
        """Give a function that draws a bar with a label and the time left; on a terminal, or as lines for programs."""
        if os.environ.get("BELTRAMI_PROGRESS") == "lines":
            yield _progress_in_lines()
            return
        if self.quiet or not sys.stderr.isatty():
            yield None
            return
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

        columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
        with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
            tasks: dict[str, TaskID] = {}

            def update(label: str, done: int, total: int) -> None:
                if label not in tasks:
                    tasks[label] = bar.add_task(label, total=total)
                bar.update(tasks[label], completed=done, total=total)

            yield update
