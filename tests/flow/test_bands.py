"""A canvas that is smoothed row block by row block in place has the bits of one that is smoothed at once."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from beltrami_cli.flow import grid_manifold
from beltrami_cli.flow.beltrami_flow import smooth
from beltrami_cli.flow.canvas import kernel_margin
from beltrami_cli.flow.parameters import KernelParameters
from flow.split_surfaces import FIXED, ON_GRIDS, image_plan, is_clipped, outcome, same_bits, textured_plan
from properties.textured_planes import smoothed

THREE_ITERATIONS = {**FIXED, "iterations": 3, "metric_steps": 2}


def low_row_blocks(monkeypatch):
    """Let row blocks be as low as their margins allow."""
    monkeypatch.setattr(grid_manifold, "ROW_BLOCK_CELLS", 1)
    monkeypatch.setattr(grid_manifold, "CELLS_PER_THREAD", 0)
    monkeypatch.setattr(grid_manifold, "TILE_ROWS", 1)


@pytest.mark.slow
@pytest.mark.parametrize("make", [textured_plan, image_plan])
@pytest.mark.parametrize("name", ON_GRIDS)
def test_row_blocks_have_the_bits_of_the_whole(make, name, monkeypatch):
    parameters = KernelParameters(**{**THREE_ITERATIONS, **ON_GRIDS[name]})
    plan = make(parameters)
    assert name == "world" or is_clipped(plan)
    whole = outcome(plan)
    low_row_blocks(monkeypatch)
    plan = make(parameters)
    assert same_bits(outcome(plan), whole)
    margin = kernel_margin(parameters)
    assert len(grid_manifold.row_blocks(*plan.manifold.geometry.atlas.kind.shape, margin, 2)) >= 3


def test_a_margin_that_is_one_cell_too_narrow_is_not_enough(monkeypatch):
    """So the test above would see it."""
    parameters = KernelParameters(**{**FIXED, "metric_scale": 1.0, "beta": 1.0})
    whole = smoothed(image_plan(parameters))
    low_row_blocks(monkeypatch)
    monkeypatch.setattr(grid_manifold, "kernel_margin", lambda parameters: kernel_margin(parameters) - 2)
    assert not np.array_equal(smoothed(image_plan(parameters)), whole)


def test_progress_goes_from_block_to_block_up_to_the_work_there_is(monkeypatch):
    low_row_blocks(monkeypatch)
    plan = image_plan(KernelParameters(**THREE_ITERATIONS))
    calls = []
    smooth(plan, lambda done, total: calls.append((done, total)))
    cells = plan.manifold.geometry.size
    assert {total for _, total in calls} == {3 * cells}
    assert [done for done, _ in calls] == sorted(done for done, _ in calls)
    assert calls[-1][0] <= 3 * cells


@pytest.mark.slow
def test_chosen_parameters_do_not_depend_on_row_blocks(monkeypatch):
    free = dataclasses.replace(
        KernelParameters(threads=2), free=("iterations", "t", "beta", "beta_growth", "metric_steps")
    )
    whole = image_plan(free)
    low_row_blocks(monkeypatch)
    parts = image_plan(free)
    assert parts.choice == whole.choice
    assert np.array_equal(smoothed(parts), smoothed(whole))
