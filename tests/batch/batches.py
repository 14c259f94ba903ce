"""Running `beltrami batch` and reading its report."""

import contextlib
import json
import shutil
from unittest.mock import patch

from beltrami_cli.batch import run
from beltrami_cli.batch.chunks import InProcess
from beltrami_cli.batch.work import do_item
from cli.commands import SAMPLES, beltrami
from hostile.textured_models import write_model

# Parameters that leave little to compute.
QUICK = ("-n", "1", "-t", "0.5", "--beta", "10", "--beta-growth", "1", "--metric-steps", "0")


def without_workers():
    """Have batches do their files in this process, where others would take half a second each to start."""

    def here(count, memory, threads):
        pool = InProcess(lambda *_: None)
        return run.Workers(pool, lambda item: (do_item, item, memory), threads, has_all_memory=count == 1)

    return patch.object(run, "process_workers", here)


def batch(*arguments, code=0, cwd=None):
    """Run a batch, in this process unless it has `-j`, which must end with a code; return its standard error."""
    here = contextlib.nullcontext() if "-j" in arguments else without_workers()
    with here:
        done = beltrami("batch", *arguments, cwd=cwd, code=code)
    assert done.stdout == b""
    assert b"unexpected error" not in done.stderr
    return done.stderr.decode()


def copies(sample, names, folder):
    """Make a folder with copies of a sample."""
    folder.mkdir()
    for name in names:
        shutil.copy(SAMPLES / sample, folder / name)
    return folder


def write_textured(folder):
    """Write model.obj with its library, skin.mtl, and its texture, skin.png."""
    write_model(folder, "obj", "skin.png", "skin.mtl")
    shutil.copy(SAMPLES / "mirrored-noisy.png", folder / "skin.png")


def lines_of(report):
    return [json.loads(line) for line in report.read_text().splitlines()]


def report_of(out):
    """Return the lines of a report by the names of the outputs below its folder."""
    return {line["output"].removeprefix(f"{out}/"): line for line in lines_of(out / "batch.jsonl")}


def statuses(out):
    return {name: line["status"] for name, line in report_of(out).items()}


def smoothed(source, target, *options):
    """Return what `beltrami smooth` makes of a file."""
    beltrami("smooth", source, target, *options)
    return target.read_bytes()


def files_in(folder):
    """Return the contents of all files by their names below a folder, but for the report."""
    files = (path for path in folder.rglob("*") if path.is_file() and path.name != "batch.jsonl")
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}
