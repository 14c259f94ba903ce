"""What is costly to read or to find is read and found once in a run."""

import sys
from collections import Counter
from contextlib import contextmanager

import pytest

from beltrami_cli.formats.files.tokens import Lines
from beltrami_cli.formats.obj.renaming import Renaming
from beltrami_cli.jobs.smooth import smooth_file
from beltrami_cli.layers.selection import Selection
from beltrami_cli.layers.texture_groups import choose_textures
from cli.commands import SAMPLES

ONCE = {
    "tokens": Lines.__init__,
    "libraries": Renaming.written,
    "chosen textures": choose_textures,
    "surfaces": Selection.surfaces.func,
}


@contextmanager
def counted(functions):
    """Count the calls of Python functions, by their names."""
    names = {function.__code__: name for name, function in functions.items()}
    calls = Counter()

    def note(frame, event, _):
        if event == "call" and frame.f_code in names:
            calls[names[frame.f_code]] += 1

    before = sys.getprofile()
    sys.setprofile(note)
    try:
        yield calls
    finally:
        sys.setprofile(before)


@pytest.mark.parametrize("chosen", [{}, {"names": ("*",)}])
def test_a_textured_model_is_parsed_and_searched_once(chosen, tmp_path):
    source = SAMPLES / "mirrored-noisy.obj"
    with counted(ONCE) as calls:
        smooth_file(source, tmp_path / "out.obj", iterations=1, beta=8.0, patches="off", **chosen)
    assert calls == dict.fromkeys(ONCE, 1)
