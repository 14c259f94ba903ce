"""Parameters that are left open are chosen from the data, on the kind of manifold that they are for."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, cast

from beltrami_cli.flow.grid_manifold import GridManifold
from beltrami_cli.flow.tuning.choice import ON_GRIDS, ON_MESHES, choose, is_noisy
from beltrami_cli.flow.tuning.grid_trial import grid_trial
from beltrami_cli.flow.tuning.mesh_trial import mesh_trial
from beltrami_cli.flow.tuning.rule import RULE_ON_GRIDS, RULE_ON_MESHES, choose_by_rule

if TYPE_CHECKING:
    from beltrami_cli.flow.manifold import Manifold
    from beltrami_cli.flow.mesh_manifold import MeshManifold
    from beltrami_cli.flow.parameters import KernelParameters
    from beltrami_cli.flow.tuning.choice import Choice


def tune(manifold: Manifold, parameters: KernelParameters) -> tuple[KernelParameters, Choice | None]:
    """Return parameters with nothing left open, and what was chosen; without noise nothing is smoothed."""
    closed = dataclasses.replace(parameters, free=())
    if not parameters.is_open:
        return closed, None
    if not is_noisy(manifold.sigma):
        return dataclasses.replace(closed, iterations=0) if "iterations" in parameters.free else closed, None
    on_grid = isinstance(manifold, GridManifold)
    if parameters.fast:
        return choose_by_rule(manifold, parameters, RULE_ON_GRIDS if on_grid else RULE_ON_MESHES)
    trial = (
        grid_trial(manifold)
        if isinstance(manifold, GridManifold)
        else mesh_trial(cast("MeshManifold", manifold))
    )
    return choose(trial, manifold, parameters, ON_GRIDS if on_grid else ON_MESHES)
