"""Smooth one file of a batch."""

from __future__ import annotations

import dataclasses
import os
import time
import traceback
from pathlib import Path
from typing import TYPE_CHECKING

from beltrami_cli.batch.item import Attempt, Item, Outcome, failed, outcome_of
from beltrami_cli.batch.staging import staged
from beltrami_cli.batch.storage import hash_at
from beltrami_cli.errors import BeltramiError, MemoryLimitError, NoColoursError
from beltrami_cli.formats.files.access import Access, Hooks
from beltrami_cli.formats.files.paths import is_url
from beltrami_cli.jobs.job import Job
from beltrami_cli.jobs.progress import Progress, Share
from beltrami_cli.jobs.writing.file_set import FileSet
from beltrami_cli.surface.memory import limited_memory

if TYPE_CHECKING:
    from beltrami_cli.flow.chunks import Chunking
    from beltrami_cli.jobs.smooth_report import SmoothReport


def do_item(
    item: Item, memory: int | None, progress: Progress | None = None, *,
    is_alone: bool = True, local: Item | None = None, chunking: Chunking | None = None,
) -> Attempt:  # fmt: skip
    """Smooth one file; a failure is returned, not raised. Only if the process `is_alone` can its memory be limited.

    `local`: the item by its names on this machine.
    """
    start = time.monotonic()
    try:
        with limited_memory(memory if is_alone else None, item.source):
            outcome = _smooth_staged(item, local or item, memory, progress, chunking)
        return Attempt(dataclasses.replace(outcome, seconds=round(time.monotonic() - start, 3)))
    except BeltramiError as error:
        is_named = error.name in (item.source, item.target)
        message = str(error) if is_named else f"{item.source}: {error}"
        outcome = failed(item, message, error.exit_code, time.monotonic() - start)
        if item.skip_uncoloured and isinstance(error, NoColoursError):
            outcome = dataclasses.replace(outcome, status="uncoloured")
        return Attempt(outcome, isinstance(error, MemoryLimitError))
    except Exception as error:  # a bug, too, is a failure of this file only
        cause = " ".join(f"{item.source}: unexpected error: {type(error).__name__}: {error}".split())
        message = f"{cause}; run again with -vv and report it"
        return Attempt(failed(item, message, 1, time.monotonic() - start), traceback=traceback.format_exc())


def _smooth_staged(
    item: Item, local: Item, memory: int | None, progress: Progress | None, chunking: Chunking | None
) -> Outcome:
    to_url = is_url(local.target)
    with staged(local.source, local.target) as stage:
        staged_item = dataclasses.replace(
            local, source=stage.source, target=stage.target,
            overwrite=local.overwrite or to_url, is_retry=local.is_retry and not to_url,
        )  # fmt: skip
        try:
            # Files that the source refers to are downloaded when they are first looked for.
            hooks = Hooks(stage.note, stage.download)
            access = Access(local.outside, memory, columns=local.columns, hooks=hooks)
            report = _smooth(staged_item, access, progress, chunking)
        except BeltramiError as error:
            names = {stage.source: item.source, stage.target: item.target}
            error.name = names.get(error.name, error.name)
            error.args = (str(error).replace(stage.source, item.source).replace(stage.target, item.target),)
            raise
        sidecars = report.written[1:]
        written_names = [item.target, *sidecars]
        report = dataclasses.replace(report, input=item.source, output=item.target, written=written_names)
        if to_url:
            written = stage.upload(sidecars, overwrite=local.overwrite, is_retry=local.is_retry)
        else:
            output = Path(os.path.realpath(local.target))
            files = (output, *(output.parent / name for name in sidecars))
            written = {str(file): hash_at(str(file)) for file in files}
        return outcome_of(item, "done", read=stage.read, written=written, report=dataclasses.asdict(report))


def _smooth(item: Item, access: Access, progress: Progress | None, chunking: Chunking | None) -> SmoothReport:
    from beltrami_cli.jobs.smooth import smooth_file

    with FileSet() as files:
        whole = None if progress is None else Share(forward=progress)
        job = Job(access, whole, item.overwrite or item.is_retry, files=files, chunking=chunking)
        report = smooth_file(item.source, item.target, item.settings, job, unwrap=item.unwrap)
        if item.is_retry and not item.overwrite:
            files.keep_equal()
        files.commit()
    return report
