"""Guides for vertex colours: attributes of the vertices, or tables in files."""

from __future__ import annotations

from typing import TYPE_CHECKING

from beltrami_cli.errors import InputError
from beltrami_cli.flow.embedding import Guide, centred
from beltrami_cli.formats.access import EVERYTHING_INSIDE, Access
from beltrami_cli.samples.images.guide_files import exists, read_table, require_finite

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from beltrami_cli.formats.document import Document
    from beltrami_cli.samples.settings import SmoothSettings


def vertex_guides(
    document: Document, settings: SmoothSettings, access: Access = EVERYTHING_INSIDE
) -> list[Guide]:
    """Read all guides for the vertex colours of a document.

    Parameters
    ----------
    document : Document
        With vertex colours.
    settings : SmoothSettings
        Which guides.
    access : Access
        What may be read.

    Returns
    -------
    list of Guide
        With a row for each row of ``document.painted().colours``.

    Raises
    ------
    InputError
        If there is neither an attribute nor a file of the name, or it is damaged or does not fit.
    """
    return [
        Guide(name, centred(_values(document, name, access)), beta)
        for name, beta in settings.embedding.weighted_guides
    ]


def _values(document: Document, name: str, access: Access) -> NDArray[np.float64]:
    known = document.attributes()
    if name.lower() in {attribute.lower() for attribute in known}:
        values = document.attribute(name)
        require_finite(values, document.name, "vertex")
        return values
    if not exists(name):
        attributes = ", ".join(known) or "no others"
        raise InputError(
            name, f"no such file, and no attribute of the vertices of {document.name}, which has {attributes}"
        )
    return read_table(name, len(document.painted().positions), document.name, access)
