"""An OBJ file and its libraries taken apart, for comparison with others."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.formats.document import PLACEHOLDER, Fingerprint, NamedImage
from beltrami_cli.formats.obj.repainting import shifted
from beltrami_cli.formats.tokens import exchange_spans, exchange_tokens, zeroed

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.formats.obj.materials import Library, Materials
    from beltrami_cli.formats.obj.scanning import Scan
    from beltrami_cli.formats.tokens import Spans

_BYTES_OF_POLYPAINT = 6  # behind two digits of the mask


def take_apart(
    data: bytes, scan: Scan, colours: NDArray[np.float32] | None, materials: Materials
) -> Fingerprint:
    """Take an OBJ file apart: its own text, that of each library, and the images that these name.

    Parameters
    ----------
    data : bytes
        The file.
    scan : Scan
        What is in it.
    colours : ndarray of float32, shape (V, 3), or None
        The colours of its vertices, if they have any.
    materials : Materials
        Its libraries.

    Raises
    ------
    InputError
        If an image cannot be read.
    """
    if scan.polypaint is not None:
        data = zeroed(data, scan.polypaint.starts + 2, _BYTES_OF_POLYPAINT)
    mentions: Spans = {(a, b): PLACEHOLDER for library in materials.libraries for _, a, b in library.mentions}
    text = exchange_spans(data, mentions)
    if colours is not None and scan.polypaint is None:
        starts, ends = (
            np.sort(shifted(tokens[:, 3:].ravel(), mentions))
            for tokens in (scan.vertices.token_starts, scan.vertices.token_ends)
        )
        pieces = exchange_tokens(text, starts, ends, lambda block: [PLACEHOLDER] * (block.stop - block.start))
        text = b"".join(pieces)
    parts, paintings = {"statements": text}, {}
    for number, library in enumerate(materials.libraries):
        parts[f"material library {number + 1}"] = _without_names(library)
        for index, (found, path) in enumerate(library.maps):
            if path is not None:
                label = f"material {found.material!r}, {found.keyword} ({number + 1}.{index + 1})"
                paintings[label] = NamedImage(found.name, materials.read(path))
    return Fingerprint(parts, {} if colours is None else {"vertex colours": colours}, paintings)


def _without_names(library: Library) -> bytes:
    """Return a library with a placeholder for the names of the images that are there."""
    spans: Spans = {(found.start, found.end): PLACEHOLDER for found, path in library.maps if path is not None}
    return exchange_spans(library.data, spans)
