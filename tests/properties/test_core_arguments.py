"""The compiled core refuses every argument that is not what its functions need; none ends the process."""

from contextlib import suppress

import numpy as np
import pytest

from beltrami_cli import _native as core

RANDOM = np.random.default_rng(5)
F32, F64, I32, I64 = np.float32, np.float64, np.int32, np.int64


def numbers(*shape, kind=F32):
    return RANDOM.uniform(0.2, 0.8, shape).astype(kind)


V, SIDE = 9, 6  # vertices, of a square of 3 x 3; cells a side
POSITIONS = np.array([(x, y, 0.1 * x * y) for y in range(3) for x in range(3)], F64)
FACES = np.array(
    [[a, b, c] for s in (0, 1, 3, 4) for a, b, c in ((s, s + 1, s + 3), (s + 1, s + 4, s + 3))], I32
)
EDGES = np.unique(np.sort(FACES[:, [[0, 1], [1, 2], [0, 2]]].reshape(-1, 2)), axis=0)
KIND = np.ones((SIDE, SIDE), np.uint8)
PLANES = numbers(3, SIDE, SIDE)
AT = np.linspace(0, 1, 5)
TABLE = np.linspace(0, 1, 5).astype(F32)
MIXING = (np.eye(3, dtype=F32), np.eye(3, dtype=F32), np.ones(3, F32), np.ones(3, F32), 0.0, 1.0)
NOISE = (np.tile(F32([0.01, 0.1, 1, 1]), (3, 1)), 6.0, TABLE, TABLE, numbers(1, SIDE, SIDE))
CLIPPING = (0.1, True, True)
GRID = {
    "kind": KIND, "squared_lengths": numbers(4, SIDE, SIDE), "scale": numbers(SIDE, SIDE), "metric": PLANES,
    "beta": 1.0, "radius": 3.0, "window_radius": 2, "scheme": "sweep",
}  # fmt: skip
ONE = numbers(1, SIDE, SIDE)
METRIC = {"positions": POSITIONS, "colours": numbers(V, 3), "beta": 1.0, "scales": numbers(V), "threads": 2}
CALLS = {
    "build_atlas": {
        "positions": POSITIONS, "faces": FACES, "uv": POSITIONS[FACES][..., :2] * 2 + 0.1,
        "texture_of": np.zeros(len(FACES), I32), "grids": np.array([[8, 8, 0, 0]], I32), "margin": 2, "threads": 2,
        "allocate": lambda size: np.empty(size, np.uint8), "progress": None,
    },
    "store_colours": {
        "table": np.zeros((7, 3), np.uint8), "pixels": np.arange(4, dtype=I64), "colours": numbers(4, 2),
        "channels": np.array([0, 2], I32), "threads": 2,
    },
    "interpolate": {"places": numbers(7), "at": AT, "table": AT},
    "restore_clipped": {
        "averages": ONE, "share": ONE, "clipping": CLIPPING, "trusted": 2.0, "at": AT, "alpha": AT, "gap": AT + 1,
        "relative": ONE, "threads": 2,
    },
    "impute_clipped": {
        "colours": ONE, "estimate": ONE, "clipping": CLIPPING, "at": AT, "beyond": AT, "relative": ONE, "threads": 2,
    },
    "convolve": {"planes": PLANES, "taps": numbers(3), "threads": 2},
    "means_of_squares": {"kind": KIND, "kinds": KIND[:3, :3].copy(), "planes": PLANES, "side": 2, "threads": 2},
    "add_enlarged": {
        "kind": KIND, "kinds": KIND[:3, :3].copy(), "changes": numbers(3, 3, 3), "planes": PLANES, "side": 2,
        "threads": 2,
    },
    "nearest_marked": {"marked": PLANES[0] > 0.5, "wanted": PLANES[1] > 0.5, "reach": 3, "threads": 2},
    "morton_order": {"positions": POSITIONS},
    "neighbour_means": {
        "values": numbers(V, 3), "edges": EDGES, "weights": numbers(len(EDGES)), "totals": numbers(V, kind=F64),
        "threads": 2,
    },
    "pilot_of_graph": {"colours": numbers(3, V), "edges": EDGES.astype(I64), "variances": numbers(V)},
    "pilot_of_squares": {
        "colours": numbers(3, 2, SIDE, SIDE), "filled": numbers(2, SIDE, SIDE) > 0.4,
        "variances": numbers(2 * SIDE * SIDE),
    },
    "vertex_order": {"positions": POSITIONS, "faces": FACES},
    "local_scale": {"right": PLANES[0], "below": PLANES[1], "window_radius": 2},
    "halo_repeats": {
        "rows": SIDE, "columns": SIDE, "cells": np.array([3, 4, 9]), "sources": np.array([1, 1, 2]),
        "seams": np.zeros(3, I32), "reach": 2, "threads": 2,
    },
    "smooth_grid": GRID | {"colours": PLANES, "repeats": KIND, "time_step": 1.0, "threads": 2, "progress": None},
    "grid_distances": GRID | {"cell": 8},
    "blend_terms": {
        "noisy": PLANES, "probe": PLANES, "estimates": (PLANES,) * 4, "noise": NOISE, "terms": PLANES[:2].copy(),
        "threads": 2,
    },
    "blend_residual": {"noisy": PLANES, "estimate": PLANES, "noise": NOISE, "residual": PLANES.copy(), "threads": 2},
    "blend_share_within": {"estimate": PLANES, "noise": NOISE, "share": PLANES.copy(), "threads": 2},
    "collaborate_on_grid": {
        "kind": KIND, "noisy": PLANES, "pilot": PLANES, "mixing": MIXING, "relative": ONE[0], "has_pilot": True,
        "estimates": PLANES.copy(), "threads": 2, "progress": None,
    },
    "SurfacePatches": {
        "positions": POSITIONS, "edges": EDGES, "axes": np.eye(3)[:2], "priorities": np.arange(V, dtype=np.uint64),
        "threads": 2, "blocks": np.zeros(V, I32),
    },
    "SurfacePatches.collaborate": {
        "noisy": numbers(V, 3), "pilot": numbers(V, 3), "mixing": MIXING, "relative": numbers(V), "has_pilot": True,
        "estimates": numbers(V, 3), "weights": numbers(V, 3), "threads": 2, "progress": None,
    },
    "LocalTriangulation": {"positions": POSITIONS},
    "LocalTriangulation.add_stars": {
        "rows": np.arange(V, dtype=I32), "neighbours": np.tile(np.arange(V, dtype=I32), (V, 1)), "complete": True,
        "keep_unsettled": True, "threads": 2,
    },
}  # fmt: skip
for manifold in ("TriangulatedManifold", "SegmentManifold"):
    CALLS[manifold] = {"faces": FACES, "vertex_count": V}
    CALLS[f"{manifold}.update_metric"] = METRIC
    CALLS[f"{manifold}.smooth"] = {
        "colours": numbers(V, 3), "weights": numbers(V), "time_step": 1.0, "radius": 3.0, "max_samples": 9,
        "threads": 2, "progress": None, "first": 0, "last": V,
    }  # fmt: skip
    CALLS[f"{manifold}.distances"] = {"source": 1, "radius": 3.0, "max_samples": 9}

