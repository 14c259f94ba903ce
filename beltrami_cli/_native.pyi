from collections.abc import Callable, Iterable
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

Indices = NDArray[np.int32] | NDArray[np.int64]

class AtlasArrays(TypedDict):
    kind: NDArray[np.uint8]
    squared_lengths: NDArray[np.float32]
    cut_cells: Indices
    owned_texels: Indices
    halo_cells: Indices
    halo_taps: Indices
    halo_weights: NDArray[np.float32]
    halo_seams: NDArray[np.int32]
    gutter_cells: Indices
    gutter_texels: Indices
    border_texels: Indices
    lone_texels: Indices
    chart_of: NDArray[np.int32]
    charts: int
    seams: int
    covered: int
    overlapped: int

def build_atlas(
    positions: NDArray[np.float64],
    faces: NDArray[np.int32],
    uv: NDArray[np.float64],
    texture_of: NDArray[np.int32],
    grids: NDArray[np.int32],
    margin: int,
    threads: int,
    allocate: Callable[[int], NDArray[np.uint8]],
    progress: Callable[[int], None] | None,
) -> AtlasArrays: ...
def store_colours(
    table: NDArray[np.uint8] | NDArray[np.uint16],
    pixels: Indices,
    colours: NDArray[np.float32],
    channels: NDArray[np.int32],
    threads: int,
) -> tuple[int, int, int]: ...
def interpolate(places: NDArray[np.float32], at: NDArray[np.float64], table: NDArray[np.float64]) -> None: ...
def restore_clipped(
    averages: NDArray[np.float32],
    share: NDArray[np.float32],
    clipping: tuple[float, bool, bool],
    trusted: float,
    at: NDArray[np.float64],
    alpha: NDArray[np.float64],
    gap: NDArray[np.float64],
    relative: NDArray[np.float32],
    threads: int,
) -> None: ...
def impute_clipped(
    colours: NDArray[np.float32],
    estimate: NDArray[np.float32],
    clipping: tuple[float, bool, bool],
    at: NDArray[np.float64],
    beyond: NDArray[np.float64],
    relative: NDArray[np.float32],
    threads: int,
) -> None: ...
def convolve(planes: NDArray[np.float32], taps: NDArray[np.float32], threads: int) -> NDArray[np.float32]: ...
def means_of_squares(
    kind: NDArray[np.uint8], kinds: NDArray[np.uint8], planes: NDArray[np.float32], side: int, threads: int
) -> NDArray[np.float32]: ...
def add_enlarged(
    kind: NDArray[np.uint8],
    kinds: NDArray[np.uint8],
    changes: NDArray[np.float32],
    planes: NDArray[np.float32],
    side: int,
    threads: int,
) -> None: ...
def nearest_marked(
    marked: NDArray[np.bool_], wanted: NDArray[np.bool_], reach: int, threads: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]: ...
def morton_order(positions: NDArray[np.float64]) -> NDArray[np.int32]: ...
def neighbour_means(
    values: NDArray[np.float32],
    edges: NDArray[np.int32],
    weights: NDArray[np.float32],
    totals: NDArray[np.float64],
    threads: int,
) -> NDArray[np.float32]: ...
def pilot_of_graph(
    colours: NDArray[np.float32], edges: NDArray[np.int64], variances: NDArray[np.float32]
) -> NDArray[np.float32]: ...
def pilot_of_squares(
    colours: NDArray[np.float32], filled: NDArray[np.bool_] | None, variances: NDArray[np.float32]
) -> NDArray[np.float32]: ...
def vertex_order(positions: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.int32]: ...

class _Manifold:
    def __init__(self, faces: NDArray[np.int32], vertex_count: int) -> None: ...
    def update_metric(
        self,
        positions: NDArray[np.float64],
        colours: NDArray[np.float32],
        beta: float,
        scales: NDArray[np.float32] | None,
        threads: int,
    ) -> None: ...
    def smooth(
        self,
        colours: NDArray[np.float32],
        weights: NDArray[np.float32] | None,
        time_step: float,
        radius: float,
        max_samples: int,
        threads: int,
        progress: Callable[[int], None] | None,
        first: int = 0,
        last: int | None = None,
    ) -> tuple[NDArray[np.float32], int, int]: ...
    def distances(
        self, source: int, radius: float, max_samples: int
    ) -> tuple[NDArray[np.int32], NDArray[np.float32]]: ...
    def edges(self) -> NDArray[np.int32]: ...

