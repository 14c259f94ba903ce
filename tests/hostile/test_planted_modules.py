"""Modules in the working folder, as among downloaded scans, are never imported: by no command, in no process."""

import os
import shutil
import signal
import subprocess
import sys
from importlib.metadata import packages_distributions
from importlib.util import find_spec
from pathlib import Path

import pytest

import beltrami_cli
from batch.batches import QUICK
from beltrami_cli.import_path import safe_environment, secure_imports
from beltrami_cli.surface.worker_process import WorkerError, ask
from cli.commands import COMMAND, SAMPLES
from hostile.textured_models import write_model

# Whatever a command may import: more than what any of them does.
NAMES = {*sys.stdlib_module_names, *packages_distributions()} - {"beltrami_cli"}
AS_MODULE = [sys.executable, "-m", "beltrami_cli"]  # without -P the working folder comes first on its path
USDA = """#usda 1.0
def Mesh "triangle" {
  int[] faceVertexCounts = [3]
  int[] faceVertexIndices = [0, 1, 2]
  point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
  color3f[] primvars:displayColor = [(1, 0, 0), (0, 1, 0), (0, 0, 1)] (interpolation = "vertex")
}
"""

# One of each kind: with worker processes, foreign libraries, pages, pictures and a server.
COMMANDS = {
    "batch": ["batch", ".", "--out-dir", "out", "-j", "2", *QUICK],
    "batch with new textures": ["batch", "a.ply", "--out-dir", "out", "--format", "glb", "--unwrap", *QUICK],
    "batch on a cluster": ["batch", "a.ply", "--out-dir", "out", "--scheduler", "tcp://127.0.0.1:1"],
    "info of USD": ["info", "a.usda"],
    "report": ["report", "a.ply", "b.ply", "out.html"],
    "smooth a texture": ["smooth", "model.obj", "out.obj", *QUICK],
    "view": ["view", "a.ply", "--no-open", "--fast"],
}  # fmt: skip
CODES = {"batch on a cluster": 1, "view": 128 + signal.SIGINT}  # of the others 0


def folder_with_scans(folder):
    folder.mkdir()
    for name in ("a.ply", "b.ply"):
        shutil.copy(SAMPLES / "nonmanifold-noisy.ply", folder / name)
    write_model(folder, "obj", "skin.png", "skin.mtl")
    shutil.copy(SAMPLES / "mirrored-noisy.png", folder / "skin.png")
    (folder / "a.usda").write_text(USDA)
    return folder


def plant(folder, names, kind):
    """Write modules, or packages, that leave their names in a file next to the folder if they are imported."""
    code = f"open({str(folder) + '.caught'!r}, 'a').write(__name__ + '\\n')"
    for name in names:
        path = folder / f"{name}.py" if kind == "module" else folder / name / "__init__.py"
        path.parent.mkdir(exist_ok=True)
        path.write_text(code)


def loaded_by_python(folder, start, environment):
    """Return the names of what Python itself imports before it comes to a module of ours."""
    folder.mkdir()
    (folder / "probe.py").write_text("import sys; print(*sys.modules)")
    command = [*start[:-1], "probe"]
    environment = {**environment, "PYTHONPATH": os.pathsep.join([environment["PYTHONPATH"], str(folder)])}
    run = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=True)
    return {name.partition(".")[0] for name in run.stdout.split()}


def assert_ends_alike_with_planted(name, start, names, kind, environment, tmp_path):
    """A command ends in a folder of planted modules as it does without, and imports none of them."""
    folder = folder_with_scans(tmp_path / "planted")
    plant(folder, names, kind)
    command = [*start, *COMMANDS[name]]
    with subprocess.Popen(command, cwd=folder, env=environment, stderr=subprocess.PIPE, text=True) as process:
        said = process.stderr.readline()
        if name == "view":  # which serves its page by now
            process.send_signal(signal.SIGINT)
        said += process.stderr.read()
    caught = Path(f"{folder}.caught")
    assert not caught.exists(), caught.read_text()
    assert process.returncode == CODES.get(name, 0), said


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_no_command_imports_from_the_working_folder(name, tmp_path):
    if "USD" in name and find_spec("pxr") is None:
        pytest.skip("usd-core is not installed")
    environment = {"PYTHONPATH": "", **os.environ}
    before = loaded_by_python(tmp_path / "probe", AS_MODULE, environment)
    assert_ends_alike_with_planted(name, AS_MODULE, NAMES - before, "module", environment, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["module", "package"])
def test_no_worker_imports_from_the_working_folder(kind, tmp_path):
    """Not even what Python itself imports when it starts: the command is started as the script `beltrami` is."""
    assert_ends_alike_with_planted("batch with new textures", COMMAND, NAMES, kind, os.environ, tmp_path)


def test_a_process_that_the_library_starts_has_no_working_folder_on_its_path(monkeypatch, tmp_path):
    (tmp_path / "probe").mkdir()
    (tmp_path / "probe" / "asked.py").write_text("raise SystemExit('loaded')")
    monkeypatch.chdir(tmp_path / "probe")
    for given, said in (("", "No module named asked"), (str(tmp_path / "probe"), "loaded")):
        monkeypatch.setenv("PYTHONPATH", os.pathsep.join(["", ".", given]))
        with pytest.raises(WorkerError, match=said):
            ask("asked", ({}, {}), seconds=60)


@pytest.mark.parametrize("spelling", ["", ".", "{cwd}", "{cwd}/", "{link}"])
def test_the_working_folder_is_taken_off_the_path_however_it_is_spelled(spelling, monkeypatch, tmp_path):
    (tmp_path / "cwd").mkdir()
    (tmp_path / "link").symlink_to("cwd")
    (tmp_path / "other").mkdir()
    monkeypatch.chdir(tmp_path / "cwd")
    monkeypatch.setattr(os, "environ", os.environ | {"PYTHONPATH": f"{os.pathsep}{tmp_path}"})
    entry = spelling.format(cwd=tmp_path / "cwd", link=tmp_path / "link")
    monkeypatch.setattr(sys, "path", [entry, str(tmp_path / "other"), str(tmp_path)])
    secure_imports()
    assert sys.path == [str(tmp_path / "other"), str(tmp_path)]
    assert safe_environment()["PYTHONPATH"] == str(tmp_path)


def test_folders_on_the_path_by_intention_stay_although_they_are_the_working_folder(monkeypatch, tmp_path):
    root = Path(beltrami_cli.__file__).parents[1]  # a checkout, in which its developer works
    for folder, named in ((root, ""), (tmp_path, str(tmp_path))):
        monkeypatch.chdir(folder)
        monkeypatch.setattr(os, "environ", os.environ | {"PYTHONPATH": named})
        monkeypatch.setattr(sys, "path", [str(folder)])
        secure_imports()
        assert sys.path == [str(folder)]
