"""Documents of points, opened and patched."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import InputError
from beltrami_cli.formats.document import Naming

if TYPE_CHECKING:
    from beltrami_cli.formats.document import Document


def patched(document: Document, colours: object) -> bytes:
    return b"".join(document.patch(np.asarray(colours, np.float32), Naming("out")).main)


def use(document: Document) -> None:
    """Do with a document what commands do, on which damage may only end in one line."""
    try:
        colours = document.painted().colours
        patched(document, 1 - np.clip(colours, 0, 1))
        document.contents()
        document.facts()
        document.attributes()
    except InputError as error:
        assert "\n" not in str(error)  # noqa: PT017