class TriangulatedManifold(_Manifold): ...
class SegmentManifold(_Manifold): ...

class LocalTriangulation:
    def __init__(self, positions: NDArray[np.float64]) -> None: ...
    def add_stars(
        self,
        rows: NDArray[np.int32],
        neighbours: NDArray[np.int32],
        complete: bool,
        keep_unsettled: bool,
        threads: int,
    ) -> NDArray[np.int32]: ...
    def faces(self) -> NDArray[np.int32]: ...

def local_scale(
    right: NDArray[np.float32], below: NDArray[np.float32], window_radius: int
) -> NDArray[np.float32]: ...
def halo_repeats(
    rows: int,
    columns: int,
    cells: NDArray[np.int64],
    sources: NDArray[np.int64],
    seams: NDArray[np.int32],
    reach: int,
    threads: int,
) -> NDArray[np.uint8]: ...
def smooth_grid(
    kind: NDArray[np.uint8],
    squared_lengths: Iterable[NDArray[np.float32]],
    scale: NDArray[np.float32] | None,
    repeats: NDArray[np.uint8] | None,
    metric: Iterable[NDArray[np.float32]],
    colours: Iterable[NDArray[np.float32]],
    beta: float,
    time_step: float,
    radius: float,
    window_radius: int,
    scheme: str,
    threads: int,
    progress: Callable[[int], None] | None,
) -> tuple[NDArray[np.float32], int]: ...
def grid_distances(
    kind: NDArray[np.uint8],
    squared_lengths: Iterable[NDArray[np.float32]],
    scale: NDArray[np.float32] | None,
    metric: Iterable[NDArray[np.float32]],
    beta: float,
    radius: float,
    window_radius: int,
    scheme: str,
    cell: int,
) -> NDArray[np.float32]: ...

FURTHEST_SUPPORT: int
SWEEP_TILE_ROWS: int
PATCH_REACH: int
PATCH_BLOCK_SIZE: int
PATCH_TILE_SIDE: int
PATCH_TILE_MARGIN: int

def blend_terms(
    noisy: NDArray[np.float32],
    probe: NDArray[np.float32],
    estimates: tuple[NDArray[np.float32], ...],
    noise: tuple[NDArray[np.float32], float, NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]],
    terms: NDArray[np.float32],
    threads: int,
) -> None: ...
def blend_residual(
    noisy: NDArray[np.float32],
    estimate: NDArray[np.float32],
    noise: tuple[NDArray[np.float32], float, NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]],
    residual: NDArray[np.float32],
    threads: int,
) -> None: ...
def blend_share_within(
    estimate: NDArray[np.float32],
    noise: tuple[NDArray[np.float32], float, NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]],
    share: NDArray[np.float32],
    threads: int,
) -> None: ...
def collaborate_on_grid(
    kind: NDArray[np.uint8],
    noisy: NDArray[np.float32],
    pilot: NDArray[np.float32],
    mixing: tuple[
        NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], float, float
    ],
    relative: NDArray[np.float32] | None,
    has_pilot: bool,
    estimates: NDArray[np.float32],
    threads: int,
    progress: Callable[[int], None] | None,
) -> None: ...

class SurfacePatches:
    def __init__(
        self,
        positions: NDArray[np.float64],
        edges: NDArray[np.int32],
        axes: NDArray[np.float64],
        priorities: NDArray[np.uint64],
        threads: int,
        blocks: NDArray[np.int32] | None = None,
    ) -> None: ...
    def collaborate(
        self,
        noisy: NDArray[np.float32],
        pilot: NDArray[np.float32],
        mixing: tuple[
            NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], float, float
        ],
        relative: NDArray[np.float32] | None,
        has_pilot: bool,
        estimates: NDArray[np.float32],
        weights: NDArray[np.float32],
        threads: int,
        progress: Callable[[int], None] | None,
    ) -> None: ...

def sweep_instruction_set() -> str: ...
