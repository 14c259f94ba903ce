"""The parts of two files at the same samples, and the differences there."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from beltrami_cli.arrays import Bools, Float32s, Float64s, Indices
from beltrami_cli.flow.parameters import Space
from beltrami_cli.jobs.compare.similarity import colour_differences, structural_similarity
from beltrami_cli.surface import large_arrays

Pair = tuple[Float32s, Float32s]  # the same samples, or means of them, in reference and test
# Samples that are worked on at a time: three channels in double precision stay in the processor's cache, and below
# 256 KB, from which on NumPy searches the call stack before each sum.
_BLOCK = 1 << 13
_OPACITY_TOLERANCE = 0.75 / 255  # below a step of 8 bits, in which opacity is stored
_SAMPLES_SHARE = 0.7  # of the time of an image: 4.6 s of 16.7 million samples, and 2.1 s of their windows


@dataclass(frozen=True, kw_only=True)
class ComparedPart:
    """A texture, an image, or the vertices of a mesh, in two files; its colours are read block by block."""

    name: str
    kind: Literal["vertices", "texture", "image"]
    index: Indices  # (S,): the compared vertices, or pixels as row * width + column
    read: Callable[[Indices], Pair]  # colours of vertices or pixels, (K, N), full scale 1
    space: Space  # of these
    weights: Float64s | None = None  # (S,): what each sample counts; None: all the same
    # (S,): within 4 texels of a seam, or at a place where the file splits vertices; None: no seams.
    near_seams: Bools | None = None
    # (K,) in both: how far colours jump where the surface goes on in another chart, mean over channels.
    jumps: tuple[Float64s, Float64s] | None = None
    size: tuple[int, int] | None = None  # rows and columns of an image or texture
    is_identical: bool = False  # the same colours in both files, so that only other parts are measured
    # (K, N): colours of texels that no face covers, but that faces look up; None: not a texture.
    around: Pair | None = None
    other_opacity: bool = False  # whether opacity differs, which is not measured

    def blocks(self) -> Iterator[tuple[slice, Float32s, Float32s]]:
        for block in large_arrays.blocks(len(self.index), _BLOCK):
            yield block, *self.read(self.index[block])

    def covered(self) -> Bools:
        """Return which pixels of an image or texture are compared, (H, W)."""
        assert self.size is not None
        covered = np.zeros(self.size, bool)
        covered.reshape(-1)[self.index] = True
        return covered

    def sample_weights(self) -> Float64s:
        return np.broadcast_to(1.0, len(self.index)) if self.weights is None else self.weights

    def seam_mask(self) -> Bools:
        return np.zeros(len(self.index), bool) if self.near_seams is None else self.near_seams

    def read_rows(self, rows: slice) -> Pair:
        """Return rows of pixels of an image or texture, (R, W, N)."""
        assert self.size is not None
        width = self.size[1]
        one, other = self.read(np.arange(rows.start * width, rows.stop * width))
        return one.reshape(-1, width, one.shape[1]), other.reshape(-1, width, other.shape[1])


def opacities_differ(one: Float32s | None, other: Float32s | None) -> bool:
    """Whether two opacities differ by more than rounding; None: all is opaque."""
    difference = np.asarray(1.0 if one is None else one) - (1.0 if other is None else other)
    return bool(np.abs(difference).max(initial=0) > _OPACITY_TOLERANCE)


@dataclass(frozen=True)
class Measured:
    """The differences of the samples of one part."""

    part: ComparedPart
    errors: Float32s  # (S,): the largest in any channel
    rms: Float32s  # (S,): root mean squares over the channels; squares could vanish in single precision
    delta_e: Float32s  # (S,): CIEDE2000 differences; NaN where the numbers are not colours
    ssim: float | None
    change: float  # mean absolute change of the channels

    def worst(self) -> dict[str, Any]:
        """Return the sample with the largest error in any channel, in JSON types; there must be one."""
        part, at = self.part, int(self.errors.argmax())
        index, delta_e = int(part.index[at]), float(self.delta_e[at])
        (reference,), (test,) = part.read(part.index[at : at + 1])
        row, column = divmod(index, part.size[1]) if part.size else (0, 0)
        return {
            "part": part.name, **({"x": column, "y": row} if part.size else {"vertex": index}),
            "error": float(self.errors[at]), "delta_e": None if math.isnan(delta_e) else delta_e,
            "reference": reference.tolist(), "test": test.tolist(),
        }  # fmt: skip


def measure(part: ComparedPart, tick: Callable[[float], None] = lambda share: None) -> Measured:
    """Go through the samples of a part, and the windows of an image; `tick` is called with the share that is done."""
    first, samples = 1.0 if part.size is None else _SAMPLES_SHARE, len(part.index)
    errors, rms, delta_e = (large_arrays.empty(samples, np.float32) for _ in range(3))
    total = 0.0
    for block, reference, test in part.blocks():
        tick(first * block.start / samples)
        changes = np.abs(test - reference)
        errors[block] = changes.max(axis=1)
        total += float(changes.mean(axis=1, dtype=np.float64).sum())
        rms[block] = np.sqrt(np.square(test.astype(np.float64) - reference).mean(axis=1))
        delta_e[block] = colour_differences(reference, test, part.space)
    similarity = None
    if part.size is not None:
        similarity = structural_similarity(
            part.read_rows, part.covered(), lambda share: tick(first + (1 - first) * share)
        )
    return Measured(part, errors, rms, delta_e, similarity, total / max(1, samples))
