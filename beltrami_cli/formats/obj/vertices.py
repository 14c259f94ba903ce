"""The `v` statements of an OBJ file: positions, and the colours that the text custom adds to them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.formats.obj.statements import Statements

_SIZES = (3, 4, 5, 6, 7, 8)
_PLAIN, _ALPHA_OR_WEIGHT, _BOTH = 6, 7, 8  # numbers of a vertex with colours


@dataclass(frozen=True)
class Vertices:
    """The vertices of a file.

    Attributes
    ----------
    positions : ndarray of float64, shape (N, 3)
        All vertices.
    coloured : ndarray of int64, shape (V,)
        Which of them have colours, in file order.
    colours : ndarray of float64, shape (V, 3)
        The numbers in the file.
    alpha : ndarray of float64, shape (V,), or None
        The numbers in the file, if all coloured vertices have one.
    token_starts, token_ends : ndarray of int64, shape (V, 6)
        Where the positions and the colours of coloured vertices stand in the file.
    notice : str
        How numbers were understood that can mean two things, or empty.
    """

    positions: NDArray[np.float64]
    coloured: NDArray[np.int64]
    colours: NDArray[np.float64]
    alpha: NDArray[np.float64] | None
    token_starts: NDArray[np.int64]
    token_ends: NDArray[np.int64]
    notice: str


def read_vertices(statements: Statements, name: str) -> Vertices:
    """Read all vertices.

    Parameters
    ----------
    statements : Statements
        The file.
    name : str
        Its name for messages.

    Raises
    ------
    InputError
        If there are none, or one is not made of 3 to 8 finite numbers, with the line.

    Notes
    -----
    Six numbers are x y z r g b and eight x y z w r g b a. Seven are x y z r g b a, unless all such vertices
    of the file have 1 as the fourth and not all of them 1 as the seventh: then they are x y z w r g b.
    With three to five numbers a vertex has no colour.
    """
    chosen = statements.select(b"v")
    if not chosen.size:
        raise InputError(name, "there are no vertices ('v' lines)", "is this a Wavefront OBJ file?")
    tokens, offsets = statements.arguments(chosen)
    sizes = np.diff(offsets)
    strange = ~np.isin(sizes, _SIZES)
    if strange.any():
        bad = int(np.argmax(strange))
        line = statements.line(statements.heads[chosen[bad]])
        raise InputError(name, f"line {line}: a vertex has 3 to 8 numbers, not {sizes[bad]}")
    values = statements.numbers(tokens)
    if not np.isfinite(values).all():
        raise statements.error(tokens[int(np.argmin(np.isfinite(values)))], "is not a finite number")
    weights, notice = _weights(values, offsets, sizes)
    coloured = np.flatnonzero(sizes >= _PLAIN)
    colour_at = (
        offsets[coloured]
        + 3
        + ((sizes[coloured] == _BOTH) | ((sizes[coloured] == _ALPHA_OR_WEIGHT) & weights))
    )
    colour_at = colour_at[:, None] + np.arange(3)
    known_at = np.column_stack([offsets[coloured, None] + np.arange(3), colour_at])
    has_alpha = offsets[coloured + 1] - colour_at[:, 2] > 1
    return Vertices(
        positions=values[offsets[:-1, None] + np.arange(3)],
        coloured=coloured,
        colours=values[colour_at],
        alpha=values[colour_at[:, 2] + 1] if has_alpha.size and has_alpha.all() else None,
        token_starts=statements.starts[tokens[known_at]],
        token_ends=statements.ends[tokens[known_at]],
        notice=notice,
    )


def _weights(
    values: NDArray[np.float64], offsets: NDArray[np.int64], sizes: NDArray[np.int64]
) -> tuple[bool, str]:
    """Tell whether the fourth of seven numbers is a weight, and the sentence about it."""
    firsts = offsets[:-1][sizes == _ALPHA_OR_WEIGHT]
    if not firsts.size:
        return False, ""
    weights = bool((values[firsts + 3] == 1).all() and (values[firsts + 6] != 1).any())
    meaning = "x y z w r g b" if weights else "x y z r g b a"
    return weights, f"Vertices of seven numbers are taken for {meaning}."
