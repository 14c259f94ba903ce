"""A canvas that is smoothed row block by row block in place has the bits of one that is smoothed at once."""

from functools import partial

import pytest

from beltrami_cli.flow.beltrami_flow import smooth_in_place
from beltrami_cli.flow.manifolds.grid import manifold as grid_manifold
from beltrami_cli.flow.manifolds.grid.margins import kernel_margin
from beltrami_cli.flow.manifolds.iteration import Step
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


@pytest.fixture
def low_blocks(monkeypatch):
    """Return a function that lets row blocks be as low as their margins and tiles allow."""
    return partial(monkeypatch.setattr, grid_manifold, "_CELLS_PER_THREAD", 1)


@pytest.mark.slow
@pytest.mark.parametrize("make", [textured_plan, image_plan])
@pytest.mark.parametrize("name", [*ON_GRIDS, "patches", "chosen"])
def test_row_blocks_have_the_bits_of_the_whole(make, name, low_blocks):
    given = {**FIXED, "iterations": 3, "metric_steps": 2, **ON_GRIDS.get(name, {"patches": "on"})}
    parameters = KernelParameters(**given)
    if name == "chosen":
        parameters = KernelParameters(threads=2, free=TUNABLE)
    plan = make(parameters)
    assert name == "world" or is_clipped(plan)
    whole = outcome(plan)
    plan = make(parameters)
    assert (
        len(grid_manifold.row_blocks(plan.manifold.geometry.atlas.kind.shape, kernel_margin(parameters), 1))
        >= 3
    )
    low_blocks()
    assert same_bits(outcome(plan), whole)


def test_only_averages_in_place_change_their_stacks(low_blocks):
    low_blocks()
    manifold = image_plan(KernelParameters(**FIXED)).manifold
    before = manifold.colours.copy()
    metric = manifold.measure(before, Step(4.0, 1.0, regularised=False))
    (average,) = manifold.average([manifold.colours], metric).stacks
    assert same_bits([manifold.colours], [before])
    (in_place,) = manifold.average_in_place([manifold.colours], metric).stacks
    assert in_place is manifold.colours
    assert same_bits([in_place], [average])


@pytest.mark.parametrize("make", ["pixels", "pixels with patches", "mesh with patches"])
def test_progress_goes_up_to_the_work_there_is(make, low_blocks):
    parameters = KernelParameters(**FIXED, patches="on" if "patches" in make else "off")
    calls = []
    if "mesh" in make:
        smooth_mesh(wavy_surface(40), parameters, progress=lambda *call: calls.append(call))
    else:
        low_blocks()
        smooth_in_place(image_plan(parameters), lambda *call: calls.append(call))
    assert len({total for _, total in calls}) == 1
    done = [before for before, _ in calls]
    assert done == sorted(done)
    assert 0.9 * calls[0][1] < done[-1] <= calls[0][1]
