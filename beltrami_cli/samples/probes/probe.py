"""Kernels on samples of one kind: how it is found, named and drawn; and those on vertices."""

from __future__ import annotations

import dataclasses
import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Int32s, Int64s
from beltrami_cli.errors import UsageError
from beltrami_cli.flow.beltrami_flow import BeltramiFlow
from beltrami_cli.flow.embedding import from_space
from beltrami_cli.flow.mesh_manifold import MeshManifold
from beltrami_cli.flow.parameters import Space
from beltrami_cli.flow.records import SampledKernel
from beltrami_cli.surface.grouping import VertexSampling
from beltrami_cli.surface.records import PaintedVertices

_PIXEL = "px"
_COLOURS = ("red", "green", "blue", "grey")


@dataclass(frozen=True)
class Location:
    """A vertex, a position, a texel or a pixel of a file; methods raise UsageError if the file has none such."""

    text: str  # as it was written
    texture: str  # glob for the name of the texture that it is in; empty: the only one
    numbers: tuple[float, ...]  # index of a vertex; texture coordinates, or column and row; position
    in_pixels: bool  # whether two numbers were marked as pixels

    def vertex_among(self, positions: Float64s, name: str) -> int:
        """Return the vertex with the index, or nearest to the position."""
        if len(self.numbers) == 3:
            squared = np.square(positions - np.array(self.numbers)).sum(axis=1)
            return int(np.where(np.isfinite(squared), squared, np.inf).argmin())
        if len(self.numbers) != 1 or self.in_pixels or self.texture:
            raise UsageError(
                f"--at {self.text} is in an image, but vertex colours of {name} are smoothed; give the index of a "
                "vertex or a position X,Y,Z"
            )
        index = _whole(self.numbers[0], self.text)
        if not 0 <= index < len(positions):
            cause = f"--at {self.text} is no vertex; {name} has the vertices 0 to {len(positions) - 1}"
            raise UsageError(cause)
        return index

    def pixel_of(self, width: int, height: int, name: str) -> tuple[int, int]:
        """Return column and row of a pixel of an image."""
        if len(self.numbers) != 2 or self.texture:
            raise UsageError(f"--at {self.text} names no pixel of {name}; give its column and row as X,Y")
        return self._inside(width, height, name)

    def texel_of(self, width: int, height: int, name: str, *, v_down: bool) -> tuple[int, int]:
        """Return column and row of a texel; v counts from the upper side of the image (glTF) or the lower."""
        if len(self.numbers) != 2:
            raise UsageError(
                f"--at {self.text} names no texel, but the texture {name} is smoothed; give texture coordinates U,V, a "
                "texel as in 300px,200px, or --on vertices"
            )
        if self.in_pixels:
            return self._inside(width, height, name)
        u, v = self.numbers
        if not (0 <= u <= 1 and 0 <= v <= 1):
            raise UsageError(
                f"--at {self.text} lies outside the texture {name}: coordinates go from 0 to 1; texels are written as "
                "in 300px,200px"
            )
        down = v if v_down else 1 - v
        return min(int(u * width), width - 1), min(int(down * height), height - 1)

    def _inside(self, width: int, height: int, name: str) -> tuple[int, int]:
        column, row = (_whole(number, self.text) for number in self.numbers)
        if not (0 <= column < width and 0 <= row < height):
            raise UsageError(
                f"--at {self.text} lies outside {name}, which has the columns 0 to {width - 1} and the rows 0 to "
                f"{height - 1}"
            )
        return column, row


def read_location(text: str) -> Location:
    """Read ``INDEX``, ``X,Y,Z``, ``X,Y``, ``U,V`` or ``Xpx,Ypx``, with ``GLOB:`` before it to choose a texture."""
    texture, _, rest = text.rpartition(":")
    parts = [part.strip() for part in rest.split(",")]
    in_pixels = [part.endswith(_PIXEL) for part in parts]
    try:
        numbers = tuple(float(part.removesuffix(_PIXEL)) for part in parts)
    except ValueError:
        numbers = ()
    fits = len(numbers) in (1, 2, 3) and all(map(math.isfinite, numbers))
    if not fits or (any(in_pixels) and in_pixels != [True, True]):
        raise UsageError(
            f"--at {text} is no place; give the index of a vertex, X,Y,Z, texture coordinates U,V, or a pixel X,Y"
        )
    return Location(text, texture, numbers, all(in_pixels))


def _whole(number: float, text: str) -> int:
    if number != int(number):
        raise UsageError(f"--at {text} must be of whole numbers here, counted from 0")
    return int(number)


@dataclass(frozen=True)
class MeshView:
    """The part of a mesh, of V vertices, that a kernel is shown on."""

    positions: Float64s
    faces: Int32s
    shades: Float32s  # (V, 3): the painting, as display values in [0, 1]
    distances: Float32s  # NaN where the kernel holds nothing
    weights: Float32s  # 0 there


