"""Manifests and records of other people: they neither lead `beltrami batch` elsewhere, nor make it replace a file."""

import json
import os
import shutil

import pytest

from batch.batches import QUICK, batch, files_in, lines_of, statuses, write_textured
from beltrami_cli.batch.record import Record
from beltrami_cli.errors import InputError
from cli.commands import SAMPLES
from hostile.folders import snapshot

MINE = b"written by another user"


@pytest.fixture
def scan(tmp_path):
    path = tmp_path / "scans" / "a.ply"
    path.parent.mkdir()
    shutil.copy(SAMPLES / "terrain-noisy.ply", path)
    return path


@pytest.fixture
def made(scan, tmp_path):
    """The folder of a batch that is done, and the line of its record."""
    out = tmp_path / "out"
    batch(scan, "--out-dir", out, *QUICK)
    (line,) = lines_of(out / "batch.jsonl")
    return out, line


def write_record(out, *lines, end="\n"):
    out.mkdir(exist_ok=True)
    text = "\n".join(line if isinstance(line, str) else json.dumps(line) for line in lines)
    (out / "batch.jsonl").write_text(text + end)


def refused_manifest(scan, tmp_path, folder, entry):
    """Run a batch of a manifest of one line, which must be refused and change nothing; return what it says."""
    manifest = scan.parent / "jobs.jsonl"
    manifest.write_text(json.dumps({"input": "a.ply", **entry}))
    before = snapshot(tmp_path)
    report = ("--report", tmp_path / "report.jsonl")
    said = batch(manifest, "--out-dir", folder, "--overwrite", *report, *QUICK, code=3)
    assert snapshot(tmp_path) == before
    assert "line 1: it" in said
    return said


@pytest.mark.parametrize(
    ("folder", "output"),
    [
        *(("{tmp}/out", output) for output in ("../b.ply", "x/../../b.ply", "{tmp}/b.ply", "..", "memory://out/b.ply")),
        *(("memory://out", output) for output in ("/b.ply", "../b.ply", "memory://other/b.ply")),
    ],
)  # fmt: skip
def test_an_output_of_a_manifest_stays_below_the_folder_of_all(folder, output, scan, tmp_path):
    if "://" in folder:
        pytest.importorskip("fsspec")
    entry = {"output": output.format(tmp=tmp_path)}
    assert "leaves --out-dir" in refused_manifest(scan, tmp_path, folder.format(tmp=tmp_path), entry)


@pytest.mark.parametrize("entry", [{"input": "a\0.ply"}, {"output": "b\0.ply"}, {"output": "\ud800.ply"}])
def test_names_that_no_file_can_have_are_refused_in_manifests(entry, scan, tmp_path):
    assert "it has the character U+" in refused_manifest(scan, tmp_path, tmp_path / "out", entry)


@pytest.mark.slow
def test_no_file_beside_one_that_was_only_started_is_replaced(tmp_path):
    write_textured(tmp_path)
    out = tmp_path / "out"
    batch(tmp_path / "model.obj", "--out-dir", out, *QUICK)
    whole = files_in(out)
    (line,) = lines_of(out / "batch.jsonl")
    started = {**line, "status": "started", "written": {}, "read": {}, "report": None}
    for name in whole:  # an attempt that put all of them in place, but one that is not its own
        (out / name).write_bytes(MINE)
        write_record(out, started)
        batch(tmp_path / "model.obj", "--out-dir", out, "--resume", *QUICK, code=1)
        assert files_in(out) == {**whole, name: MINE}
        (out / name).write_bytes(whole[name])


@pytest.mark.slow
def test_what_was_put_in_place_before_a_run_was_killed_is_done(scan, made):
    out, line = made
    before = (out / "a.ply").stat().st_mtime_ns
    write_record(out, {**line, "status": "started", "written": {}, "read": {}, "report": None})
    batch(scan, "--out-dir", out, "--resume", *QUICK)
    (again,) = lines_of(out / "batch.jsonl")
    assert (again["status"], again["written"]) == ("done", line["written"])
    assert (out / "a.ply").stat().st_mtime_ns == before
    assert {path.name for path in out.iterdir()} == {"a.ply", "batch.jsonl"}


@pytest.mark.slow
def test_results_of_an_earlier_run_are_replaced_after_a_run_that_was_killed(scan, made):
    """As the line that a file is started keeps the hashes of what was there."""
    out, line = made
    write_record(out, {**line, "status": "started", "read": {}, "report": None, "parameters_sha256": ""})
    before = files_in(out)
    batch(scan, "--out-dir", out, "--resume", *QUICK, "--beta", 20)
    assert statuses(out) == {"a.ply": "done"}
    assert files_in(out) != before


