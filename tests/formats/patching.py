"""Documents with other colours."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.formats.document import Naming
from formats.gltf_files import joined

if TYPE_CHECKING:
    from beltrami_cli.formats.document import Document


def patched(document: Document, colours: object) -> bytes:
    """Return the main file with other colours; None: the present ones."""
    new = None if colours is None else np.asarray(colours, np.float32)
    return joined(document.patch(new, Naming("out")))
