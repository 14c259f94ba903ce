"""A report, preview or map replaces a file of others only if it and `--overwrite` are both on the command line."""

from __future__ import annotations

import json

import pytest

from batch.batches import without_workers
from beltrami_cli.jobs.compare.files import is_map
from beltrami_cli.jobs.smooth import is_report
from beltrami_cli.view.render import is_preview
from cli.commands import SAMPLES, beltrami, refused

NOISY = SAMPLES / "nonmanifold-noisy.ply"
QUICK = ("-n", "1", "--fast")
SMOOTH = ("smooth", NOISY, "out.ply", *QUICK)
COMPARE = ("compare", NOISY, NOISY)
BATCH = ("batch", NOISY, "--out-dir", "out", *QUICK)
NAMED = {
    "report": (SMOOTH, "BELTRAMI_SMOOTH_REPORT", "file.json"),
    "preview": (SMOOTH, "BELTRAMI_SMOOTH_PREVIEW", "file.png"),
    "map": (COMPARE, "BELTRAMI_COMPARE_MAP", "file.ply"),
    "record": (BATCH, "BELTRAMI_BATCH_REPORT", "file.jsonl"),
}
OPTIONS = {"report": "--report", "preview": "--preview", "map": "--map", "record": "--report"}


@pytest.fixture
def _without_workers():
    with without_workers():
        yield


# A preview takes 4 s: it is drawn twice at its full size.
@pytest.mark.slow
@pytest.mark.usefixtures("_without_workers")
@pytest.mark.parametrize("kind", NAMED)
def test_a_file_of_others_is_replaced_only_if_the_command_line_names_it(kind, tmp_path):
    arguments, variable, name = NAMED[kind]
    (tmp_path / "out").mkdir()
    (tmp_path / "out.ply").write_text("old")
    file = tmp_path / name
    file.write_text("precious")
    table = f"[{arguments[0]}]\n{variable.rpartition('_')[2].lower()} = {json.dumps(name)}\n"
    configuration = tmp_path.parent / f"{tmp_path.name}.toml"
    configuration.write_text(table)
    overwriting = {variable.rpartition("_")[0] + "_OVERWRITE": "1"}
    for given, variables in (
        (("--overwrite",), {variable: name}),
        ((OPTIONS[kind], name), overwriting),
        ((), {variable: name, **overwriting}),
        (("--overwrite",), {"BELTRAMI_CONFIG": str(configuration)}),
    ):
        assert "no " in refused(tmp_path, *arguments, *given, code=4, said="--overwrite", env=variables)
    beltrami(*arguments, OPTIONS[kind], name, "--overwrite", cwd=tmp_path)
    assert file.read_bytes()[:8] != b"precious"
    # From now on it is one of ours.
    assert is_preview(file.read_bytes()) == (kind == "preview")
    named = {"cwd": tmp_path, "env": {variable: name}}
    beltrami(*arguments, "--overwrite", **named)
    if kind != "preview":  # which takes seconds to draw
        file.write_bytes(b"")  # in which nothing can be lost
        beltrami(*arguments, "--overwrite", **named)
        assert file.stat().st_size
    beltrami(*arguments, code=4, **named)  # without --overwrite nothing is replaced


def test_what_is_like_one_of_ours_is_not_taken_for_one(tmp_path):
    photo = SAMPLES / "mirrored-noisy.png"
    beltrami("smooth", photo, "out.png", *QUICK, cwd=tmp_path)
    for path in (NOISY, photo, tmp_path / "out.png"):
        assert not is_preview(path.read_bytes())
        assert not is_map(path.read_bytes())
    for text in ("{}", '{\n  "input": "a"\n}', "[]", "# ~/.bashrc", '{"input": "a", "output": "b"}'):
        assert not is_report(text.encode())
