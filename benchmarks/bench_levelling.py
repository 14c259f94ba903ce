"""Measure how well `beltrami level` removes exposures of charts: ``python benchmarks/bench_levelling.py [MODEL...]``.

Each chart gets a gain and an offset in each channel; then also clipping; then also a gain that falls off linearly over
the chart. The table has the decrease of the error in dB. A gain and an offset of the whole model are not counted as an
error; in brackets, neither are a gain and an offset of each group of charts that are joined by seams without steps,
since other charts have no common exposure. The last columns are the change of the original model, of 255, and the
processor time of the fit in seconds.
"""

import time

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from beltrami_cli.arrays import Array
from beltrami_cli.flow.manifolds.grid.canvas import on_canvas
from beltrami_cli.levelling.steps import ChartPlaces, steps_over_seams
from harness import SAMPLES, Row, arguments, show
from levelling.exposure_scene import ExposureScene, fall

NAMES = ("head-tex-clean.glb", "head-tex-noisy.glb", "torus-two-clean.gltf", "sphere-exr-clean.obj", "scan-clean.glb",
         "scan-noisy.glb")  # fmt: skip
KINDS = {"plain": {}, "clipped": {"clipped": True}, "fall-off": {"fall_off": True}}
SEEDS = 1, 2
# A seam has no step if its median difference is at most this, over at least so many samples.
MAX_STEP, MIN_SAMPLES = 6 / 255, 16


def main() -> None:
    options = arguments(__doc__, "models")
    models = options.models or [SAMPLES / name for name in NAMES]
    rows = [(path.name, *judge(ExposureScene.of(path))) for path in models]
    show(rows, options, ("model", *KINDS, "as it is", "seconds"))


def judge(scene: ExposureScene) -> Row:
    """Return the decrease of the error for each kind of exposures, the change without any, and the time."""
    groups, cells, spent = joined(scene), [], []
    for kind in KINDS.values():
        falls = []
        for seed in SEEDS:
            truth, exposed = scene.exposed(seed, **kind)
            start = time.process_time()
            after = scene.levelled(exposed)[0].clip(0, 1)
            spent.append(time.process_time() - start)
            falls.append([fall(exposed, after, truth), fall(exposed, after, truth, groups)])
        cells.append("{:.1f} ({:.1f})".format(*np.mean(falls, axis=0)))
    same, _ = scene.levelled(scene.truth)
    return *cells, 255 * float(np.abs(same - scene.truth.astype(np.float32)).mean()), max(spent)


def joined(scene: ExposureScene) -> Array:
    """Return the group of each texel; charts that are joined by seams without steps form a group."""
    atlas = scene.samples.atlas
    colours = on_canvas(atlas, scene.truth.astype(np.float32))
    steps = steps_over_seams(atlas, colours, ChartPlaces.of(atlas), np.zeros(atlas.charts, bool))
    signs = np.where(steps.ends[:, 0] < steps.ends[:, 1], 1, -1)[:, None]
    step = signs * (steps.colours[:, 1] - steps.colours[:, 0])
    pairs = []
    for seam in np.unique(steps.seams):
        rows = steps.seams == seam
        if steps.counts[rows].sum() >= MIN_SAMPLES and np.abs(np.median(step[rows], axis=0)).max() < MAX_STEP:
            pairs.append(steps.ends[rows][0])
    ends = np.array(pairs, int).reshape(-1, 2)
    graph = coo_array((np.ones(len(ends)), ends.T), shape=(atlas.charts,) * 2)
    return connected_components(graph, directed=False)[1][scene.charts]


if __name__ == "__main__":
    main()
