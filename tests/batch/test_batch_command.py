"""`beltrami batch`: every file as `smooth` makes it, whatever happens to the others, and nothing done twice."""

import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from batch.batches import (
    QUICK,
    batch,
    copies,
    files_in,
    lines_of,
    report_of,
    smoothed,
    statuses,
    without_workers,
    write_textured,
)
from beltrami_cli.batch.item import Item
from beltrami_cli.batch.work import do_item
from beltrami_cli.fields import override
from beltrami_cli.formats.registry import open_document
from beltrami_cli.layers.settings import DEFAULTS
from cli.commands import COMMAND, SAMPLES, beltrami, refused
from processes import children, described, wait_for

SAMPLE_OF = {
    "a.ply": "terrain-noisy.ply",
    "b.obj": "nonmanifold-noisy.obj",
    "deep/c.glb": "terrain-noisy.glb",
}
SCANS = (*SAMPLE_OF, "skin/model.obj")


def make_scans(folder):
    """Write meshes, and a model with a library and a texture."""
    for place, name in SAMPLE_OF.items():
        (folder / place).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(SAMPLES / name, folder / place)
    (folder / "skin").mkdir()
    write_textured(folder / "skin")
    return folder


@pytest.fixture
def scans(tmp_path):
    return make_scans(tmp_path / "scans")


# 2 s: the processes of a batch are the point here, and in the tests below that kill some.
@pytest.mark.slow
def test_each_file_is_as_smooth_makes_it_to_the_last_byte(scans, tmp_path):
    out, single = tmp_path / "out", tmp_path / "single"
    batch(scans, "--out-dir", out, "-j", 3, *QUICK)
    for name, line in report_of(out).items():
        assert line["status"] == "done"
        (single / name).parent.mkdir(parents=True, exist_ok=True)
        smoothed(scans / name, single / name, *QUICK)
    files = files_in(single)
    assert len(files) == 6  # with the library and the texture of one
    assert files_in(out) == files


def test_failures_are_reported_and_the_others_go_on(scans, tmp_path):
    (scans / "0.ply").write_bytes(b"no model")
    said = batch(scans, "--out-dir", tmp_path / "out", *QUICK, code=1)
    assert said.count("0.ply: the content is of no known format") == 1
    assert "1 of 5 files failed" in said.splitlines()[-1]
    assert statuses(tmp_path / "out") == {"0.ply": "failed", **dict.fromkeys(SCANS, "done")}
    assert report_of(tmp_path / "out")["0.ply"]["exit_code"] == 3


@pytest.mark.slow
def test_fail_fast_starts_nothing_more(scans, tmp_path):
    (scans / "0.ply").write_bytes(b"no model")
    out = tmp_path / "out"
    batch(scans, "--out-dir", out, "--fail-fast", *QUICK, code=1)
    found = statuses(out)
    assert found.pop("0.ply") == "failed"
    assert set(found.values()) == {"not started"}
    shutil.copy(SAMPLES / "terrain-noisy.ply", scans / "0.ply")
    batch(scans, "--out-dir", out, "--resume", *QUICK)
    assert set(statuses(out).values()) == {"done"}


def cut_off(record):
    record.write_text(record.read_text()[:-20])


# What changes below a folder after a batch; the options of the next run; the files that are not skipped.
CHANGES = {
    "nothing": (lambda folder: None, (), {}),
    "the threads": (lambda folder: None, ("--threads", 1), {}),
    "a parameter": (lambda folder: None, ("--beta", 20), dict.fromkeys(SCANS, "done")),
    "a mesh": (
        lambda folder: shutil.copy(SAMPLES / "terrain-clean.ply", folder / "scans" / "a.ply"), (),
        {"a.ply": "done"},
    ),
    "a sidecar file": (
        lambda folder: shutil.copy(SAMPLES / "mirrored-clean.png", folder / "scans" / "skin" / "skin.png"), (),
        {"skin/model.obj": "done"},
    ),
    "a result is gone": (lambda folder: (folder / "out" / "b.obj").unlink(), (), {"b.obj": "done"}),
    "a result is edited": (
        lambda folder: (folder / "out" / "a.ply").write_bytes(b"by hand"), (), {"a.ply": "failed"}
    ),
    "a result is edited, which may be replaced": (
        lambda folder: (folder / "out" / "a.ply").write_bytes(b"by hand"), ("--overwrite",), {"a.ply": "done"}
    ),
    "the end of the record": (
        lambda folder: cut_off(folder / "out" / "batch.jsonl"), ("--overwrite",), {"skin/model.obj": "done"}
    ),
}  # fmt: skip


