"""docs/tutorial.md shows what its commands print."""

import re
from pathlib import Path

import numpy as np
import pytest

DOCS = Path(__file__).parents[2] / "docs"
NUMBER = re.compile(r"\d+(?:\.\d+)?")


# 7 s: the commands smooth, compare and report a texture.
@pytest.mark.slow
def test_the_tutorial_shows_what_its_commands_print(monkeypatch):
    monkeypatch.syspath_prepend(str(DOCS))
    import reference

    shown, printed = (DOCS / "tutorial.md").read_text(encoding="utf-8"), reference.tutorial()
    assert NUMBER.sub("#", printed) == NUMBER.sub("#", shown), "run `make reference`"
    # Figures may differ in the last digits on other processors.
    numbers = ([float(number) for number in NUMBER.findall(text)] for text in (printed, shown))
    np.testing.assert_allclose(*numbers, rtol=0.01, atol=0.2, err_msg="run `make reference`")
