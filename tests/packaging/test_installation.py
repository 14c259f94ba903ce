"""Tests never run against an installation that is not of the sources."""

import base64
import hashlib
import os
import shutil
import subprocess
import sys
from importlib.metadata import Distribution
from pathlib import Path

import pytest

import installation

TESTS = Path(installation.__file__).parent
CORE = "beltrami_cli/_native.abi3.so"
CHECKOUT = {
    "pyproject.toml": "[tool.pytest.ini_options]\npythonpath = ['tests']\n",
    "docs/points.md": "# Points\n",
    "beltrami_cli/__init__.py": "raise ImportError('of the checkout')\n",
    "beltrami_cli/view/page.html": "<p>\n",
    "beltrami_cli/native/grid/tile.hpp": "int tile;\n",
    "tests/test_package.py": "def test_it():\n    import beltrami_cli\n",
}


def installed_from(root, site):
    """Install the files of a checkout as a wheel does, an hour after they were written."""
    contents = {
        path.replace("docs/", "beltrami_cli/docs/"): (root / path).read_bytes()
        for path in CHECKOUT
        if path.startswith(("beltrami_cli/", "docs/")) and "/native/" not in path
    }
    lines = []
    for name, data in {**contents, CORE: b"compiled"}.items():
        (site / name).parent.mkdir(parents=True, exist_ok=True)
        (site / name).write_bytes(data)
        digest = base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()
        lines.append(f"{name},sha256={digest},{len(data)}\n")
    information = site / "beltrami_cli-1.0.0.dist-info"
    information.mkdir()
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: beltrami-cli\nVersion: 1.0.0\n")
    (information / "RECORD").write_text("".join(lines) + "beltrami_cli-1.0.0.dist-info/RECORD,,\n")
    for path in root.rglob("*"):
        os.utime(path, (1e9, 1e9))
    os.utime(information / "RECORD", (1e9 + 3600, 1e9 + 3600))
    return Distribution.at(information)


@pytest.fixture
def checkout(tmp_path):
    for name, text in CHECKOUT.items():
        (tmp_path / "checkout" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "checkout" / name).write_text(text)
    for name in ("conftest.py", "installation.py"):
        shutil.copy(TESTS / name, tmp_path / "checkout" / "tests" / name)
    return tmp_path / "checkout"


@pytest.mark.parametrize("name", [name for name in CHECKOUT if not name.startswith("tests/")])
def test_every_changed_source_is_noticed(checkout, tmp_path, name):
    installed = installed_from(checkout, tmp_path / "site")
    assert installation.differences(checkout, installed) == []
    (checkout / name).write_text("changed")
    assert installation.differences(checkout, installed) == [name]


def test_sources_that_are_added_or_removed_are_noticed_though_they_are_older(checkout, tmp_path):
    installed = installed_from(checkout, tmp_path / "site")
    (checkout / "docs/points.md").unlink()
    (checkout / "beltrami_cli/view/page.html").rename(checkout / "beltrami_cli/view/renamed.html")
    assert installation.differences(checkout, installed) == [
        "beltrami_cli/docs/points.md", "beltrami_cli/view/page.html", "beltrami_cli/view/renamed.html"
    ]  # fmt: skip


@pytest.mark.slow
def test_pytest_runs_the_installation_and_refuses_one_that_is_stale(checkout, tmp_path):
    site = tmp_path / "site"
    installed_from(checkout, site)
    (site / "beltrami_cli/__init__.py").write_text("")  # that of the checkout cannot be imported
    environment = {**os.environ, "PATH": "", "PYTHONPATH": str(site)}
    environment.pop("PYTEST_XDIST_WORKER", None)

    def run():
        command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"]
        return subprocess.run(command, cwd=checkout, env=environment, capture_output=True, text=True)

    assert "1 passed" in run().stdout
    (checkout / "beltrami_cli/view/page.html").write_text("changed")
    refused = run()
    assert refused.returncode == 1
    assert refused.stdout == ""
    [line] = refused.stderr.splitlines()
    assert "beltrami_cli/view/page.html" in line


@pytest.mark.skipif(sys.platform == "win32", reason="its environments are not made by make")
def test_environments_made_by_make_are_brought_up_to_date(checkout, tmp_path, monkeypatch):
    site, stamp = tmp_path / "site", tmp_path / ".installed-test"
    monkeypatch.setattr(installation, "ROOT", checkout)
    monkeypatch.setattr(installation, "STAMP", stamp)
    installed = installed_from(checkout, site)
    monkeypatch.setattr(installation, "imported_distribution", lambda: installed)
    script = f"echo $@ > {tmp_path}/asked; exit $(cat {tmp_path}/status)"
    (tmp_path / "make").write_text(f"#!/bin/sh\n{script}\n")
    (tmp_path / "make").chmod(0o700)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    stamp.touch()
    (tmp_path / "status").write_text("0")
    installation.ensure_current()
    assert (tmp_path / "asked").read_text().split()[-1] == str(stamp)
    (tmp_path / "status").write_text("2")
    with pytest.raises(SystemExit, match="cannot be installed"):
        installation.ensure_current()
