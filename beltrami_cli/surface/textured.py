"""The record that formats hand over for textures: triangles with texture coordinates, and the images."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

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
