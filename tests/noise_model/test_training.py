"""Training on few rows, as in a trial."""

import shutil
from multiprocessing.pool import ThreadPool

import numpy as np
import pytest

import backpropagation
import train_sizes
from beltrami_cli.flow.noise import network
from configuration import WEIGHTS


@pytest.mark.parametrize("rows", [60, 2 * train_sizes.CHUNK])
def test_all_rows_that_were_asked_for_are_trained_on(rows, tmp_path, monkeypatch):
    made = {"training": 0, "test": 0}

    def make_rows(kind, part, number, seed, count, roots, weights):
        made[part] += count
        return [np.ones((count, 5), np.float32), np.ones(count), np.resize([0.0, 5.0], count)]

    monkeypatch.setattr(train_sizes, "make_rows", make_rows)
    monkeypatch.setattr(train_sizes, "Pool", ThreadPool)
    monkeypatch.setattr(train_sizes, "EPOCHS", 1)
    shutil.copy(WEIGHTS / "grid_weights.npz", tmp_path)
    train_sizes.train_kind("grid", [], tmp_path, count=rows, processes=1)
    families = len(train_sizes.FAMILIES["grid"])
    assert made == {"training": families * rows, "test": families * rows}
    assert network.Weights.load(tmp_path / "grid_sizes.npz").means["evidence"].shape == (5,)


def test_rows_that_do_not_fill_a_batch_are_refused():
    with pytest.raises(SystemExit, match="3 rows do not fill a batch of 4"):
        next(backpropagation.shuffled(np.random.default_rng(0), 3, 4))
