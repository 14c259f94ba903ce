"""usd-core without a process for each question."""

import contextlib
import json
from pathlib import Path

import pytest

from beltrami_cli.formats.files.foreign_library import ForeignLibrary
from beltrami_cli.formats.usd.process import carry_out


@pytest.fixture
def usd_core_here(monkeypatch):
    """Asks usd-core in this process: to start one takes 0.3 s. Limits and damaged files need one of its own."""

    def ask(_, question, *__):
        words, arrays = question
        with contextlib.chdir(Path.cwd()):  # the module goes to the folder of the layers
            words, arrays = carry_out(as_json(words), arrays)
        return as_json(words), arrays

    monkeypatch.setattr(ForeignLibrary, "ask", ask)


def as_json(words):
    return json.loads(json.dumps(words))
