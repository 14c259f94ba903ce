"""The weights of the noise model belong to the training in the repository."""

from pathlib import Path

from configuration import configuration
from network import weights_of_grids

FOLDER = Path(__file__).parents[2] / "noise_model"
MOST_BYTES = 300 * 1024


def test_weights_belong_to_the_configuration():
    assert weights_of_grids().configuration == configuration(), "run `make noise-model`"


def test_weights_are_small():
    assert (FOLDER / "grid_weights.npz").stat().st_size <= MOST_BYTES