# Valid after all: what any length, any number of channels or any number serves.
FREE = {
    "one more on axis 0": """
        means_of_squares.planes convolve.planes convolve.taps morton_order.positions vertex_order.positions
        vertex_order.faces build_atlas.positions build_atlas.grids interpolate.places store_colours.table
        smooth_grid.colours smooth_grid.metric grid_distances.metric SurfacePatches.edges LocalTriangulation.positions
        TriangulatedManifold.faces SegmentManifold.faces pilot_of_graph.edges
    """,
    "one more on axis 1": """
        convolve.planes store_colours.table morton_order.positions vertex_order.positions
        TriangulatedManifold.update_metric.positions SegmentManifold.update_metric.positions
        TriangulatedManifold.update_metric.colours SegmentManifold.update_metric.colours neighbour_means.values
        TriangulatedManifold.smooth.colours SegmentManifold.smooth.colours LocalTriangulation.add_stars.neighbours
    """,
    "one more on axis 2": "convolve.planes",
    "no index": """
        SurfacePatches.blocks SurfacePatches.priorities halo_repeats.sources halo_repeats.seams build_atlas.texture_of
    """,
    "beyond all": """
        SurfacePatches.blocks SurfacePatches.priorities halo_repeats.sources halo_repeats.seams build_atlas.grids
    """,
    "another axis": """
        restore_clipped.averages restore_clipped.share restore_clipped.relative impute_clipped.colours
        impute_clipped.estimate impute_clipped.relative
    """,
    "another axis in 4": "blend_terms.noise blend_residual.noise blend_share_within.noise",
    "NaN": """
        build_atlas.uv
        interpolate.table restore_clipped.alpha restore_clipped.gap impute_clipped.beyond neighbour_means.totals
    """,
}


