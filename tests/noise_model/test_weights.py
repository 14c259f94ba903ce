"""The weights of the noise model belong to the training in the repository."""

from pathlib import Path

import pytest

from beltrami_cli.flow.noise import network, size
from configuration import NETWORK, SIZES, configuration

KINDS = "grid", "cluster"
MOST_BYTES = 400 * 1024  # of all weights


@pytest.mark.parametrize("kind", KINDS)
def test_weights_belong_to_the_configuration(kind):
    assert network.weights_of(kind).configuration == configuration(NETWORK), "run `make noise-model`"
    assert size.size_weights(kind).configuration == configuration(SIZES), "run `make noise-model`"


def test_weights_are_small():
    names = [f"{kind}_{part}.npz" for kind in KINDS for part in ("weights", "sizes")]
    paths = [Path(network.__file__).with_name(name) for name in names]
    assert sum(path.stat().st_size for path in paths) <= MOST_BYTES
