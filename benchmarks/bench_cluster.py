"""Time many files, and large surfaces in chunks, on one and on two workers of a Dask cluster on this machine.

Beside the time on the clock there is the processor time of the busiest worker: what the clock would show on a machine
with nothing else to do, but for what is sent and waited for.
"""

from __future__ import annotations

import dataclasses
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from batch.dask_cluster import Cluster
from beltrami_cli.batch.cluster import OnDask, do_on_worker, portable
from beltrami_cli.batch.item import Item, Record
from beltrami_cli.batch.run import Batch, ChunkRunner, Workers
from beltrami_cli.flow.beltrami_flow import smooth_in_place
from beltrami_cli.flow.chunks import IN_ONE_PIECE, Chunking, Resources
from beltrami_cli.flow.decoding import plan_on_canvas
from beltrami_cli.flow.estimation import estimate_on_mesh
from beltrami_cli.flow.manifolds.mesh_manifold import ColouredMesh, mesh_manifold
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.flow.plan import choose_parameters
from beltrami_cli.layers.image_surface import ImageSurface, canvas_of_image
from beltrami_cli.layers.settings import SmoothSettings
from beltrami_cli.surface.records import SampledSurface
from cli.commands import SAMPLES
from oracles import surfaces

REPEATS = 2
FIXED = KernelParameters(
    iterations=5, t=2.4, beta=4.0, beta_growth=1.5, metric_steps=1, clipping="keep", patches="on", threads=1
)
FILES = 24


class Silent:
    """Watches a batch and says nothing."""

    def __getattr__(self, name):
        return lambda *_: None


def many_files(client):
    """Smooth some files, each for a second or so."""
    settings = SmoothSettings(dataclasses.replace(FIXED, iterations=60))
    with tempfile.TemporaryDirectory() as folder:
        jobs = [
            Item(str(SAMPLES / "knot-noisy.ply"), f"{folder}/{number}.ply", settings)
            for number in range(FILES)
        ]
        record = Record(f"{folder}/batch.jsonl", resume=False, overwrite=False)
        start = time.perf_counter()
        workers = Workers(OnDask(client), lambda item: (do_on_worker, item, portable(item), None), 1)
        outcomes = Batch(jobs, record, Silent()).run(1, None, workers)
        assert all(outcome.status == "done" for outcome in outcomes)
        return time.perf_counter() - start


def mesh(resources, side=700):
    """Make the flow on a mesh of half a million vertices."""
    flat, faces = surfaces.lattice(side, side)
    random = np.random.default_rng(0)
    colours = 0.5 + 20 / 255 * random.standard_normal((len(flat), 3))
    surface = SampledSurface(
        flat, faces.astype(np.int32), np.zeros((0, 3), np.int32), colours.astype(np.float32)
    )
    mesh = ColouredMesh.of(surface, FIXED, resources=resources)
    return choose_parameters(mesh_manifold(mesh, estimate_on_mesh(mesh)), FIXED)


def texture(resources, side=2048):
    """Make the flow on a picture of four million pixels."""
    random = np.random.default_rng(0)
    colours = (0.5 + 20 / 255 * random.standard_normal((side * side, 3))).astype(np.float32)
    surface = ImageSurface(valid=np.ones((side, side), bool))
    canvas = canvas_of_image(surface, lambda pixels: colours[pixels], FIXED)
    return plan_on_canvas(dataclasses.replace(canvas, resources=resources))


def in_eight_chunks(make):
    """Return what runs a flow, made before, in eight chunks, patches included."""

    def run(client):
        plan = make(Resources(Chunking(8, ChunkRunner(OnDask(client, per_worker=2)))))
        start = time.perf_counter()
        smooth_in_place(plan)
        return time.perf_counter() - start

    return run


def whole(make):
    """Time the same on one thread without a cluster: on the clock, and of the processor."""
    plan = make(IN_ONE_PIECE)
    start, used = time.perf_counter(), time.process_time()
    smooth_in_place(plan)
    return time.perf_counter() - start, time.process_time() - used


def busiest(client, case):
    """Time a case: on the clock, and the processor time of the busiest worker."""
    before = client.run(time.process_time)
    clock = case(client)
    after = client.run(time.process_time)
    return clock, max(after[worker] - before[worker] for worker in after)


def best(measure):
    """Return the least of each time over repeats."""
    return tuple(min(times) for times in zip(*(measure() for _ in range(REPEATS)), strict=True))


def main() -> None:
    """Print a table of the times."""
    cases = {
        f"{FILES} meshes of 5,000 vertices": many_files,
        "a mesh of 490,000 vertices in 8 pieces": in_eight_chunks(mesh),
        "a picture of 2048 x 2048 pixels in 8 pieces": in_eight_chunks(texture),
    }
    alone = [None, best(lambda: whole(mesh)), best(lambda: whole(texture))]
    times = {}
    for workers in (1, 2):
        with tempfile.TemporaryDirectory() as folder:
            cluster = Cluster(Path(folder))
            try:
                cluster.grow(workers)
                with cluster.client() as client:
                    for name, case in cases.items():
                        times[name, workers] = best(lambda case=case: busiest(client, case))
            finally:
                cluster.close()
    print(
        "| clock / processor | no cluster, 1 thread | 1 worker | 2 workers | ratio |\n| --- | --- | --- | --- | --- |"
    )
    for name, one in zip(cases, alone, strict=True):
        first, second = times[name, 1], times[name, 2]
        ratio = " / ".join(f"{a / b:.2f}" for a, b in zip(first, second, strict=True))
        print(f"| {name} | {shown(one)} | {shown(first)} | {shown(second)} | {ratio} |")


def shown(times):
    """Return both times in words."""
    return "" if times is None else " / ".join(f"{each:.1f} s" for each in times)


if __name__ == "__main__":
    main()
