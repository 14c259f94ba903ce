"""Tries every model in some folders, and mutations of the ones that could be smoothed, and counts the outcomes.

    python tests/fuzz/survey.py [NAME=]FOLDER... [--mutations N] [--list]

Each file is smoothed in a process of its own, into an empty folder: its textures and its vertex colours, where it has
both. The result is compared with `check`. Exits with 1 if anything but colours changed, colours left the range of those
before, a file was left over, anything in the folders changed, or a process crashed, hung or took too much memory.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib
import json
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import BeltramiError, InputError, NoColoursError
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.formats.files.access import Access
from beltrami_cli.formats.registry import open_document
from beltrami_cli.jobs.check import check_files
from beltrami_cli.jobs.job import Job
from beltrami_cli.jobs.smooth import smooth_file
from beltrami_cli.layers.settings import SmoothSettings
from fuzz.test_replay import mutated

if TYPE_CHECKING:
    from collections.abc import Iterator

    from beltrami_cli.formats.document import Document

KEPT = {".ply", ".obj", ".gltf", ".glb", ".usd", ".usda", ".usdc", ".usdz"}
READ = {".off", ".stl", ".3mf", ".dae", ".zae"}
SETTINGS = SmoothSettings(kernel=KernelParameters(iterations=1, beta=10, clipping="keep", threads=1))
ACCESS = Access(memory=4 << 30)
TIMEOUT = 180  # seconds
MAX_MEMORY = 8 << 30  # bytes of addresses, which are always more than the memory in use
PRELOADED = ("layers.texture_layer", "layers.vertex_layer")
OUTCOMES = {
    "smoothed": "only colours changed",
    "converted": "read, written as PLY",
    "uncoloured": "no colours that can be read",
    "refused": "damaged, incomplete or not supported",
    "FAILED": "failed",
}


def models(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.suffix.lower() in KEPT | READ and path.is_file())


def attempt(source: Path, out: Path) -> tuple[str, str]:
    """Smooth and compare; return the outcome and its detail."""
    kept = source.suffix.lower() in KEPT
    target = out / (source.name if kept else f"{source.stem}.ply")
    try:
        document = open_document(str(source), ACCESS)
        both = document.has_vertex_colours() and set(document.slots()) & set(SETTINGS.textures.slots)
        settings = replace(SETTINGS, on="both") if both else SETTINGS
        report = smooth_file(source, target, settings, job=Job(access=ACCESS))
    except InputError as error:
        return _refused("uncoloured" if isinstance(error, NoColoursError) else "refused", error, out)
    except BeltramiError as error:
        return "FAILED", f"{type(error).__name__}: {error}"
    wrong = [path.name for path in out.rglob("*") if path.name.endswith(".tmp")]
    if wrong or (document.has_vertex_colours() and not _within_range(document, target)):
        return "FAILED", f"left over: {wrong}" if wrong else "colours beyond the range of the input"
    if not kept:
        return "converted", report.output
    check = check_files(source, target, Job(ACCESS))
    if not check.faithful:
        return "FAILED", next(f"{d.what}: {d.detail}" for d in check.differences if not d.of_colour)
    return "smoothed", ""


def _within_range(document: Document, target: Path) -> bool:
    """Return whether averages lie within what they were made of, or on the nearest value that the file can hold."""
    before, after = (
        document.coloured_vertices().colours,
        open_document(str(target), ACCESS).coloured_vertices().colours,
    )
    slack = 1 / 255 + 1e-4 * np.abs(before).max()
    low, high = before.min(axis=0), before.max(axis=0)
    low, high = np.minimum(low, np.clip(low, 0, 1)), np.maximum(high, np.clip(high, 0, 1))
    return bool(((after >= low - slack) & (after <= high + slack)).all())


def _refused(outcome: str, error: InputError, out: Path) -> tuple[str, str]:
    left = [path.name for path in out.rglob("*")]
    if left or "\n" in str(error):
        return "FAILED", f"left over: {left}; {error}"
    return outcome, error.cause


def attempt_in_process(source: Path, out: Path) -> tuple[str, str]:
    """Attempt it in a process of its own, which is ended if it takes too long."""
    reader, writer = os.pipe()
    pid = os.fork()
    if pid == 0:
        os.close(reader)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
        resource.setrlimit(resource.RLIMIT_AS, (MAX_MEMORY, MAX_MEMORY))
        try:
            result = attempt(source, out)
        except BaseException as error:
            result = "FAILED", f"{type(error).__name__}: {error}"
        os.write(writer, json.dumps(result).encode()[:4000])
        os._exit(0)
    os.close(writer)
    end = time.monotonic() + TIMEOUT
    while os.waitpid(pid, os.WNOHANG) == (0, 0):
        if time.monotonic() > end:
            os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
            return "FAILED", f"no end within {TIMEOUT} s"
        time.sleep(0.002)
    with os.fdopen(reader, "rb") as file:
        said = file.read()
    if not said:
        return "FAILED", "the process crashed"
    outcome, detail = json.loads(said)
    return outcome, detail


def tried(source: Path) -> tuple[str, str]:
    out = Path(tempfile.mkdtemp(prefix="survey-"))
    try:
        return attempt_in_process(source, out)
    finally:
        shutil.rmtree(out)


def overwritten(data: bytes, chance: random.Random) -> bytes:
    """Change a byte or a few where they are, so that most of a file stays what it was."""
    result = bytearray(data)
    for _ in range(chance.choice([1, 1, 3])):
        result[chance.randrange(len(result))] = chance.randrange(256)
    return bytes(result)


def mutations(source: Path, count: int) -> Iterator[tuple[str, str]]:
    """Try a file with bytes changed, removed and put in; its sidecar files stay as they are."""
    good, chance = source.read_bytes(), random.Random(source.name)
    folder = Path(tempfile.mkdtemp(prefix="survey-"))
    try:
        shutil.copytree(source.parent, folder / "model", ignore_dangling_symlinks=True)
        bad = folder / "model" / source.name
        for number in range(count):
            bad.write_bytes(mutated(good, [good], chance) if number % 2 else overwritten(good, chance))
            outcome, detail = tried(bad)
            yield outcome, f"mutation {number}: {detail}"
    finally:
        shutil.rmtree(folder)


def hashes(folder: Path) -> dict[str, str]:
    return {
        str(path): hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""
        for path in folder.rglob("*")
    }


def table(counts: dict[str, Counter[str]]) -> str:
    lines = [
        f"| what | files | {' | '.join(OUTCOMES.values())} |",
        "| --- |" + " ---: |" * (len(OUTCOMES) + 1),
    ]
    for what, counter in counts.items():
        numbers = [counter.total(), *(counter[outcome] for outcome in OUTCOMES)]
        lines.append(f"| {what} | {' | '.join(map(str, numbers))} |")
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", nargs="+", metavar="[NAME=]FOLDER")
    parser.add_argument("--mutations", type=int, default=0)
    parser.add_argument("--list", action="store_true", help="Print what came of each file.")
    chosen = parser.parse_args()
    for name in ("OpenImageIO", *(f"beltrami_cli.{name}" for name in PRELOADED)):
        importlib.import_module(name)
    counts: dict[str, Counter[str]] = {}
    for each in chosen.folders:
        label, folder = each.rpartition("=")[0], Path(each.rpartition("=")[2])
        label, before = label or folder.name, hashes(folder)
        for source in models(folder):
            what = f"{label}, {source.suffix.lower()}"
            found = [(what, *tried(source))]
            if chosen.mutations and found[0][1] == "smoothed" and source.stat().st_size < 1 << 20:
                found += [(f"{label}, mutations", *result) for result in mutations(source, chosen.mutations)]
            for row, outcome, detail in found:
                counts.setdefault(row, Counter())[outcome] += 1
                if outcome == "FAILED" or (chosen.list and row == what):
                    print(f"{outcome}: {source.relative_to(folder)}: {detail}", file=sys.stderr)
        if hashes(folder) != before:
            print(f"FAILED: {folder} is not as it was", file=sys.stderr)
            counts[f"{label}, the folder itself"] = Counter(FAILED=1)
    counts["all"] = sum(counts.values(), Counter())
    print(table(counts))
    return int(counts["all"]["FAILED"] > 0)


if __name__ == "__main__":
    sys.exit(main())
