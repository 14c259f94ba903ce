"""What is fuzzed of text files that are read as data: configurations, manifests, records, reports."""

from __future__ import annotations

import tempfile
from pathlib import Path

import click

from beltrami_cli.batch.item import Item, _read_record, is_done, is_ours
from beltrami_cli.batch.plan import plan
from beltrami_cli.cli.batch import _settings
from beltrami_cli.cli.config import load
from beltrami_cli.cli.main import group
from beltrami_cli.errors import UsageError
from beltrami_cli.formats.access import Access
from beltrami_cli.layers.settings import DEFAULTS
from beltrami_cli.view.report import _parameters

_SHARED_MEMORY = "/dev/shm"
_MANIFESTS = (".toml", ".csv", ".jsonl")


def _folder() -> tempfile.TemporaryDirectory[str]:
    """Make a folder with a file in it, in which manifests can name it."""
    made = tempfile.TemporaryDirectory(dir=_SHARED_MEMORY if Path(_SHARED_MEMORY).is_dir() else None)
    (Path(made.name) / "a.ply").write_bytes(b"")
    return made


def read_configuration(data: bytes) -> None:
    """Read a configuration that is named, and what it says for two commands."""
    with _folder() as folder:
        path = Path(folder) / ("pyproject.toml" if data[:1] == b"\1" else "beltrami.toml")
        path.write_bytes(data)
        configuration = load(str(path))
        for command in ("smooth", "batch"):
            group.defaults_from(configuration, command)


def read_manifest(data: bytes) -> None:
    """Read a manifest, whose kind the first byte says, and the parameters for each file."""
    with _folder() as folder:
        path = Path(folder) / f"x{_MANIFESTS[data[0] % 3] if data else '.csv'}"
        path.write_bytes(data[1:])
        for request in plan([str(path)], str(Path(folder) / "out"), "", None):
            assert Path(request.target).is_relative_to(Path(folder) / "out")
            try:
                _settings(request, {})
            except (
                click.UsageError,
                UsageError,
                ValueError,
            ):  # which the command puts behind the line's name
                continue


def read_record(data: bytes) -> None:
    """Read a record, and see whether it says that files are done, or may be replaced."""
    with _folder() as folder:
        path = Path(folder) / "batch.jsonl"
        path.write_bytes(data)
        item = Item(str(Path(folder) / "a.ply"), str(Path(folder) / "b.ply"), DEFAULTS)
        for outcome in _read_record(str(path)).values():
            assert not is_done(item, outcome)
            is_ours(outcome)


def read_report(data: bytes) -> None:
    """Read the report of a run as a page shows it."""
    with _folder() as folder:
        path = Path(folder) / "run.json"
        path.write_bytes(data)
        assert "<script" not in _parameters(str(path), Access())