def spoiled(value):
    """Give versions of an argument that are wrong, by names."""
    if isinstance(value, np.ndarray):
        yield "another axis", value[None]
        yield "an axis less", value.ravel() if value.ndim > 1 else value[0]
        yield "no axis", np.array(value.flat[0])
        yield "text", value.astype(str)
        for axis in range(value.ndim):
            yield f"one more on axis {axis}", np.concatenate([value, value.take([0], axis)], axis)
        if value.dtype.kind in "iu" and value.dtype != np.uint8:
            for name, wrong in (("no index", -1), ("beyond all", np.iinfo(value.dtype).max)):
                yield (
                    name,
                    np.concatenate([value.ravel()[:-1], [wrong]]).astype(value.dtype).reshape(value.shape),
                )
        if value.dtype == F64:
            yield "NaN", np.where(np.arange(value.size).reshape(value.shape) == 1, np.nan, value)
    elif isinstance(value, tuple):
        yield "one less", value[:-1]
        yield "none", ()
        for place, part in enumerate(value):
            for name, wrong in spoiled(part):
                yield f"{name} in {place}", (*value[:place], wrong, *value[place + 1 :])
    elif isinstance(value, float):
        yield from {"NaN": np.nan, "-1": -1.0, "text": "a"}.items()
    elif isinstance(value, str):
        yield from {"unknown": "heap", "empty": ""}.items()
    elif isinstance(value, int) and not isinstance(value, bool):
        yield from {"-1": -1, "many bits": 1 << 70, "text": "a"}.items()


def made(call):
    """Return a function of the core, or a method of an object that is ready for it."""
    name, _, method = call.partition(".")
    if not method:
        return getattr(core, name)
    prepared = getattr(core, name)(**CALLS[name])
    if f"{name}.update_metric" in CALLS:
        prepared.update_metric(**METRIC)
    return getattr(prepared, method)


@pytest.mark.parametrize("call", CALLS)
def test_valid_arguments_are_taken(call):
    made(call)(**CALLS[call])


@pytest.mark.parametrize("call", CALLS)
def test_empty_arrays_and_zeros_are_refused_or_serve(call):
    function = made(call)
    for argument, value in CALLS[call].items():
        nothing = value[:0] if isinstance(value, np.ndarray) else 0 if isinstance(value, int) else None
        with suppress(ValueError, TypeError, IndexError):
            function(**CALLS[call] | {argument: nothing})


@pytest.mark.parametrize("manifold", ["TriangulatedManifold", "SegmentManifold"])
@pytest.mark.parametrize("method", ["smooth", "distances"])
def test_a_manifold_without_a_metric_is_refused(manifold, method):
    with pytest.raises(ValueError, match="update_metric"):
        getattr(getattr(core, manifold)(FACES, V), method)(**CALLS[f"{manifold}.{method}"])


@pytest.mark.parametrize("manifold", ["TriangulatedManifold", "SegmentManifold"])
@pytest.mark.parametrize(
    "wrong", [{"max_samples": 0}, {"first": 5, "last": 4}, {"last": V + 1}, {"time_step": 0.0}], ids=str
)
def test_kernels_without_a_sample_a_time_or_vertices_are_refused(manifold, wrong):
    with pytest.raises(ValueError, match=r"sample|time|vertices"):
        made(f"{manifold}.smooth")(**CALLS[f"{manifold}.smooth"] | wrong)


def test_sizes_whose_product_is_no_size_are_refused():
    with pytest.raises(ValueError, match="too large"):
        core.build_atlas(**CALLS["build_atlas"] | {"margin": 1 << 40})
    with pytest.raises(ValueError, match="too large"):
        core.halo_repeats(**CALLS["halo_repeats"] | {"rows": (1 << 63) + 5, "columns": 2})


@pytest.mark.parametrize("call", CALLS)
def test_wrong_arguments_are_refused(call):
    for argument, value in CALLS[call].items():
        for name, wrong in spoiled(value):
            if f"{call}.{argument}" in FREE.get(name, "").split():
                continue
            try:
                made(call)(**CALLS[call] | {argument: wrong})
            except (ValueError, TypeError, IndexError):
                continue
            pytest.fail(f"{argument} is taken: {name}")