@pytest.fixture(scope="module")
def template(tmp_path_factory):
    folder = tmp_path_factory.mktemp("finished")
    make_scans(folder / "scans")
    batch("scans", "--out-dir", "out", *QUICK, cwd=folder)
    return folder


@pytest.fixture
def finished(template, tmp_path):
    """A folder of its own in which a batch is done."""
    shutil.copytree(template, tmp_path, dirs_exist_ok=True)
    record = tmp_path / "out" / "batch.jsonl"
    record.write_text(record.read_text().replace(str(template), str(tmp_path)))
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize("change", CHANGES)
def test_resume_does_again_what_changed_and_nothing_else(change, finished):
    make, options, again = CHANGES[change]
    make(finished)
    out, before = finished / "out", files_in(finished / "out")
    has_failed = "failed" in again.values()
    batch("scans", "--out-dir", "out", "--resume", *QUICK, *options, cwd=finished, code=int(has_failed))
    found = {line["output"].removeprefix("out/"): line["status"] for line in lines_of(out / "batch.jsonl")}
    assert found == dict.fromkeys(SCANS, "skipped") | again
    if has_failed:
        assert files_in(out) == before
    else:
        batch("scans", "--out-dir", "fresh", *QUICK, *options, cwd=finished)
        assert files_in(out) == files_in(finished / "fresh")


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM], ids=lambda number: number.name)
def test_a_run_that_is_killed_leaves_no_half_files_and_is_picked_up(number, tmp_path):
    names = [f"{count:02}.ply" for count in range(12)]
    scans, out = copies("terrain-noisy.ply", names, tmp_path / "scans"), tmp_path / "out"
    arguments = ["batch", str(scans), "--out-dir", str(out), "-j", "2", *QUICK, "-n", "3"]
    process = subprocess.Popen([*COMMAND, *arguments], stderr=subprocess.DEVNULL)
    wait_for(lambda: len(list(out.glob("*.ply"))) >= 3)
    process.send_signal(number)
    assert process.wait() == (143 if number == signal.SIGTERM else -number)

    whole = smoothed(scans / "00.ply", tmp_path / "one.ply", *QUICK, "-n", "3")
    made = {path.name: path.stat().st_mtime_ns for path in out.glob("*.ply")}
    assert 3 <= len(made) < len(names)
    assert all((out / name).read_bytes() == whole for name in made)
    journal = lines_of(out / "batch.jsonl")
    finished = {line["output"].rsplit("/", 1)[1] for line in journal if line["status"] == "done"}
    assert len(finished) >= len(made) - 2  # each of two workers may have one that is not yet in the report

    time.sleep(0.5)  # for workers without a leader to notice
    batch(*arguments[1:], "--resume")
    assert all((out / name).read_bytes() == whole for name in names)
    assert {path.name for path in out.iterdir()} == {*names, "batch.jsonl"}  # nothing else is left
    assert {name for name in finished if (out / name).stat().st_mtime_ns == made[name]} == finished
    assert {name for name, status in statuses(out).items() if status == "skipped"} >= finished


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="/proc lists the workers")
def test_a_worker_that_is_killed_fails_only_its_file_which_is_tried_again(tmp_path):
    names = ("a.ply", "b.ply", "c.ply")
    scans, out = copies("knot-noisy.ply", names, tmp_path / "scans"), tmp_path / "out"
    arguments = ["batch", str(scans), "--out-dir", str(out), "-j", "2", "-v", *QUICK, "-n", "40"]
    process = subprocess.Popen([*COMMAND, *arguments], stderr=subprocess.PIPE)
    record = out / "batch.jsonl"
    wait_for(lambda: workers_of(process))
    (worker, *_) = workers_of(process)
    os.kill(worker, signal.SIGSTOP)  # so that it still has a file when it is killed, however long this takes
    # The third file is started after the stopped worker has been sent one.
    wait_for(lambda: record.exists() and record.read_text().count('"started"') == 3)
    os.kill(worker, signal.SIGKILL)
    said = process.communicate(timeout=120)[1].decode()
    assert process.returncode == 0, said
    assert "so it waits" in said
    assert statuses(out) == dict.fromkeys(names, "done")
    assert len(set(files_in(out).values())) == 1


