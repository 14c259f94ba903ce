"""The script that makes the samples, as a module."""

import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "sample_data"


@pytest.fixture(scope="module")
def make():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(FOLDER))
        patch.delitem(sys.modules, "samples", raising=False)  # the folder of tests
        import make

        yield make
        for path in FOLDER.glob("*.py"):
            sys.modules.pop(path.stem, None)
