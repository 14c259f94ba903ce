"""The file of the Blender extension: complete, the same each time, with the program's own parameters and no network."""

import ast
import json
import sys
import tomllib
import zipfile

import pytest

from beltrami_cli.cli.commands.blender_extension import declared_parameters, write_blender_extension
from beltrami_cli.fields import parameters
from beltrami_cli.flow.parameters import KernelParameters

# What Blender's Python has; os, shutil and subprocess run the program and nothing else.
MAY_IMPORT = {"bpy", "json", "numpy", "os", "pathlib", "re", "shutil", "subprocess", "tempfile"}


@pytest.fixture
def archive(tmp_path):
    target = tmp_path / "beltrami.zip"
    write_blender_extension(str(target), overwrite=False)
    with zipfile.ZipFile(target) as opened:
        yield opened


def test_it_is_an_extension_that_asks_for_files_alone(archive):
    manifest = tomllib.loads(archive.read("blender_manifest.toml").decode())
    assert (manifest["schema_version"], manifest["type"]) == ("1.0.0", "add-on")
    assert manifest["blender_version_min"] == "4.2.0"
    assert set(manifest["permissions"]) == {"files"}
    assert len(manifest["tagline"]) <= 64  # as Blender wants it
    assert len(manifest["permissions"]["files"]) <= 64
    assert {"__init__.py", "parameters.json"} <= set(archive.namelist())


def test_its_sources_import_nothing_that_could_reach_a_network(archive):
    for name in archive.namelist():
        if not name.endswith(".py"):
            continue
        for node in ast.walk(ast.parse(archive.read(name))):
            if isinstance(node, ast.Import):
                assert {each.name for each in node.names} <= MAY_IMPORT
            elif isinstance(node, ast.ImportFrom) and not node.level:
                assert node.module in MAY_IMPORT


def test_parameters_are_those_that_the_program_declares(archive):
    about = json.loads(archive.read("parameters.json"))
    assert about["command"][0] == sys.executable
    assert about["parameters"] == list(declared_parameters())
    found = {each["name"]: each for each in about["parameters"]}
    for declared in parameters(KernelParameters):
        if declared.flags:
            own = found[declared.name]
            assert own["help"].startswith(declared.help)
            assert (own["low"], own["high"]) == (declared.low, declared.high)
    assert {"space", "alpha", "gutter"} <= found.keys()
    assert not {"on", "image_suffix", "height", "guides"} & found.keys()


def test_two_of_them_are_equal(tmp_path):
    one, two = tmp_path / "one.zip", tmp_path / "two.zip"
    write_blender_extension(str(one), overwrite=False)
    write_blender_extension(str(two), overwrite=False)
    assert one.read_bytes() == two.read_bytes()