def workers_of(process):
    """Return the processes of a batch that smooth files, by their numbers."""
    return [child for child in children(process.pid) if b"spawn_main" in described(child, "cmdline")]


MANIFESTS = {
    "jobs.toml": """
        iterations = 1
        metric-steps = 0
        t = 0.5
        beta-growth = 1
        beta = 10
        [[files]]
        input = "a.ply"
        output = "first/x.obj"
        [[files]]
        input = "b.obj"
        beta = 3.5
        space = "linear"
        channels = ["red", "green"]
        """,
    "jobs.csv": (
        "input,output,iterations,metric_steps,time-step,beta_growth,beta,space,channels\n"
        'a.ply,first/x.obj,1,0,0.5,1,10,,\nb.obj,,1,0,0.5,1,3.5,linear,"red,green"\n'
    ),
    "jobs.jsonl": (
        '{"input": "a.ply", "output": "first/x.obj", "n": 1, "metric_steps": 0, '
        '"t": 0.5, "beta-growth": 1, "beta": 10}\n'
        '\n{"input": "b.obj", "n": 1, "metric_steps": 0, "t": 0.5, "beta-growth": 1, "beta": 3.5, "space": "linear", '
        '"channels": ["red", "green"]}\n'
    ),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", MANIFESTS)
def test_a_manifest_has_parameters_for_each_file(name, scans, tmp_path):
    (scans / name).write_text(MANIFESTS[name])
    out = tmp_path / "out"
    batch(scans / name, "--out-dir", out, "--beta", 99)  # for all, so what the manifest says counts for more
    first = smoothed(scans / "a.ply", tmp_path / "x.obj", *QUICK)
    assert (out / "first" / "x.obj").read_bytes() == first
    options = [*QUICK, "--beta", 3.5, "--space", "linear", "--channels", "red,green"]
    assert (out / "b.obj").read_bytes() == smoothed(scans / "b.obj", tmp_path / "b.obj", *options)


def test_files_in_manifests_lie_beside_them(scans, tmp_path):
    count = len(open_document(str(scans / "a.ply")).coloured_vertices().positions)
    np.save(scans / "sigma.npy", np.full(count, 0.05, np.float32))
    (scans / "jobs.toml").write_text('[[files]]\ninput = "a.ply"\nnoise = "sigma.npy"\n')
    batch(scans / "jobs.toml", "--out-dir", tmp_path / "out", *QUICK, cwd=tmp_path)
    (line,) = lines_of(tmp_path / "out" / "batch.jsonl")
    assert line["report"]["vertices"]["noise"]["red"] == pytest.approx(0.05)
    assert str(scans / "sigma.npy") in line["read"]


@pytest.mark.parametrize(
    ("text", "code", "words"),
    [
        ('[[files]]\ninput = "a.ply"\nbetta = 8', 2, "file 1: betta is not an option of this command"),
        ('[[files]]\ninput = "a.ply"\nbeta = true', 2, "file 1: beta can be no truth value"),
        ('[[files]]\ninput = "a.ply"\nwindow = 4', 2, "file 1: --window is 4"),
        ('[[files]]\ninput = "a.ply"\nspace = "pink"', 2, "file 1: Invalid value for '--space'"),
        ('[[files]]\ninput = "missing.ply"', 3, "there is no such file"),
        ("[[files]]\nbeta = 8", 3, "it has no input"),
        ("beta = 8", 3, "no table [[files]]"),
        ("beta = ", 3, "the manifest cannot be read"),
    ],
)
def test_faults_of_manifests_are_reported_before_anything_is_done(text, code, words, scans, tmp_path):
    (scans / "jobs.toml").write_text(text)
    refused(tmp_path, "batch", "scans/jobs.toml", "--out-dir", "out", code=code, said=words)


@pytest.mark.slow
def test_a_preset_of_a_file_counts_for_more_than_options_for_all(scans, tmp_path):
    (scans / "jobs.csv").write_text("input,preset\na.ply,paper\n")
    batch(scans / "jobs.csv", "--out-dir", tmp_path / "out", "-n", 2, "--beta", 10)
    expected = smoothed(scans / "a.ply", tmp_path / "one.ply", "--preset", "paper", "--beta", 10)
    assert (tmp_path / "out" / "a.ply").read_bytes() == expected


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "name"),
    [
        (("--suffix", "-clean"), "a-clean.ply"),
        (("--suffix", ".clean.obj"), "a.clean.obj"),
        (("--format", "obj", "--suffix", ".v2"), "a.v2.obj"),
    ],
)
def test_names_of_outputs(options, name, scans, tmp_path):
    batch("*.ply", "--out-dir", tmp_path, *options, *QUICK, cwd=scans)
    assert list(report_of(tmp_path)) == [name]
    assert open_document(str(tmp_path / name)).format == name.rsplit(".", 1)[1]


