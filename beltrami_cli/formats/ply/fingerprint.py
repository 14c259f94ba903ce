"""PLY files taken apart for comparison: the header, the elements, and what follows them, without the colours."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import InputError
from beltrami_cli.formats.document import PLACEHOLDER, Fingerprint, NamedImage
from beltrami_cli.formats.ply.tables import indices
from beltrami_cli.formats.tokens import exchange_spans, exchange_tokens, find_tokens, zeroed

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from beltrami_cli.arrays import Float32s, Int64s
    from beltrami_cli.formats.model_folder import ModelFolder
    from beltrami_cli.formats.ply.header import Header
    from beltrami_cli.formats.ply.tables import Table
    from beltrami_cli.formats.ply.texturing import TextureComment
    from beltrami_cli.formats.ply.vertex_properties import Paint


def take_apart(
    data: bytes,
    header: Header,
    tables: Mapping[str, Table],
    paint: Paint | None,
    colours: Float32s | None,
    images: Sequence[TextureComment],
    folder: ModelFolder,
) -> Fingerprint:
    """Take a PLY file apart: header, elements, and what stands behind them."""
    spans = {(image.start, image.end): PLACEHOLDER for image in images if image.path is not None}
    parts = {"header": exchange_spans(data[: header.end], spans)}
    places = [] if paint is None else [indices(tables["vertex"].places(name)) for name in paint.names]
    hidden = np.concatenate([np.empty(0, np.int64), *places])
    starts = [table.start for table in tables.values()]
    stop = [*tables.values()][-1].stop if tables else 0
    if header.order:
        body = zeroed(data, hidden, np.dtype(paint.type).itemsize if paint else 0)
        bounds, end = [*starts, stop], len(data)
    else:
        text = data[header.end :]
        body, token_starts = _blanked_text(text, hidden)
        edges = np.append(token_starts, len(body))
        bounds, end = edges[np.minimum([*starts, stop], len(edges) - 1)].tolist(), len(body)
    for name, (first, last) in zip(tables, pairwise(bounds), strict=True):
        parts[f"element {name}"] = body[first:last]
    parts["what follows the last element"] = body[bounds[-1] : end] if tables else data[header.end :]
    return Fingerprint(
        parts, {} if colours is None else {"vertex colours": colours}, _paintings(images, folder)
    )


def _blanked_text(text: bytes, hidden: Int64s) -> tuple[bytes, Int64s]:
    """Return a text with a placeholder for some of its tokens, and where every token starts in it."""
    starts, ends = find_tokens(text)
    order = np.sort(hidden)
    pieces = exchange_tokens(
        text, starts[order], ends[order], lambda block: [PLACEHOLDER] * (block.stop - block.start)
    )
    shorter = np.zeros(len(starts) + 1, np.int64)
    shorter[order + 1] = ends[order] - starts[order] - len(PLACEHOLDER)
    return b"".join(pieces), starts - np.cumsum(shorter)[:-1]


def _paintings(images: Sequence[TextureComment], folder: ModelFolder) -> dict[str, NamedImage]:
    found = {}
    for number, image in enumerate(images):
        if image.path is not None:
            try:
                found[f"texture {number}"] = NamedImage(image.name, folder.read(image.path))
            except OSError as error:
                raise InputError(image.name, f"cannot be read ({error.strerror})") from error
    return found