@dataclass(frozen=True)
class WindowView:
    """The part of a canvas, of H x W cells, that a kernel is shown on."""

    shades: Float32s  # (H, W, 3): the painting, as display values in [0, 1]
    filled: Bools  # cells that hold a colour
    distances: Float32s  # NaN where the kernel holds nothing
    weights: Float32s  # 0 there
    source: tuple[int, int]  # row and column of the kernel's own cell


@dataclass(frozen=True)
class WorkingColours:
    """What the columns of colours in the working space mean."""

    channels: tuple[str, ...]
    space: Space

    @property
    def names(self) -> tuple[str, ...]:
        return ("L", "a", "b", *self.channels[3:]) if self.space == "oklab" else self.channels

    def shades(self, colours: Float32s) -> Float32s:
        """Return colours, shape (S, N), as display values of red, green and blue in [0, 1]; other data are grey."""
        coloured = [i for i, channel in enumerate(self.channels) if channel in _COLOURS]
        if coloured:
            shades = from_space(colours[:, coloured], "srgb", self.space)
        else:  # data alone, whose numbers may have any range
            low, high = colours[:, 0].min(), colours[:, 0].max()
            shades = (colours[:, :1] - low) / max(high - low, np.float32(1e-30))
        if shades.shape[1] != 3:
            shades = np.repeat(shades.mean(axis=1, keepdims=True), 3, axis=1)
        return np.clip(shades, 0, 1)


@dataclass
class Probe(ABC):
    """Samples of one kind, and what a kernel on them needs to be found, named and drawn."""

    flow: BeltramiFlow[Any]
    colours: WorkingColours
    unit = ""  # of length, where the parameters do not say it

    @abstractmethod
    def find(self, location: Location) -> tuple[int, dict[str, object]]:
        """Return the sample that the user means, as the flow numbers it, and what it is; UsageError if none."""

    def facts(self, kernel: SampledKernel) -> dict[str, object]:
        """Return what else is known of a kernel on samples of this kind."""
        del kernel
        return {}

    @abstractmethod
    def columns(self, samples: Int64s) -> dict[str, Array]:
        """Return what the samples of a kernel are, by the names of columns."""

    @abstractmethod
    def view(self, kernel: SampledKernel) -> MeshView | WindowView:
        """Cut out what lies around a kernel."""


@dataclass
class VertexProbe(Probe):
    """Painted vertices; `whole`: the whole mesh is shown, not only twice as far around as the kernel reaches."""

    flow: BeltramiFlow[MeshManifold]
    painted: PaintedVertices
    sampling: VertexSampling
    name: str
    whole: bool

    def find(self, location: Location) -> tuple[int, dict[str, object]]:
        vertex = location.vertex_among(self.painted.positions, self.name)
        facts = {"at": f"vertex {vertex}", "position": self.painted.positions[vertex].tolist()}
        return int(self.sampling.sample_of[vertex]), facts

    def facts(self, kernel: SampledKernel) -> dict[str, object]:
        return {"cut_short": len(kernel.samples) == self.flow.parameters.max_samples}

    def columns(self, samples: Int64s) -> dict[str, Array]:
        vertices = self.sampling.first_vertex[samples]
        return {"vertex": vertices, **dict(zip("xyz", self.painted.positions[vertices].T, strict=True))}

    def view(self, kernel: SampledKernel) -> MeshView:
        shades = self.colours.shades(self.flow.values())
        distances = np.full(len(shades), np.nan, np.float32)
        weights = np.zeros(len(shades), np.float32)
        distances[kernel.samples], weights[kernel.samples] = kernel.distances, kernel.weights
        painted, sampling = self.painted, self.sampling
        of = sampling.sample_of
        view = MeshView(painted.positions, painted.faces, shades[of], distances[of], weights[of])
        if self.whole:
            return view
        places = sampling.place_of[of]
        near = np.zeros(sampling.places, bool)
        near[sampling.place_of[kernel.samples[0]]] = True
        held = np.zeros(sampling.places, bool)
        held[sampling.place_of[kernel.samples]] = True
        return _cut(view, _surroundings(places[painted.faces], near, held)[places])


def _surroundings(faces: Int32s, near: Bools, held: Bools) -> Bools:
    """Spread over triangles until all that is held is near, and as often again."""
    steps = 0
    while not near[held].all():
        near, before = _spread(faces, near), near
        steps += 1
        if (near == before).all():  # the rest is reached over edges that are in no triangle
            near = near | held
    for _ in range(steps + 2):
        near = _spread(faces, near)
    return near


def _spread(faces: Int32s, near: Bools) -> Bools:
    wider = near.copy()
    wider[faces[near[faces].any(axis=1)]] = True
    return wider


def _cut(view: MeshView, kept: Bools) -> MeshView:
    number = np.cumsum(kept, dtype=np.int32) - 1
    faces = number[view.faces[kept[view.faces].all(axis=1)]]
    fields = [field.name for field in dataclasses.fields(view) if field.name != "faces"]
    return MeshView(faces=faces, **{name: getattr(view, name)[kept] for name in fields})