def test_file_urls_are_paths(scans, tmp_path):
    batch(f"file://{scans}/*.ply", "--out-dir", f"file://{tmp_path}/out", *QUICK)
    (line,) = lines_of(tmp_path / "out" / "batch.jsonl")
    assert (line["input"], line["output"]) == (f"{scans}/a.ply", f"{tmp_path}/out/a.ply")


def test_two_files_never_become_one(scans, tmp_path):
    shutil.copy(scans / "a.ply", scans / "deep" / "a.ply")
    inputs = (scans / "a.ply", scans / "deep" / "a.ply")
    assert "would both become" in batch(*inputs, "--out-dir", tmp_path / "out", code=2)
    (scans / "a.off").write_text("OFF\n")  # read where the outputs have another format
    said = batch(scans, "--out-dir", tmp_path / "out", "--format", "ply", code=2)
    assert "a.off and" in said
    assert "name one of them instead" in said
    report = ("--out-dir", tmp_path, "--report", scans / "b.obj", "--overwrite")
    assert "would replace a file of the batch" in batch(scans / "b.obj", *report, code=4)
    assert "replaced by its own output" in batch(scans, "--out-dir", scans, "--overwrite", code=2)


@pytest.mark.slow
def test_a_file_that_wants_more_than_its_share_of_memory_is_done_alone(scans, tmp_path):
    size = (scans / "b.obj").stat().st_size
    share = size - 1000  # enough for the other one, too little for this one
    assert share > (scans / "deep" / "c.glb").stat().st_size
    inputs = (scans / "b.obj", scans / "deep" / "c.glb")
    said = batch(*inputs, "--out-dir", tmp_path / "out", "-j", 2, "--max-memory", 2 * share, "-v", *QUICK)
    assert "b.obj: wants more than its share of memory" in said
    assert set(statuses(tmp_path / "out").values()) == {"done"}


