"""The records that formats hand to the pipeline: painted vertices, and a whole mesh for conversion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    import numpy as np
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
