"""From one format to another, saying what the other cannot hold."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from beltrami_cli.formats.document import Document, Written


def convert(
    document: Document, colours: NDArray[np.float32], target_format: str, stem: str, *, moved: bool
) -> Written:
    """Write a document's mesh, with other colours, in another format.

    Parameters
    ----------
    document : Document
        The source.
    colours : ndarray of float32, shape (V, C)
        Rows as in ``document.painted().colours``.
    target_format : {"ply", "obj", "glb", "gltf"}
        Another format than the document's.
    stem : str
        Name of the output without extension, for files beside it.
    moved : bool
        Whether the output lies in another folder than the source.

    Returns
    -------
    Written
        Its notices say what was lost.
    """
    from beltrami_cli.formats.gltf import GltfDocument

    if isinstance(document, GltfDocument) and target_format in ("glb", "gltf"):
        form: Literal["glb", "gltf"] = "glb" if target_format == "glb" else "gltf"
        return document.repackaged(colours, stem, form, moved=moved)
    contents = dataclasses.replace(document.contents(), colours=colours)
    if target_format == "ply":
        from beltrami_cli.formats.ply import write_ply

        return write_ply(contents, stem)
    if target_format == "obj":
        from beltrami_cli.formats.obj import write_obj

        return write_obj(contents, stem)
    from beltrami_cli.formats.gltf import write_glb, write_gltf

    return write_glb(contents, stem) if target_format == "glb" else write_gltf(contents, stem)