def test_a_dry_run_says_what_would_be_done_and_does_nothing(tmp_path):
    scans, out = copies("nonmanifold-noisy.ply", ("a.ply", "b.ply"), tmp_path / "scans"), tmp_path / "out"
    (tmp_path / "jobs.toml").write_text('[[files]]\ninput = "scans/b.ply"\noutput = "new/b.glb"\nbeta = 8\n')
    run = beltrami("batch", scans / "a.ply", tmp_path / "jobs.toml", "--out-dir", out, "--dry-run", text=True)
    assert run.stdout.splitlines() == [
        f"{scans / 'a.ply'} -> {out / 'a.ply'}",
        f"{scans / 'b.ply'} -> {out / 'new' / 'b.glb'}; beta 8",
    ]
    assert "2 files would be smoothed" in run.stderr
    assert not out.exists()
    out.mkdir()
    (out / "a.ply").write_bytes(b"old")
    run = beltrami("batch", scans, "--out-dir", out, "--dry-run", text=True)
    assert "1 of them would fail" in run.stderr
    assert (out / "a.ply").read_bytes() == b"old"
    again = beltrami("batch", scans, "--out-dir", out, "--dry-run", "--overwrite", text=True)
    assert "exists: is replaced" in again.stdout
    assert "would fail" not in again.stderr


@pytest.mark.slow
@pytest.mark.parametrize("is_installed", [True, False], ids=["no scheduler", "no Dask"])
def test_a_batch_that_finds_no_workers_makes_no_folder(is_installed, tmp_path, monkeypatch):
    if is_installed:
        pytest.importorskip("distributed")
    else:
        monkeypatch.setitem(sys.modules, "distributed", None)
    scans = copies("nonmanifold-noisy.ply", ("a.ply",), tmp_path / "scans")
    with socket.create_server(("127.0.0.1", 0)) as closed:
        address = f"tcp://127.0.0.1:{closed.getsockname()[1]}"
    for pieces in ((), ("--pieces", 2)):
        words = (scans, "--out-dir", tmp_path / "deep" / "out", "--scheduler", address, *pieces)
        said = batch(*words, *QUICK, code=1)
        assert "no Dask scheduler answers there" in said if is_installed else "not installed" in said
        assert not (tmp_path / "deep").exists()


def test_files_without_colours_are_no_failures_if_they_may_be_skipped(tmp_path):
    shutil.copy(SAMPLES / "nonmanifold-noisy.ply", tmp_path / "a.ply")
    (tmp_path / "b.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    words = ("batch", tmp_path / "a.ply", tmp_path / "b.obj", "--out-dir", tmp_path / "out", *QUICK)
    with without_workers():
        assert "1 done, 1 failed" in beltrami(*words, code=1, text=True).stderr
        again = beltrami(*words, "--resume", "--skip-uncoloured", text=True).stderr
        assert "1 skipped, 1 uncoloured" in again
        # It is tried again, since it may have colours now.
        shutil.copy(SAMPLES / "nonmanifold-noisy.obj", tmp_path / "b.obj")
        assert "1 done, 1 skipped" in beltrami(*words, "--resume", "--skip-uncoloured", text=True).stderr
        (tmp_path / "a.ply").write_text("ply\n")
        assert "1 failed" in beltrami(*words, "--resume", "--skip-uncoloured", code=1, text=True).stderr


@pytest.mark.parametrize(
    ("sample", "settings"),
    [
        ("mirrored-noisy.obj", {"names": ("absent*",)}),  # about the model
        ("knot-noisy.ply", {"height": "h.png"}),  # about an option
        ("mirrored-noisy.obj", {"smooth_geometry": True}),
        ("absent.ply", {}),  # about a file
    ],
)
def test_a_failure_begins_with_its_file_once(sample, settings, tmp_path):
    source, target = str(SAMPLES / sample), str(tmp_path / f"out{Path(sample).suffix}")
    error = do_item(Item(source, target, override(DEFAULTS, **settings)), None).outcome.error
    assert error.startswith(f"{source}: ")
    assert error.count(f"{source}: ") == 1
