"""New values of some vertex properties in the body of a PLY file, every other byte staying as it is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.formats.ply.body import values_in_bytes
from beltrami_cli.formats.ply.tables import indices
from beltrami_cli.formats.tokens import exchange_tokens, find_tokens

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from beltrami_cli.formats.document import Bytes
    from beltrami_cli.formats.ply.header import Header
    from beltrami_cli.formats.ply.tables import Table


@dataclass(frozen=True)
class Change:
    """New values of one property.

    Attributes
    ----------
    name : str
        The property, a scalar.
    rows : ndarray of bool, shape (V,)
        Which vertices change.
    values : ndarray, shape (number of these,)
        Their new values, in the property's type.
    """

    name: str
    rows: NDArray[np.bool_]
    values: NDArray[Any]


def patch_body(data: bytes, header: Header, vertices: Table, changes: Sequence[Change]) -> list[Bytes]:
    """Exchange values in the body.

    Parameters
    ----------
    data : bytes
        The file.
    header : Header
        Its header.
    vertices : Table
        The vertex element with its rows.
    changes : sequence of Change
        What is new; each property once, and at least one value in all.

    Returns
    -------
    list of bytes-like
        The new body, in pieces.
    """
    if not header.order:
        return [*_patch_text(data[header.end :], vertices, changes)]
    patched = bytearray(data)
    for change in changes:
        everywhere = values_in_bytes(patched, header.order + change.values.dtype.str[1:])
        where = vertices.places(change.name)
        if isinstance(where, slice):
            everywhere[where][change.rows] = change.values
        else:
            everywhere[where[change.rows]] = change.values
    return [memoryview(patched)[header.end :]]


def _patch_text(text: bytes, vertices: Table, changes: Sequence[Change]) -> list[bytes | memoryview]:
    starts, ends = find_tokens(text)
    tokens = np.concatenate([indices(vertices.places(change.name))[change.rows] for change in changes])
    # Properties may stand in any order; tokens are exchanged from first to last.
    order = np.argsort(tokens)
    firsts = np.cumsum([0] + [len(change.values) for change in changes])

    def spell(block: slice) -> list[bytes]:
        wanted = order[block]
        spelled = np.empty(len(wanted), object)
        for change, first in zip(changes, firsts[:-1], strict=True):
            mine = (wanted >= first) & (wanted < first + len(change.values))
            spelled[mine] = _spelled(change.values[wanted[mine] - first])
        return list(spelled)

    there = tokens[order]
    return exchange_tokens(text, starts[there], ends[there], spell)


def _spelled(values: NDArray[Any]) -> list[bytes]:
    if values.dtype.kind in "ui":
        return [b"%d" % value for value in values.tolist()]
    spelled: list[bytes] = values.astype("S32").tolist()  # the shortest that reads back the same
    return spelled
