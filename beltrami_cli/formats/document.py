"""What every format offers: a document that keeps its bytes and lets only its colours be replaced."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

from beltrami_cli.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from beltrami_cli.formats.anatomy import Anatomy
    from beltrami_cli.surface.painted import MeshContents, MovedVertices, PaintedVertices
    from beltrami_cli.surface.textured import ImageFile, Slot, TexturedSurface

Bytes = bytes | bytearray | memoryview
NO_IMAGES: Mapping[tuple[Slot, str], ImageFile] = {}


@dataclass(frozen=True)
class Written:
    """The files of a document with new colours, or of a mesh converted to another format.

    Attributes
    ----------
    main : sequence of bytes-like
        Pieces of the main file, to be written one after the other.
    sidecars : mapping of str to bytes-like
        Files beside it that are new or changed, by their path relative to the main file ("/" separates).
    notices : tuple of str
        What the user should be told, one sentence each: what the format cannot hold, what was rounded.
    superseded : frozenset of str
        Of the document's references, those that nothing in the new files names any more.
    """

    main: Sequence[Bytes]
    sidecars: Mapping[str, Bytes] = field(default_factory=dict)
    notices: tuple[str, ...] = ()
    superseded: frozenset[str] = frozenset()


class Document(ABC):
    """An opened file. Nothing of it is changed: `patch` makes new bytes.

    Attributes
    ----------
    format : str
        "ply", "obj", "gltf", "glb", "xyz", "pts" or "npz".
    name : str
        The file as the user named it, for messages.
    notices : list of str
        What the user should be told about this file, one sentence each, without the file's name.
    """

    format: ClassVar[str]

    def __init__(self, name: str) -> None:
        self.name = name
        self.notices: list[str] = []

    @abstractmethod
    def painted(self) -> PaintedVertices:
        """Return the vertex colours and their surface.

        Returns
        -------
        PaintedVertices
            The same record at every call.

        Raises
        ------
        InputError
            If the document has no vertex colours, or they or the geometry are damaged.
        """

    def grid(self) -> NDArray[np.int64] | None:
        """Return the regular grid that the vertices were measured on, if that is their surface.

        Returns
        -------
        ndarray of int64, shape (H, W), or None
            Which row of `painted()` stands at each place, -1 for none. Positions may then not be finite, where nothing
            was measured. None: the vertices are no range image.
        """
        return None

    def has_vertex_colours(self) -> bool:
        """Tell whether `painted` has anything to return, without checking all of it."""
        try:
            self.painted()
        except InputError:
            return False
        return True

    def attributes(self) -> tuple[str, ...]:
        """Return the names of what vertices have beside places and colours; "normal" if they have normals."""
        return ()

    def attribute(self, name: str) -> NDArray[np.float64]:
        """Return what vertices have beside places and colours.

        Parameters
        ----------
        name : str
            As `attributes` gives it; in any case of letters.

        Returns
        -------
        ndarray of float64, shape (V, G)
            Rows as in `painted().colours`. Integers of full scale count as such only where the format says that they
            are fractions. Normals are of unit length or 0, and in the space of the positions.

        Raises
        ------
        InputError
            If vertices have nothing of this name, or it is damaged.
        """
        known = ", ".join(self.attributes()) or "nothing"
        raise InputError(self.name, f"its vertices have no {name}, but {known} beside their colours")

    def has_normals_by_vertex(self) -> bool:
        """Tell whether `patch` puts normals into the document when vertices move."""
        return "normal" in self.attributes()

    def require_movable(self) -> None:
        """Check that `patch` can take new places of vertices.

        Raises
        ------
        InputError
            If the format, or the way that they are stored, does not let positions be replaced.
        """
        raise InputError(self.name, f"the positions of a {self.format} file cannot be replaced")

    def slots(self) -> tuple[Slot, ...]:
        """Return the material slots that have textures, the base colour first."""
        return ()

    def textured(self, slot: Slot) -> TexturedSurface:
        """Return the textures of a slot and the surface that they are painted on.

        Returns
        -------
        TexturedSurface
            The same record at every call.

        Raises
        ------
        InputError
            If the slot has no texture, an image is missing, unsupported or outside the model's folder, or texture
            coordinates are damaged.
        """
        raise InputError(self.name, f"it has no {slot} texture")

    @abstractmethod
    def patch(
        self,
        colours: NDArray[np.float32] | None,
        stem: str,
        *,
        moved: bool,
        images: Mapping[tuple[Slot, str], ImageFile] = NO_IMAGES,
        places: MovedVertices | None = None,
    ) -> Written:
        """Return the document's files with other colours and everything else as it was.

        Parameters
        ----------
        colours : ndarray of float32, shape (V, C), or None
            Rows as in `painted().colours`; None: as they are. Every entry that equals the one there keeps its stored
            bytes; others are rounded to the stored type once, to the nearest, after clipping to its range.
        images : mapping of (Slot, str) to ImageFile
            New images by slot and `Texture.key`, of the same size in pixels: each replaces that image in that slot and
            nowhere else. The type of file may be another one than before.
        places : MovedVertices or None
            New places of the vertices, which `require_movable` has allowed; None: as they are. Every coordinate that
            equals the one there keeps its stored bytes; others are rounded to the stored type once.
        stem : str
            Name of the output file without folder and extension, for naming changed sidecars.
        moved : bool
            Whether the output lies in another folder than the source. If it does, changed sidecars keep
            their names; if not, they are named after `stem`, so that no source is overwritten.
        """

    @abstractmethod
    def references(self) -> Sequence[str]:
        """Return relative paths of existing unchanged files that the model needs beside it ("/" separates)."""

    @abstractmethod
    def contents(self) -> MeshContents:
        """Return the mesh for conversion to another format.

        Raises
        ------
        InputError
            As `painted`.
        """

    def anatomy(self) -> Anatomy:
        """Take the file apart, for comparison with another.

        Raises
        ------
        InputError
            If it cannot be taken apart, or what it is made of is damaged.
        """
        raise InputError(self.name, f"a {self.format} file cannot be compared with another")

    @abstractmethod
    def facts(self) -> dict[str, object]:
        """Return facts about the file for `beltrami info`, in JSON types, in the order to be shown."""
