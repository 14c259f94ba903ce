"""The wheel that `make wheel` built installs where there is no compiler, and works there."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
WHEEL = os.environ.get("BELTRAMI_WHEEL")
pytestmark = pytest.mark.skipif(WHEEL is None, reason="`make wheel` builds one, and runs this test")
FOLDER = "Scripts" if sys.platform == "win32" else "bin"


@pytest.fixture(scope="module")
def wheel():
    return ROOT / WHEEL


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """Install the wheel in an environment of its own with nothing else on the path; return its commands' folder."""
    home = tmp_path_factory.mktemp("wheel") / "venv"
    subprocess.run([sys.executable, "-m", "venv", home], check=True)
    commands = home / FOLDER
    environment = {**os.environ, "PATH": str(commands), "CC": "no-compiler", "CXX": "no-compiler"}
    install = [commands / "python", "-m", "pip", "install", "--quiet", "--only-binary=:all:", wheel]
    subprocess.run(install, check=True, env=environment, cwd=home)
    return commands, environment


def test_the_name_says_that_it_serves_later_pythons_and_other_machines(wheel):
    _, _, python, abi, platform = wheel.stem.split("-")
    if sys.version_info >= (3, 12):
        assert (python, abi) == ("cp312", "abi3")
    if sys.platform == "linux":
        assert platform.startswith(("manylinux_", "musllinux_"))


def test_it_holds_the_package_its_manual_and_pages_and_no_sources_of_the_core(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    assert [name for name in names if name.endswith((".cpp", ".hpp", "CMakeLists.txt"))] == []
    assert any(name.startswith("beltrami_cli/_native.") for name in names)
    assert any(name.endswith("share/man/man1/beltrami-smooth.1") for name in names)
    assert "beltrami_cli/docs/tuning.md" in names
    assert not any(name.startswith(("tests/", "docs/", "sample_data/")) for name in names)


def test_it_smooths_where_there_is_no_compiler(installed, tmp_path):
    commands, environment = installed

    def run(*arguments):
        call = [commands / "beltrami", *arguments]
        return subprocess.run(call, check=True, capture_output=True, text=True, env=environment, cwd=tmp_path)

    assert run("--version").stdout.startswith("beltrami, version ")
    assert run("docs", "tuning").stdout.startswith("# Tuning")
    source = ROOT / "sample_data" / "nonmanifold-noisy.ply"
    assert "noise" in run("smooth", source, "clean.ply").stderr
    check = run("check", source, "clean.ply").stdout
    assert "OTHER" not in check
    assert (tmp_path / "clean.ply").read_bytes() != source.read_bytes()
