"""The weights of the noise model belong to the training in the repository."""

import json
from pathlib import Path

import pytest

from beltrami_cli.flow.noise import network
from configuration import FILES, ROOT, code_of, hashes

INSTALLED = Path(network.__file__).parent
MOST_BYTES = 400 * 1024  # of all weights


def test_weights_belong_to_the_configuration():
    stamp = json.loads((ROOT / "noise_model/stamp.json").read_text(encoding="utf-8"))
    remedy = "run `make noise-model`, or noise_model/stamp.py if no value of training changed"
    assert {**hashes(INSTALLED), "values": stamp["values"]} == stamp, remedy


@pytest.mark.parametrize(
    ("suffix", "code", "worded", "other"),
    [
        (".py", "a = 1\nb = 2", '"""A."""\na = 1  # B\n"""\nC\n"""\n\nb = 2\n', "a = 1\nb = 3"),
        (".hpp", "#include <array>\nint a;", "// A\n#include <array>\nint a;  // B", "#include <vector>\nint a;"),
    ],
)  # fmt: skip
def test_the_configuration_depends_on_code_and_not_on_words(suffix, code, worded, other):
    assert code_of(worded, suffix) == code_of(code, suffix) != code_of(other, suffix)


def test_weights_are_small():
    assert sum((INSTALLED / name).stat().st_size for name in FILES) <= MOST_BYTES
