"""The command `beltrami batch`."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from beltrami_cli.cli import options
from beltrami_cli.cli.batch_items import items_for
from beltrami_cli.cli.command import GroupedOption, command, complete_files
from beltrami_cli.cli.console import Messages, printable, show_table
from beltrami_cli.cli.parameter_options import record_from, typed_parameters
from beltrami_cli.errors import OutputError, ProcessingError, UsageError
from beltrami_cli.fields import without_effect
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.formats.files.access import Access
from beltrami_cli.formats.files.paths import is_url
from beltrami_cli.jobs.progress import Label, Work
from beltrami_cli.quantities import show_amount
from beltrami_cli.surface.memory import default_memory

if TYPE_CHECKING:
    from beltrami_cli.batch.item import Attempt, Item, Outcome
    from beltrami_cli.batch.plan import Request
    from beltrami_cli.batch.run import Pass

_CLUSTER = "Many machines"
_FILES, _STEPS = "files", 1000  # what progress counts, and its steps for each
# The kind of input of each part of a report.
_KINDS = {"vertices": "vertex colours", "image": "images", "textures": "textures", "new_texture": "textures"}


@command("batch", inputs="INPUTS...")
@click.option("--out-dir", metavar="DIR", required=True, help="Folder of the outputs; it is made.")
@click.option(
    "--suffix", default="", metavar="TEXT",
    help="Put TEXT between the name and the extension of outputs; with an extension in it, such as .clean.glb, that is "
    "theirs.",
)  # fmt: skip
@click.option(
    "-j", "--jobs", "at_once", type=click.IntRange(1, 1024), metavar="COUNT",
    help="Files in work at the same time.  [default: as many as there are processors]",
)  # fmt: skip
@click.option(
    "--resume", is_flag=True,
    help="Go on from the report of an earlier run: skip what it has done, if neither the files nor the parameters have "
    "changed since.",
)  # fmt: skip
@click.option("--skip-uncoloured", is_flag=True, help="Files without colours do not count as failures.")
@click.option("--fail-fast", is_flag=True, help="Stop at the first failure.")
@click.option(
    "--dry-run", is_flag=True,
    help="Print which files would be smoothed, where to, and with which options of their own; read and write nothing.",
)  # fmt: skip
@click.option(
    "--report", "report_path", metavar="FILE.jsonl", shell_complete=complete_files,
    help="Where a line of JSON for each file is written.  [default: batch.jsonl in DIR]",
)  # fmt: skip
@click.option(
    "--scheduler", metavar="ADDRESS", cls=GroupedOption, group=_CLUSTER,
    help="Do the files on the workers of this Dask scheduler: tcp://HOST:PORT, or the file (.json) in which it wrote "
    "where it is. Inputs and outputs lie on storage that all share, or are URLs. See beltrami docs batch.",
)  # fmt: skip
@click.option(
    "--pieces", type=click.IntRange(1, 100_000), metavar="COUNT", cls=GroupedOption, group=_CLUSTER,
    help="Cut every mesh, texture, point cloud and image into up to this many pieces; small ones stay whole. Files are "
    "done one at a time, and the pieces of a file at the same time: on the workers of --scheduler, or else in as many "
    "processes as --jobs says. For surfaces that take one machine too long.",
)  # fmt: skip
@options.smoothing
@options.unwrapping
@options.output_format
@options.writing
def batch(
    inputs: tuple[str, ...],
    out_dir: str,
    report_path: str | None,
    scheduler: str | None,
    pieces: int | None,
    dry_run: bool,
    overwrite: bool,
    messages: Messages,
    **given: Any,
) -> None:
    """Smooth many files at the same time; each comes out as `beltrami smooth` makes it, to the last byte."""
    from beltrami_cli.batch.plan import plan
    from beltrami_cli.batch.record import Record
    from beltrami_cli.batch.run import Batch
    from beltrami_cli.batch.storage import make_folder_of

    start = time.monotonic()
    memory = record_from(Access, given).memory
    requests = plan(inputs, out_dir, given["suffix"], given["output_format"])
    jobs = items_for(requests, given, overwrite=overwrite)
    if pieces is not None and (moved := [job for job in jobs if job.settings.embedding.smooth_geometry]):
        remedy = "leave out --pieces, or --smooth-geometry"
        raise UsageError(f"{moved[0].source}: vertices are not moved in pieces; {remedy}")
    if dry_run:
        _show_plan(requests, resume=given["resume"], overwrite=overwrite)
        return
    path = _report_path(report_path, out_dir, inputs, jobs)
    with messages.progress() as work:
        display = Display(jobs, messages, work)
        with _passes(scheduler, pieces, given["at_once"], memory, display) as passes:
            if report_path is None:
                make_folder_of(path)
            record = Record(path, resume=given["resume"], overwrite=overwrite)
            batch = Batch(jobs, record, display, fail_fast=given["fail_fast"])
            outcomes = batch.run(passes)
    _show_outcomes(outcomes, messages)
    messages.say(f"{_counts(outcomes)} in {time.monotonic() - start:.1f} s; report: {path}")
    if lost := sum(outcome.status == "failed" for outcome in outcomes):
        remedy = "fix or remove them, and run the same command again with --resume"
        raise ProcessingError(f"{lost} of {len(outcomes)} files failed; {remedy}")


def _show_plan(requests: Sequence[Request], *, resume: bool, overwrite: bool) -> None:
    is_there = {each.target: not is_url(each.target) and Path(each.target).exists() for each in requests}
    for each in requests:
        notes = [", ".join(f"{name} {value}" for name, value in each.options.items())]
        if is_there[each.target]:
            notes.append("exists: is replaced" if overwrite else "exists: is not replaced")
        click.echo(printable("; ".join([f"{each.source} -> {each.target}", *filter(None, notes)])))
    taken = 0 if overwrite or resume else sum(is_there.values())
    refused = f"; {taken} of them would fail, since OUTPUT exists (--overwrite, --resume)" if taken else ""
    click.echo(f"{len(requests)} files would be smoothed; nothing is done (dry run){refused}", err=True)


def _report_path(given: str | None, out_dir: str, inputs: Sequence[str], jobs: Sequence[Item]) -> str:
    """Return where the report goes; OutputError if it would replace a file."""
    from beltrami_cli.batch.storage import without_scheme

    path = given
    if path is None:
        if is_url(out_dir):
            remedy = "with a URL as --out-dir, name it with --report"
            raise UsageError(f"the report is a file of this machine; {remedy}")
        path = str(Path(without_scheme(out_dir)) / "batch.jsonl")
    if path == "-":
        raise UsageError(
            "--report cannot be standard output (-), since a later run goes on from it; name a file"
        )
    named = (name for job in jobs for name in (job.source, job.target, *job.settings.input_files()))
    if Path(path).resolve() in {Path(other).resolve() for other in (*inputs, *named)}:
        raise OutputError(path, "the report would replace a file of the batch", "choose another name")
    return path


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


@contextlib.contextmanager
def _passes(
    scheduler: str | None, pieces: int | None, at_once: int | None, memory: int | None, display: Display
) -> Iterator[Sequence[Pass]]:
    """Yield the passes of a batch, with workers for whole files or for chunks."""
    from beltrami_cli.batch.chunks import chunk_workers
    from beltrami_cli.batch.processes import Processes
    from beltrami_cli.batch.run import Workers, in_processes

    processors = KernelParameters().thread_count
    processes = at_once or processors
    with contextlib.ExitStack() as stack:
        client: Any = None
        if scheduler is not None:
            from beltrami_cli.batch.cluster import OnDask, connected, do_on_worker, portable

            client = stack.enter_context(connected(scheduler))
            if not client.nthreads():
                display.messages.say(f"{scheduler} has no workers yet; the files wait for them")
        if pieces is not None:
            # On a cluster, a second chunk is on its way to each worker.
            pool = OnDask(client, at_once, per_worker=2) if client else Processes(min(pieces, processes))
            threads = None if client else min(processes, processors)
            stack.enter_context(contextlib.closing(pool))
            workers = chunk_workers(pool, pieces, memory or default_memory(), display.advanced, threads)
            yield [lambda _: workers]
        elif client:
            # A worker does as many files at once as it has threads, each on one.
            workers = Workers(
                OnDask(client, at_once), lambda item: (do_on_worker, item, portable(item), memory), threads=1
            )
            yield [lambda _: workers]
        else:
            yield in_processes(processes, memory or default_memory())


def _show_outcomes(outcomes: Sequence[Outcome], messages: Messages) -> None:
    """Print the table, and warnings of options that had no effect on any file."""
    if not messages.quiet:
        show_table(("output", "result", "time", "noise", "change"), list(map(_row, outcomes)), err=True)
    kinds = {kind for part, kind in _KINDS.items() for each in outcomes if (each.report or {}).get(part)}
    typed = [each for each in typed_parameters() if {*each.of} <= {*_KINDS.values()}]
    for each in without_effect(typed, kinds) if kinds else ():
        messages.warn(f"{each.flag} had no effect on any file, as it is for {' and '.join(each.of)}")


def _counts(outcomes: Sequence[Outcome]) -> str:
    states = [outcome.status for outcome in outcomes]
    kinds = ("done", "skipped", "uncoloured", "failed", "not started")
    return ", ".join(f"{states.count(kind)} {kind}" for kind in kinds if kind in states)


def _row(outcome: Outcome) -> list[str]:
    seconds, found = f"{outcome.seconds:.1f} s" if outcome.seconds else "", outcome.figures()
    if found is None:
        return [outcome.output, outcome.status, seconds, "", ""]
    noise, change, is_left = found
    result: str = outcome.status
    if is_left and result == "done":  # it may be changed by levelling
        result = "not smoothed" if change else "left as it is"
    return [outcome.output, result, seconds, show_amount(noise), show_amount(change)]
