"""What parameters are judged on: samples with known noise, and the flow on them, step by step."""

from __future__ import annotations

import dataclasses
import tempfile
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import texture_files
from scene import ROOT

from beltrami_cli.flow.beltrami_flow import smooth_in_place
from beltrami_cli.flow.corrections.clipping import clipped_on, mark_clipped, restore_clipped_in_place
from beltrami_cli.flow.decoding import plan_on_canvas
from beltrami_cli.flow.estimation import estimate_on_canvas, estimate_on_mesh
from beltrami_cli.flow.manifolds.grid_manifold import ColouredCanvas, GridManifold, cut_blocks, grid_manifold
from beltrami_cli.flow.manifolds.manifold import Step
from beltrami_cli.flow.manifolds.mesh_manifold import ColouredMesh, mesh_manifold
from beltrami_cli.flow.manifolds.trials import choose_blocks
from beltrami_cli.flow.parameters import TUNABLE, KernelParameters
from beltrami_cli.flow.plan import choose_parameters
from beltrami_cli.formats.image import read_image
from beltrami_cli.formats.registry import open_document
from beltrami_cli.surface.atlas import HALO, build_atlas, owned_of
from beltrami_cli.surface.grouping import sample_vertices

MARGIN = 6  # cells: half the window, and the reach of the regularised metric
REACH = 5


def with_noise(clean, sigma, seed=11):
    """Return 8-bit colours in [0, 1] with noise; rows are samples."""
    noisy = clean + sigma * np.random.default_rng(seed).standard_normal(clean.shape)
    return (np.rint(np.clip(noisy, 0, 1) * 255) / 255).astype(np.float32)


def psnr(colours, clean):
    """Return the peak signal-to-noise ratio in dB; the peak is 1."""
    return float(-10 * np.log10(np.mean((np.asarray(colours, np.float64) - clean) ** 2)))


@dataclass(frozen=True)
class Texels:
    """Covered texels of a model, or of blocks of it: atlas, and colours (T, 3) without noise."""

    name: str
    atlas: object
    clean: np.ndarray
    starts = (1.4, 8.0)
    steps = (2.4, 4.0, 8.0)

    def plan(self, noisy, parameters):
        return plan_on_canvas(canvas_of(self.atlas, noisy, parameters))

    def noisy(self, sigma):
        """Return colours with noise."""
        return with_noise(self.clean, sigma)


@dataclass
class Vertices:
    """Coloured vertices, with the noise the same where they coincide."""

    name: str
    painted: object
    starts = (1.0, 2.4)
    steps = (1.2, 2.4, 4.0)

    @cached_property
    def clean(self):
        """The colours without noise, one row a place."""
        return self.painted.colours[self._first]

    @cached_property
    def _place(self):
        return np.unique(np.round(self.painted.positions, 9), axis=0, return_index=True, return_inverse=True)

    @property
    def _first(self):
        return self._place[1]

    def noisy(self, sigma):
        """Return colours with noise, one row a place."""
        return with_noise(self.clean, sigma)

    def plan(self, noisy, parameters):
        colours = noisy[self._place[2].ravel()]
        sampling = sample_vertices(self.painted)
        surface = sampling.surface(self.painted, np.ascontiguousarray(colours[sampling.first_vertex]))
        self.rows = sampling.sample_of[self._first]
        mesh = ColouredMesh.of(surface, parameters)
        return choose_parameters(mesh_manifold(mesh, estimate_on_mesh(mesh)), parameters)


def textures(scenes, most):
    """Yield the texels of textured scenes; of a larger one blocks with about `most` of them."""
    for scene in scenes:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "clean.glb"
            texture_files.write_glb(
                path, scene, [np.rint(image * 255).astype(np.uint8) for image in scene.clean]
            )
            surface = open_document(str(path)).textured("baseColor")
            pixels = [read_image(texture.data, texture.name).pixels[..., :3] for texture in surface.textures]
        atlas = build_atlas(surface, [(image.shape[1], image.shape[0]) for image in pixels], MARGIN, 2)
        # 8-bit files, so that what is known to be true can be stored.
        clean = np.concatenate([image.reshape(-1, 3) for image in pixels])[atlas.owned_texels] / 255.0
        if len(atlas.owned_texels) > most:
            atlas, clean = blocks_of(atlas, clean, most)
        yield Texels(scene.name, atlas, clean)


def canvas_of(atlas, colours, parameters):
    """Return the canvas of an atlas with colours of its owned cells, shape (T, N)."""
    return ColouredCanvas(
        atlas=atlas,
        parameters=parameters,
        channels=colours.shape[1],
        colours_of=colours.__getitem__,
    )


def blocks_of(atlas, clean, most):
    """Return blocks of an atlas that end at their borders, and the colours of their owned cells."""
    cells, core = choose_blocks(atlas, most, REACH)
    canvas = canvas_of(atlas, clean.astype(np.float32), KernelParameters(beta=0.0))
    whole = grid_manifold(canvas, estimate_on_canvas(canvas))
    part = cut_blocks(whole, cells, core, REACH).geometry.atlas
    kind = part.kind.copy()
    kept = np.zeros(kind.size, bool)
    kept[part.halo_cells] = True
    flat = kind.reshape(-1)
    flat[(flat == HALO) & ~kept] = 0
    row = np.searchsorted(atlas.owned_cells, cells.reshape(-1)[part.owned_cells])
    return dataclasses.replace(
        part, kind=kind, owned=owned_of(kind), owned_texels=atlas.owned_texels[row]
    ), clean[row]


def vertices():
    """Yield the samples with vertex colours."""
    for path in sorted((ROOT / "sample_data").glob("*-clean.ply")):
        document = open_document(str(path))
        if document.has_vertex_colours() and not document.slots():
            yield Vertices(path.name, document.painted())


class Steps:
    """The flow on a scene, step by step, judged by the truth after each."""

    def __init__(self, scene, noisy):
        # With these the flow makes all that its iterations need; beta and the rest are given step by step.
        manifold = scene.plan(noisy, KernelParameters(iterations=1, beta=1.0, metric_steps=1)).manifold
        self.scene, self.on_grid = scene, isinstance(manifold, GridManifold)
        if self.on_grid:
            manifold = dataclasses.replace(manifold, is_in_one_block=True)
        self.manifold = manifold
        self.clipped = clipped_on(manifold)
        marks = [] if self.clipped is None else [mark_clipped(manifold, self.clipped)]
        self.start = [manifold.colours, *marks]

    def step(self, state, beta, t, *, regularised):
        """Return the state after an iteration."""
        metric = self.manifold.measure(state[0], Step(beta, t, regularised))
        return self.manifold.average(state, metric).stacks

    def score(self, state):
        """Return the PSNR of a state, after averages of clipped noise were restored."""
        manifold = dataclasses.replace(self.manifold, colours=state[0].copy())
        if self.clipped is not None:
            restore_clipped_in_place(manifold, self.clipped, manifold.colours, state[1])
        values = manifold.new_colours().table()
        return psnr(values if self.on_grid else values[self.scene.rows], self.scene.clean)


def chosen(scene, noisy, **others):
    """Return the PSNR with parameters chosen from the data, and the plan."""
    plan = scene.plan(noisy, KernelParameters(free=TUNABLE, **others))
    colours = smooth_in_place(plan).manifold.new_colours().table()
    if not isinstance(plan.manifold, GridManifold):
        colours = colours[scene.rows]
    return psnr(colours, scene.clean), plan


__all__ = ["Steps", "Texels", "Vertices", "chosen", "psnr", "textures", "vertices"]
