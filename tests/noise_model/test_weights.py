"""The weights of the noise model belong to the training in the repository."""

from pathlib import Path

import pytest

from beltrami_cli.flow.noise import network
from configuration import configuration

KINDS = "grid", "cluster"
MOST_BYTES = 300 * 1024  # of all weights


@pytest.mark.parametrize("kind", KINDS)
def test_weights_belong_to_the_configuration(kind):
    assert network.weights_of(kind).configuration == configuration(), "run `make noise-model`"


def test_weights_are_small():
    paths = [Path(network.__file__).with_name(f"{kind}_weights.npz") for kind in KINDS]
    assert sum(path.stat().st_size for path in paths) <= MOST_BYTES
