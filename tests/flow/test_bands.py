"""A canvas that is smoothed row block by row block in place has the bits of one that is smoothed at once."""

import pytest

from beltrami_cli.flow.beltrami_flow import smooth_in_place
from beltrami_cli.flow.manifolds import grid_manifold
from beltrami_cli.flow.manifolds.canvas import kernel_margin
from beltrami_cli.flow.parameters import TUNABLE, KernelParameters
from flow.split_surfaces import (
    FIXED,
    ON_GRIDS,
    image_plan,
    is_clipped,
    outcome,
    same_bits,
    smooth_mesh,
    textured_plan,
    wavy_surface,
)


def low_row_blocks(monkeypatch):
    """Let row blocks be as low as their margins allow."""
    monkeypatch.setattr(grid_manifold, "ROW_BLOCK_CELLS", 1)
    monkeypatch.setattr(grid_manifold, "CELLS_PER_THREAD", 0)
    monkeypatch.setattr(grid_manifold, "TILE_ROWS", 1)


@pytest.mark.slow
@pytest.mark.parametrize("make", [textured_plan, image_plan])
@pytest.mark.parametrize("name", [*ON_GRIDS, "patches", "chosen"])
def test_row_blocks_have_the_bits_of_the_whole(make, name, monkeypatch):
    given = {**FIXED, "iterations": 3, "metric_steps": 2, **ON_GRIDS.get(name, {"patches": "on"})}
    parameters = KernelParameters(**given)
    if name == "chosen":
        parameters = KernelParameters(threads=2, free=TUNABLE)
    plan = make(parameters)
    choice = plan.choice
    assert name == "world" or is_clipped(plan)
    whole = outcome(plan)
    low_row_blocks(monkeypatch)
    plan = make(parameters)
    assert plan.choice == choice
    assert same_bits(outcome(plan), whole)
    margin = kernel_margin(parameters)
    assert len(grid_manifold.row_blocks(*plan.manifold.geometry.atlas.kind.shape, margin, 2)) >= 3


@pytest.mark.parametrize("make", ["pixels", "pixels with patches", "mesh with patches"])
def test_progress_goes_up_to_the_work_there_is(make, monkeypatch):
    low_row_blocks(monkeypatch)
    parameters = KernelParameters(**FIXED, patches="on" if "patches" in make else "off")
    calls = []
    if "mesh" in make:
        smooth_mesh(wavy_surface(40), parameters, progress=lambda *call: calls.append(call))
    else:
        smooth_in_place(image_plan(parameters), lambda *call: calls.append(call))
    assert len({total for _, total in calls}) == 1
    done = [before for before, _ in calls]
    assert done == sorted(done)
    assert 0.9 * calls[0][1] < done[-1] <= calls[0][1]
