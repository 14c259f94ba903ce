"""The records that formats, layers and flow hand to each other: coloured vertices, textures, whole meshes, samples.

And what every surface must fulfil before anything is computed on it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Int32s, Int64s
from beltrami_cli.errors import InputError

Encoding = Literal["srgb", "linear"]


@dataclass(frozen=True)
class ColouredVertices:
    """Vertex colours and the surface that they are on."""

    # Rows are the colour entries of the document in file order, so that new colours can be handed back row
    # by row. Vertices that the format splits are still split here.

    # Shape (V, 3): finite positions in one common space (glTF: world space), in the file's own unit of length.
    positions: Float64s
    # Shape (F, 3): triangles as indices of rows, each in [0, V). Quads and n-gons are cut, strips and fans unrolled.
    faces: Int32s
    # Shape (V, C): colour channels without alpha; full scale is 1 whatever the stored type is. Float
    # colours may leave [0, 1]; all are finite.
    colours: Float32s
    channels: tuple[str, ...]  # C lower-case names, usually ("red", "green", "blue")
    encoding: Encoding  # what the stored numbers mean: display values, or linear light
    stored: str  # type in the file as a NumPy name ("uint8", "uint16", "float32", ...), or "text"
    # Shape (V,): vertices are compared for coincidence only where this agrees (glTF meshes outside any
    # scene have no common place). None: one space.
    space_of: Int32s | None = None
    # The number in the file that is taken for full scale; None: as its type says.
    assumed_scale: float | None = None

    @property
    def full_scale(self) -> float:
        """The number in the file that is 1 here."""
        if self.assumed_scale is not None:
            return self.assumed_scale
        is_integer = self.stored.startswith(("uint", "int"))
        return float(np.iinfo(self.stored).max) if is_integer else 1.0


@dataclass(frozen=True)
class MovedVertices:
    """New places of coloured vertices."""

    positions: Float64s  # (V, 3): rows and space as in `ColouredVertices`
    # Shape (V, 3): new unit normals, for a document that has one for each vertex; NaN where the old one
    # stays. None: all stay.
    normals: Float32s | None = None


@dataclass(frozen=True)
class Frame:
    """How positions are meant; most formats do not say, and glTF has only the default."""

    up: str = "Y"  # or "Z"
    unit: float = 1.0  # metres


Wrap = Literal["repeat", "mirror", "clamp"]
Slot = Literal["baseColor", "emissive", "normal", "occlusion", "metallicRoughness"]


@dataclass(frozen=True)
class Texture:
    """An image file that is shown on a surface."""

    key: str  # what the document knows it by; new images are handed back under it
    name: str  # for messages and globs: the file's name, or the image's name in a container
    # The image file as it is stored (PNG, JPEG, ...), or what reads it: tiles may be more than fit into memory.
    content: bytes | Callable[[], bytes]
    materials: tuple[str, ...] = ()  # names of the materials that use it
    wrap: tuple[Wrap, Wrap] = ("repeat", "repeat")  # what lies beyond 0 and 1, along u and along v
    # Whether texels of opacity 0 cannot be seen; in opaque materials of glTF alpha means nothing.
    alpha_hides: bool = True
    model: str = ""  # the file that shows it, for errors

    @property
    def data(self) -> bytes:
        """The image file as it is stored."""
        return self.content if isinstance(self.content, bytes) else self.content()


@dataclass(frozen=True)
class TexturedSurface:
    """Triangles with texture coordinates, for one slot of the materials."""

    # Shape (V, 3): finite positions in one common space, in the file's own unit. Vertices that a format
    # splits are still split.
    positions: Float64s
    faces: Int32s  # (F, 3): triangles as rows of `positions`; all triangles of the model, textured or not
    # Shape (F, 3, 2): texture coordinates of each corner, with texture transforms applied: u to the right,
    # v DOWN, (0, 0) the upper left corner of the image and (1, 1) its lower right corner, whatever the
    # format's own convention. They may leave [0, 1]. Without meaning where `texture_of` is -1.
    uv: Float64s
    texture_of: Int32s  # (F,): index into `textures`, or -1 where the triangle has none
    textures: tuple[Texture, ...]  # each image once
    space_of: Int32s | None = None  # (V,): as in `ColouredVertices`


@dataclass(frozen=True)
class ImageFile:
    """An encoded image."""

    # A view is of a file, where large arrays are kept in files.
    content: bytes | memoryview = field(hash=False)
    suffix: str  # its usual extension, lower case, with the dot: ".png", ".jpg", ".webp", ".exr",
    notices: tuple[str, ...] = ()  # for the user, one sentence each: what did not stay as it was
    is_chosen: bool = False  # its type was asked for, so that no image of another type is kept with it

    @property
    def data(self) -> bytes:
        """The encoded image in memory."""
        return bytes(self.content)


@dataclass(frozen=True)
class PlannedImage(ImageFile):
    """An image that is not made yet, to name its file; it may come out otherwise in each slot."""

    content: bytes = field(default=b"", init=False, hash=False)
    slot: Slot = "baseColor"


AlphaMode = Literal["opaque", "mask", "blend"]


@dataclass(frozen=True)
class MeshImage:
    """An image of a mesh with textures."""

    file: ImageFile
    name: str = ""  # of the file in the source; empty: named after the model
    key: str = ""  # as in `Texture`
    tiles: tuple[tuple[tuple[int, int], MeshImage], ...] = ()  # if it stands for a set of tiles, their images


@dataclass(frozen=True)
class MaterialMap:
    """The image that a material has in a slot."""

    image: MeshImage
    wrap: tuple[Wrap, Wrap] = ("repeat", "repeat")


@dataclass(frozen=True)
class Material:
    """How triangles look; colours are display values, by which the maps are multiplied."""

    name: str = ""  # empty: the writer names it
    maps: Mapping[Slot, MaterialMap] = field(default_factory=dict)
    colour: tuple[float, ...] = (1.0, 1.0, 1.0)
    emission: tuple[float, ...] = (0.0, 0.0, 0.0)
    opacity: float = 1.0  # of opaque ones 1
    metalness: float = 0.0
    roughness: float = 1.0
    alpha: AlphaMode = "opaque"  # whether opacity, and that of the base colour map, is to be seen
    cutoff: float = 0.5  # of "mask": places that are less opaque are not seen


@dataclass(frozen=True)
class MeshContents:
    """A whole mesh or cloud of points, as far as it can be written in another format."""

    positions: Float64s  # (V, 3): vertex positions
    corners: Int32s  # (K,): the corners of all polygons one after the other, as vertex indices in [0, V)
    offsets: Int64s  # (P + 1,): polygon p has the corners ``corners[offsets[p]:offsets[p + 1]]``
    colours: Float32s  # (V, C): colour channels, full scale 1; C is 1 or 3, or 0 without colours
    encoding: Encoding = "srgb"  # what the numbers in `colours` mean
    stored: str = "float32"  # type of the colours in the source, as in `ColouredVertices`
    alpha: Float32s | None = None  # (V,): opacity in [0, 1]
    normals: Float32s | None = None  # (V, 3): vertex normals, where the source has them per vertex
    # What the source holds and this record does not ("materials", "animations", ...), for the
    # notice of what the conversion drops.
    left_out: tuple[str, ...] = ()
    frame: Frame = Frame()
    # Of a mesh with textures, shape (K, 2): texture coordinates of every corner: u to the right, v down, as in
    # `TexturedSurface`. NaN where a polygon has none.
    uv: Float64s | None = None
    materials: tuple[Material, ...] = ()
    material_of: Int32s | None = None  # (P,): index into `materials`; None: all have the first
    groups: tuple[str, ...] = ("",)  # names of the objects that it consists of; empty: the model's name
    group_of: Int32s | None = None  # (P,): index into `groups`; None: all are in the first
    corner_normals: Float32s | None = None  # (K, 3): of every corner, in place of `normals`; NaN: none
    source: str = ""  # stem of the file that it comes from; in names that of the output stands in its place

    @property
    def sizes(self) -> Int64s:
        """How many corners each polygon has, shape (P,)."""
        return np.diff(self.offsets)

    @property
    def material_numbers(self) -> Int32s:
        """Index into `materials` of every polygon, shape (P,)."""
        return np.zeros(len(self.sizes), np.int32) if self.material_of is None else self.material_of

    @property
    def group_numbers(self) -> Int32s:
        """Index into `groups` of every polygon, shape (P,)."""
        return np.zeros(len(self.sizes), np.int32) if self.group_of is None else self.group_of

    @property
    def images(self) -> tuple[MeshImage, ...]:
        """The images that its materials show, each once."""
        return tuple(dict.fromkeys(shown.image for each in self.materials for shown in each.maps.values()))

    def polygons(self, chosen: Int64s) -> MeshContents:
        """Return some of the polygons, with all vertices."""
        sizes = self.sizes[chosen]
        offsets = np.concatenate([[0], np.cumsum(sizes)])
        kept = np.repeat(self.offsets[:-1][chosen] - offsets[:-1], sizes) + np.arange(offsets[-1])
        of_corners = ("corners", "uv", "corner_normals")
        rows = dict.fromkeys(of_corners, kept) | {"material_of": chosen, "group_of": chosen}
        picked = {
            name: getattr(self, name)[row] for name, row in rows.items() if getattr(self, name) is not None
        }
        return replace(self, offsets=offsets, **picked)


@dataclass(frozen=True)
class SampledSurface:
    """Samples of an image on a triangulated surface."""

    positions: Float64s  # (S, M): positions, finite
    faces: Int32s  # (F, 3): triangles of the surface in space
    # Shape (W, 3): triangles that stand upright on hard colour edges: they have no area in space, and join
    # the samples on both sides through the colour jump.
    bridges: Int32s
    colours: Float32s  # (S, N): colours in the working space, finite

    @property
    def all_faces(self) -> Int32s:
        """Triangles of the surface and of its bridges, shape (F + W, 3)."""
        return np.concatenate([self.faces, self.bridges]) if len(self.bridges) else self.faces


# Squares of lengths are kept in single precision, which ends at 1.2e-38 and 3.4e38: lengths at 1e-19 and 2e19. Texels
# and the edges of a mesh vary, and kernels reach further; five decades of margin are enough for all of them.
_MIN_LENGTH, _MAX_LENGTH = 1e-14, 1e14
_SAMPLED_FACES = 100_000  # for a median that is off by a per cent or so


def require_finite(rows: Array, name: str, what: str, numbers: Int64s | None = None) -> None:
    """Raise InputError if a row is not finite: `what` and its number, or that of `numbers` if they are given."""
    finite = np.isfinite(rows).all(axis=1)
    if not finite.all():
        bad = int(np.argmin(finite))
        number = bad if numbers is None else numbers[bad]
        raise InputError(name, f"{what} {number} is not finite", "replace or remove it")


# Half of what single precision holds, so that the difference of any two numbers is finite in it, too.
_MAX_SINGLE = np.float64(np.finfo(np.float32).max) / 2


def fits_single(values: Array) -> Bools:
    """Whether numbers of any type are finite in single precision, in which surfaces are smoothed."""
    return np.asarray((values >= -_MAX_SINGLE) & (values <= _MAX_SINGLE))


def require_single(
    rows: Array, name: str, what: str, numbers: Int64s | None = None, *, holes: bool = False
) -> None:
    """Raise InputError as `require_finite` does, or if a number is too large for single precision.

    `holes`: rows with numbers that are not finite are allowed.
    """
    if not holes:
        require_finite(rows, name, what, numbers)
    large = np.isfinite(rows) & ~fits_single(rows)
    if large.any():
        bad = int(np.argmax(large.any(axis=1)))
        number, value = bad if numbers is None else numbers[bad], rows[bad][large[bad]][0]
        cause = f"{what} {number} is {value:.3g}, which is too large for single precision"
        raise InputError(name, cause, "replace it, or scale all down")


def check_scale(positions: Float64s, faces: Int32s, name: str) -> None:
    """Refuse a surface whose median edge is too small or too large to be squared in single precision, or a position."""
    typical = typical_edge(positions, faces)
    if typical == 0 or _MIN_LENGTH <= typical <= _MAX_LENGTH:
        require_single(positions, name, "the position of vertex", holes=True)
        return
    shown = f"{typical:.0e}" if np.isfinite(typical) else "more than 1e+308"
    what = "edges are" if len(faces) else "points are apart"
    kind = "small" if typical < _MIN_LENGTH else "large"
    cause = f"its {what} {shown} units, which is too {kind} to be squared in single precision"
    raise InputError(name, cause, "scale it, for example to metres")


def typical_edge(positions: Float64s, faces: Int32s) -> float:
    """Return the median of the edges that have a length, along their longest axes; 0 if none has."""
    with np.errstate(over="ignore", invalid="ignore"):
        if len(faces):
            # The longest coordinates of the edges of some, whose squares could overflow here already.
            corners = positions[faces[:: 1 + len(faces) // _SAMPLED_FACES]]
            steps = np.abs(corners - np.roll(corners, 1, axis=1)).max(axis=2)
            steps = steps[np.isfinite(corners).all(axis=(1, 2))]
        else:
            # Points count as if they were spread evenly over a surface as wide as they are.
            there = positions[np.isfinite(positions).all(axis=1)]
            steps = np.ptp(there, axis=0).max(keepdims=True) / np.sqrt(len(there)) if len(there) else there
    return upper_median(steps[steps > 0])


def upper_median(values: Float64s) -> float:
    """Return the median of numbers, or the greater of the two in the middle; 0 if there are none."""
    # numpy.median imports more of NumPy than a small mesh takes to be smoothed.
    return float(np.partition(values, len(values) // 2)[len(values) // 2]) if len(values) else 0.0
