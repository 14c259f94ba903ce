"""Errors of files, as programs that use several processes see them."""

from __future__ import annotations

import pickle

import pytest

from beltrami_cli.errors import InputError, OutputError, UnpaintedError


@pytest.mark.parametrize("kind", [InputError, OutputError, UnpaintedError])
def test_an_error_of_a_file_comes_back_from_another_process(kind):
    error = kind("scan.ply", "the file is cut off", "copy it again")
    again = pickle.loads(pickle.dumps(error))
    assert (type(again), str(again), vars(again)) == (kind, str(error), vars(error))
