"""Records that formats, layers and flow exchange: coloured vertices, textures, meshes, samples."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Bools, Float32s, Float64s, Indices, Int32s, Int64s
from beltrami_cli.surface.ranges import entries
from beltrami_cli.surface.slots import Slot as Slot

Encoding = Literal["srgb", "linear"]


@dataclass(frozen=True)
class ColouredVertices:
    # Rows are the colour entries of the document in file order, so that new colours can be returned row by row.
    # Vertices that the format splits are still split.

    # Shape (V, 3): finite positions in one common space (glTF: world space), in the file's unit of length.
    positions: Float64s
    # Shape (F, 3): triangles as row indices. Quads and n-gons are triangulated, strips and fans unrolled.
    faces: Int32s
    # Shape (V, C): finite colour channels without alpha, of full scale 1 for any stored type. Floats may be outside [0,
    # 1].
    colours: Float32s
    channels: tuple[str, ...]  # C lower-case names, usually ("red", "green", "blue")
    encoding: Encoding  # what the stored numbers mean: display values, or linear light
    stored: str  # type in the file as a NumPy name ("uint8", "uint16", "float32", ...), or "text"
    # Shape (V,): vertices are coincident only if they agree here (glTF meshes outside any scene share no space). None:
    # one space.
    space_of: Int32s | None = None
    # Number in the file that becomes full scale; None: given by the type.
    assumed_scale: float | None = None
    needs_triangles: bool = False  # whether vertices in no triangle have no colour
    notices: tuple[str, ...] = ()  # for the user, one sentence each: how they were read, what was skipped

    @property
    def full_scale(self) -> float:
        """The number in the file that is 1 here."""
        if self.assumed_scale is not None:
            return self.assumed_scale
        is_integer = self.stored.startswith(("uint", "int"))
        return float(np.iinfo(self.stored).max) if is_integer else 1.0

    def coloured_rows(self) -> NDArray[np.intp]:
        """Return the numbers of the vertices with a finite position and a colour."""
        valid = np.asarray(np.isfinite(self.positions).all(axis=1))
        if self.needs_triangles:
            joined = np.zeros(len(valid), bool)
            joined[self.faces] = True
            valid &= joined
        return np.flatnonzero(valid)

    def only(self, rows: Indices, faces: Int32s | None = None) -> ColouredVertices:
        """Select vertices and triangles between them, or none."""
        return replace(
            self,
            positions=self.positions[rows],
            faces=np.empty((0, 3), np.int32) if faces is None else faces,
            colours=self.colours[rows],
            space_of=None if self.space_of is None else self.space_of[rows],
        )

    def restricted_to(self, rows: Indices) -> ColouredVertices:
        """Select vertices, in ascending order, and the triangles with all corners among them."""
        if len(rows) == len(self.positions):
            return self
        number = np.full(len(self.positions), -1, np.int32)
        number[rows] = np.arange(len(rows))
        faces = number[self.faces]
        return self.only(rows, faces[(faces >= 0).all(axis=1)])


@dataclass(frozen=True)
class MovedVertices:
    positions: Float64s  # (V, 3): rows and space as in `ColouredVertices`
    # Shape (V, 3): new unit normals, for documents with one per vertex; NaN keeps the old normal. None: all are kept.
    normals: Float32s | None = None


@dataclass(frozen=True)
class Frame:
    """Orientation and unit of positions; few formats state it, and glTF only has the default."""

    up: str = "Y"  # or "Z"
    unit: float = 1.0  # metres


Wrap = Literal["repeat", "mirror", "clamp"]


@dataclass(frozen=True)
class Texture:
    key: str  # key of the image in the document, also for new images
    name: str  # for messages and globs: the file's name, or the image's name in a container
    # The stored image file (PNG, JPEG, ...), or a function that reads it, since tiles may exceed memory.
    content: bytes | Callable[[], bytes]
    materials: tuple[str, ...] = ()  # names of the materials that use it
    wrap: tuple[Wrap, Wrap] = ("repeat", "repeat")  # beyond 0 and 1, along u and along v
    # Whether texels of opacity 0 are invisible; opaque materials of glTF ignore alpha.
    alpha_hides: bool = True
    model: str = ""  # the file that shows it, for errors

    @property
    def data(self) -> bytes:
        """The stored image file."""
        return self.content if isinstance(self.content, bytes) else self.content()


@dataclass(frozen=True)
class TexturedSurface:
    """Triangles with texture coordinates, for one slot of the materials."""

    # Shape (V, 3): finite positions in one common space, in the file's unit. Vertices that a format splits are still
    # split.
    positions: Float64s
    faces: Int32s  # (F, 3): all triangles of the model, textured or not
    # Shape (F, 3, 2): texture coordinates of each corner, with texture transforms applied: u to the right, v DOWN, (0,
    # 0) the upper left corner of the image and (1, 1) its lower right corner, whatever the format's convention. They
    # may be outside [0, 1], and are undefined where `texture_of` is -1.
    uv: Float64s
    texture_of: Int32s  # (F,): index into `textures`; -1: none
    textures: tuple[Texture, ...]  # each image once
    space_of: Int32s | None = None  # (V,): as in `ColouredVertices`
    notices: tuple[str, ...] = ()  # as in `ColouredVertices`


@dataclass(frozen=True)
class ImageFile:
    # A view of a file where large arrays are in files.
    content: bytes | memoryview = field(hash=False)
    suffix: str  # usual extension in lower case: ".png", ".jpg", ".webp", ".exr"
    notices: tuple[str, ...] = ()  # for the user, one sentence each: what was not preserved
    is_chosen: bool = False  # the user chose its type: images of other types are not kept

    @property
    def data(self) -> bytes:
        """The encoded image in memory."""
        return bytes(self.content)


@dataclass(frozen=True)
class PlannedImage(ImageFile):
    """An image that is not encoded yet, to name its file; its content may differ between slots."""

    content: bytes = field(default=b"", init=False, hash=False)
    slot: Slot = "baseColor"


AlphaMode = Literal["opaque", "mask", "blend"]


@dataclass(frozen=True)
class MeshImage:
    file: ImageFile
    name: str = ""  # name of the source file; empty: named after the model
    key: str = ""  # as in `Texture`
    tiles: tuple[tuple[tuple[int, int], MeshImage], ...] = ()  # of a tile set: the images of its tiles


@dataclass(frozen=True)
class MaterialMap:
    image: MeshImage
    wrap: tuple[Wrap, Wrap] = ("repeat", "repeat")


@dataclass(frozen=True)
class Material:
    """Appearance of triangles; colours are display values, which multiply the maps."""

    name: str = ""  # empty: the writer names it
    maps: Mapping[Slot, MaterialMap] = field(default_factory=dict)
    colour: tuple[float, ...] = (1.0, 1.0, 1.0)
    emission: tuple[float, ...] = (0.0, 0.0, 0.0)
    emission_strength: float = 1.0  # at least 1, multiplies the emission in linear light
    opacity: float = 1.0  # 1 if opaque
    metalness: float = 0.0
    roughness: float = 1.0
    alpha: AlphaMode = "opaque"  # whether opacity, also that of the base colour map, is shown
    cutoff: float = 0.5  # of "mask": less opaque places are invisible


@dataclass(frozen=True)
class MeshContents:
    """A mesh or point cloud in the form in which it can be written to another format."""

    positions: Float64s  # (V, 3): vertex positions
    corners: Int32s  # (K,): corners of all polygons in sequence, as vertex indices
    offsets: Int64s  # (P + 1,): polygon p has the corners ``corners[offsets[p]:offsets[p + 1]]``
    colours: Float32s  # (V, C): colour channels, full scale 1; C is 1 or 3, or 0 without colours
    encoding: Encoding = "srgb"  # what the numbers in `colours` mean
    stored: str = "float32"  # type of the colours in the source, as in `ColouredVertices`
    alpha: Float32s | None = None  # (V,): opacity in [0, 1]
    normals: Float32s | None = None  # (V, 3): vertex normals, if in the source
    # Content of the source that this record lacks ("materials", "animations", ...), for the notice of the conversion.
    left_out: tuple[str, ...] = ()
    frame: Frame = Frame()
    # Shape (K, 2): texture coordinates of every corner, u to the right, v down, as in `TexturedSurface`; NaN: none.
    # None: the mesh has no textures.
    uv: Float64s | None = None
    materials: tuple[Material, ...] = ()
    material_of: Int32s | None = None  # (P,): index into `materials`; None: the first for all
    groups: tuple[str, ...] = ("",)  # names of its objects; empty: the model's name
    group_of: Int32s | None = None  # (P,): index into `groups`; None: the first for all
    corner_normals: Float32s | None = None  # (K, 3): corner normals, instead of `normals`; NaN: none
    source: str = ""  # stem of the source file, which that of the output replaces in names
    notices: tuple[str, ...] = ()  # as in `ColouredVertices`

    @property
    def sizes(self) -> Int64s:
        """Number of corners of each polygon, shape (P,)."""
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
        return tuple(dict.fromkeys(shown.image for each in self.materials for shown in each.maps.values()))

    def polygons(self, chosen: Int64s) -> MeshContents:
        """Select polygons, with all vertices."""
        kept, sizes = entries(self.offsets, chosen)
        offsets = np.concatenate([[0], np.cumsum(sizes)])
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
    # Shape (W, 3): upright triangles at hard colour edges. They have no area in space, and join the samples on both
    # sides across the colour jump.
    bridges: Int32s
    colours: Float32s  # (S, N): colours in the working space, finite

    @property
    def all_faces(self) -> Int32s:
        """Triangles of the surface and of its bridges, shape (F + W, 3)."""
        return np.concatenate([self.faces, self.bridges]) if len(self.bridges) else self.faces


@dataclass(frozen=True)
class Cells:
    """Pixels of images: image, row, column and chart of each, shapes (K,)."""

    sizes: Sequence[tuple[int, int]]  # rows and columns of each image
    image: Int64s
    row: Int64s
    column: Int64s
    chart: Indices
    names: Sequence[str] = ()  # of the images; empty: a single image

    def of(self, index: int) -> tuple[Bools, tuple[Int64s, Int64s]]:
        """Return a mask of the samples in an image, and their rows and columns."""
        inside = self.image == index
        return inside, (self.row[inside], self.column[inside])
