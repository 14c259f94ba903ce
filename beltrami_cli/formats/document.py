"""What every format offers: a document that keeps its bytes and lets only its colours be replaced."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from beltrami_cli.mesh.painted import MeshContents, PaintedVertices

Bytes = bytes | bytearray | memoryview


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
    """

    main: Sequence[Bytes]
    sidecars: Mapping[str, Bytes] = field(default_factory=dict)
    notices: tuple[str, ...] = ()


class Document(ABC):
    """An opened file. Nothing of it is changed: `patch` makes new bytes.

    Attributes
    ----------
    format : str
        "ply", "obj", "gltf" or "glb".
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

    @abstractmethod
    def patch(self, colours: NDArray[np.float32], stem: str, *, moved: bool) -> Written:
        """Return the document's files with other vertex colours and everything else as it was.

        Parameters
        ----------
        colours : ndarray of float32, shape (V, C)
            Rows as in `painted().colours`. Every entry that equals the one there keeps its stored bytes;
            others are rounded to the stored type once, to the nearest, after clipping to its range.
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

    @abstractmethod
    def facts(self) -> dict[str, object]:
        """Return facts about the file for `beltrami info`, in JSON types, in the order to be shown."""
