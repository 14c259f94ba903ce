"""The weights of the noise model belong to the training in the repository."""

from pathlib import Path

import pytest

from beltrami_cli.flow.noise import network
from configuration import NETWORK, SIZES, code_of, configuration

KINDS = "grid", "cluster"
MOST_BYTES = 400 * 1024  # of all weights


@pytest.mark.parametrize("kind", KINDS)
def test_weights_belong_to_the_configuration(kind):
    remedy = "run `make noise-model`, or noise_model/configuration.py if no value of training changed"
    assert network.weights_of(kind).configuration == configuration(NETWORK), remedy
    assert network.weights_of(kind, "sizes").configuration == configuration(SIZES), remedy


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
    names = [f"{kind}_{part}.npz" for kind in KINDS for part in ("weights", "sizes")]
    paths = [Path(network.__file__).with_name(name) for name in names]
    assert sum(path.stat().st_size for path in paths) <= MOST_BYTES