CRAFTED = {
    "no table": [], "no such field": {"surprise": 1}, "input": {"input": 5}, "input with NUL": {"input": "a\0b"},
    "output with a surrogate": {"output": "\ud800"}, "status": {"status": "perfect"},
    "list as status": {"status": ["done"]}, "time": {"time": "now"}, "no time": {"time": float("nan")},
    "large time": {"time": 10**400}, "seconds": {"seconds": 10**400}, "negative seconds": {"seconds": -1},
    "error": {"error": {}}, "exit code": {"exit_code": "0"}, "hashes": {"read": [1]},
    "hash": {"written": {"a": "0" * 63}}, "hash of no text": {"written": {"a": 5}},
    "name of a hash": {"read": {"a\0": "0" * 64}},
    "URL among paths": {"read": {"http://127.0.0.1:9/x": "0" * 64}},
    "report": {"report": []},
    "part of a report": {"report": {"vertices": 5}},
    "noise": {"report": {"vertices": {"noise": {"red": "much"}, "change": {"mean": 0}}}},
    "change": {"report": {"vertices": {"noise": {}, "change": {}}}},
    "reading": {"report": {"vertices": {"noise": {"red": 0.1}, "reading": 5, "change": {"mean": 0}}}},
    "large change": {"report": {"vertices": {"noise": {}, "change": {"mean": 10**400}}}},
    "textures": {"report": {"textures": {}}},
    "warnings": {"report": {"warnings": [5]}},
    "deep": {"report": {"x": json.loads("[" * 300 + "]" * 300)}},
}  # fmt: skip


def sound_line(out):
    """Return a line that a run can have written."""
    part = {"noise": {"red": 0.1}, "change": {"mean": 0.1}}
    return {
        "input": "a.ply", "output": f"{out}/a.ply", "status": "done", "parameters_sha256": "0" * 64,
        "time": 1e9, "seconds": 1, "error": "", "exit_code": 0, "read": {"a.ply": "0" * 64},
        "written": {f"{out}/a.ply": "0" * 64},
        "report": {"vertices": part, "image": None, "textures": [part], "warnings": ["none"]},
    }  # fmt: skip


@pytest.mark.parametrize("name", CRAFTED)
def test_lines_that_no_run_can_have_written_are_refused(name, tmp_path):
    crafted, line = CRAFTED[name], sound_line(tmp_path)
    check_refused(tmp_path, {**line, **crafted} if isinstance(crafted, dict) else crafted)


@pytest.mark.parametrize("text", ["[" * 100_000, "\u00e9", "9" * 5000])
def test_lines_that_are_no_json_are_refused(text, tmp_path):
    check_refused(tmp_path, text)


def check_refused(out, crafted):
    record = out / "batch.jsonl"
    write_record(out, sound_line(out))
    Record(str(record), resume=True, overwrite=False)
    write_record(out, crafted, sound_line(out))
    before = record.read_bytes()
    with pytest.raises(InputError, match="line 1 is not of a report of beltrami batch"):
        Record(str(record), resume=True, overwrite=False)
    assert record.read_bytes() == before


def test_a_file_of_one_line_that_is_no_record_is_not_emptied(scan, tmp_path):
    notes = tmp_path / "notes.txt"
    notes.write_text("no end of line")
    report = ("--report", notes)
    said = batch(scan, "--out-dir", tmp_path / "out", *report, "--resume", *QUICK, code=3)
    assert "line 1 is not of a report" in said
    assert notes.read_text() == "no end of line"


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no FIFOs")
def test_nothing_waits_for_what_is_no_file(scan, made):
    out, line = made
    os.mkfifo(out / "pipe")
    write_record(out, {**line, "read": {**line["read"], str(out / "pipe"): "0" * 64}})
    batch(scan, "--out-dir", out, "--resume", *QUICK)
    assert statuses(out) == {"a.ply": "done"}
    report = ("--report", out / "pipe")
    assert "not a regular file" in batch(scan, "--out-dir", out, *report, "--resume", *QUICK, code=3)


@pytest.mark.parametrize("name", ["scans/skin.png", "out/model.mtl", "notes.txt"])
def test_only_a_report_is_replaced_by_a_report(name, scan, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / name).write_bytes(b"precious")
    words = (scan, "--out-dir", tmp_path / "out", "--overwrite", "--report")
    assert "exists, and is not a report" in batch(*words, tmp_path / name, code=4)
    assert (tmp_path / name).read_bytes() == b"precious"
