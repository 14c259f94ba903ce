"""The records that formats, samples and flow hand to each other: painted vertices, textured surfaces, whole meshes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


Encoding = Literal["srgb", "linear"]


@dataclass(frozen=True)
class PaintedVertices:
    """Vertex colours and the surface that they are painted on.

    Rows are the colour entries of the document in file order, so that new colours can be handed back
    row by row. Vertices that the format splits are still split here.

    Attributes
    ----------
    positions : ndarray of float64, shape (V, 3)
        Finite positions in one common space (glTF: world space), in the file's own unit of length.
    faces : ndarray of int32, shape (F, 3)
        Triangles as indices of rows, each in [0, V). Quads and n-gons are cut, strips and fans unrolled.
    colours : ndarray of float32, shape (V, C)
        Colour channels without alpha; full scale is 1 whatever the stored type is. Float colours may
        leave [0, 1]; all are finite.
    channels : tuple of str
        C lower-case names, usually ("red", "green", "blue").
    encoding : {"srgb", "linear"}
        What the stored numbers mean: display values, or linear light.
    stored : str
        Type in the file as a NumPy name ("uint8", "uint16", "float32", ...), or "text".
    space_of : ndarray of int32, shape (V,), or None
        Vertices are compared for coincidence only where this agrees (glTF meshes outside any scene have
        no common place). None: one space.
    """

    positions: NDArray[np.float64]
    faces: NDArray[np.int32]
    colours: NDArray[np.float32]
    channels: tuple[str, ...]
    encoding: Encoding
    stored: str
    space_of: NDArray[np.int32] | None = None


@dataclass(frozen=True)
class MovedVertices:
    """New places of painted vertices.

    Attributes
    ----------
    positions : ndarray of float64, shape (V, 3)
        Rows and space as in `PaintedVertices`.
    normals : ndarray of float32, shape (V, 3), or None
        New unit normals, for a document that has one for each vertex; NaN where the old one stays. None: all stay.
    """

    positions: NDArray[np.float64]
    normals: NDArray[np.float32] | None = None


@dataclass(frozen=True)
class MeshContents:
    """A whole coloured mesh, as far as it can be written in another format.

    Attributes
    ----------
    positions : ndarray of float64, shape (V, 3)
        Vertex positions.
    corners : ndarray of int32, shape (K,)
        The corners of all polygons one after the other, as vertex indices in [0, V).
    offsets : ndarray of int64, shape (P + 1,)
        Polygon p has the corners ``corners[offsets[p]:offsets[p + 1]]``.
    colours : ndarray of float32, shape (V, C)
        Colour channels, full scale 1; C is 1 or 3.
    encoding : {"srgb", "linear"}
        What the numbers in `colours` mean.
    stored : str
        Type of the colours in the source, as in `PaintedVertices`.
    alpha : ndarray of float32, shape (V,), or None
        Opacity in [0, 1].
    normals : ndarray of float32, shape (V, 3), or None
        Vertex normals, where the source has them per vertex.
    left_out : tuple of str
        What the source holds and this record does not ("materials", "animations", ...), for the message
        that tells the user what the conversion drops.
    """

    positions: NDArray[np.float64]
    corners: NDArray[np.int32]
    offsets: NDArray[np.int64]
    colours: NDArray[np.float32]
    encoding: Encoding
    stored: str
    alpha: NDArray[np.float32] | None = None
    normals: NDArray[np.float32] | None = None
    left_out: tuple[str, ...] = ()


Wrap = Literal["repeat", "mirror", "clamp"]
Slot = Literal["baseColor", "emissive", "normal", "occlusion", "metallicRoughness"]


@dataclass(frozen=True)
class Texture:
    """An image file that is painted on a surface.

    Attributes
    ----------
    key : str
        What the document knows it by; new images are handed back under it.
    name : str
        For messages and globs: the file's name, or the image's name in a container.
    data : bytes
        The image file as it is stored (PNG, JPEG, ...).
    materials : tuple of str
        Names of the materials that use it.
    wrap : tuple of two of {"repeat", "mirror", "clamp"}
        What lies beyond 0 and 1, along u and along v.
    alpha_hides : bool
        Whether texels of opacity 0 cannot be seen; in opaque materials of glTF alpha means nothing.
    """

    key: str
    name: str
    data: bytes
    materials: tuple[str, ...] = ()
    wrap: tuple[Wrap, Wrap] = ("repeat", "repeat")
    alpha_hides: bool = True


@dataclass(frozen=True)
class TexturedSurface:
    """Triangles with texture coordinates, for one slot of the materials.

    Attributes
    ----------
    positions : ndarray of float64, shape (V, 3)
        Finite positions in one common space, in the file's own unit. Vertices that a format splits are still split.
    faces : ndarray of int32, shape (F, 3)
        Triangles as rows of `positions`; all triangles of the model, textured or not.
    uv : ndarray of float64, shape (F, 3, 2)
        Texture coordinates of each corner, with texture transforms applied: u to the right, v DOWN, (0, 0) the
        upper left corner of the image and (1, 1) its lower right corner, whatever the format's own convention. They
        may leave [0, 1]. Without meaning where `texture_of` is -1.
    texture_of : ndarray of int32, shape (F,)
        Index into `textures`, or -1 where the triangle has none.
    textures : tuple of Texture
        Each image once.
    space_of : ndarray of int32, shape (V,), or None
        As in `PaintedVertices`.
    """

    positions: NDArray[np.float64]
    faces: NDArray[np.int32]
    uv: NDArray[np.float64]
    texture_of: NDArray[np.int32]
    textures: tuple[Texture, ...]
    space_of: NDArray[np.int32] | None = None


@dataclass(frozen=True)
class ImageFile:
    """An encoded image.

    Attributes
    ----------
    data : bytes
        The file's content.
    suffix : str
        Its usual extension, lower case, with the dot: ".png", ".jpg", ".webp", ".exr", ...
    """

    data: bytes
    suffix: str


@dataclass(frozen=True)
class TexturedMesh:
    """A mesh with one texture.

    Attributes
    ----------
    positions : ndarray of float64, shape (V, 3)
        Vertex positions.
    faces : ndarray of int32, shape (F, 3)
        Triangles, at least one.
    uv : ndarray of float64, shape (F, 3, 2)
        Texture coordinates of every corner in [0, 1]: u to the right, v down, as in `TexturedSurface`.
    image : ImageFile
        The texture.
    transparent : bool
        Whether its alpha is to be seen.
    """

    positions: NDArray[np.float64]
    faces: NDArray[np.int32]
    uv: NDArray[np.float64]
    image: ImageFile
    transparent: bool = False


@dataclass(frozen=True)
class SampledSurface:
    """Samples of an image painted on a triangulated surface.

    Attributes
    ----------
    positions : ndarray of float64, shape (S, M)
        Positions, finite.
    faces : ndarray of int32, shape (F, 3)
        Triangles of the surface in space.
    walls : ndarray of int32, shape (W, 3)
        Triangles that stand upright on hard colour edges: they have no area in space, and join the samples
        on both sides through the colour jump.
    colours : ndarray of float32, shape (S, N)
        Colours in the working space, finite.
    """

    positions: NDArray[np.float64]
    faces: NDArray[np.int32]
    walls: NDArray[np.int32]
    colours: NDArray[np.float32]

    @property
    def all_faces(self) -> NDArray[np.int32]:
        """Triangles of the surface and of its walls, shape (F + W, 3)."""
        return np.concatenate([self.faces, self.walls]) if len(self.walls) else self.faces
