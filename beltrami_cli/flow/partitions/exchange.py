"""What pieces are to those who run them: samples that they own, and samples of others that they borrow.

Between two iterations every piece is given the new values of what it borrows, so that each iteration has the input that
it would have on the whole surface.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray


@dataclass(frozen=True)
class Advance:
    """What an iteration made of a piece.

    Attributes
    ----------
    values : ndarray of float32, shape (O, N)
        New values of the samples that it owns.
    samples : float
        Samples that the kernels of these held, together.
    truncated : int
        Kernels that were cut short.
    is_exact : bool
        False if a kernel reached samples near the end of the piece, of which it does not know all neighbours. Then the
        values must not be used, and the piece has to borrow more.
    """

    values: NDArray[np.float32]
    samples: float
    truncated: int
    is_exact: bool = True


class Piece(Protocol):
    """A piece of a surface with S samples; it can be sent to another process."""

    owned: NDArray[np.int64]
    """Numbers of the samples whose values it makes, shape (O,)."""
    borrowed: NDArray[np.int64]
    """Numbers of the samples of other pieces whose values it needs before an iteration, shape (B,)."""
    threads: int | None
    """How many threads were asked for; None: whoever runs it decides."""

    def advance(
        self, own: NDArray[np.float32], borrowed: NDArray[np.float32], iteration: int, threads: int
    ) -> Advance:
        """Make an iteration, counted from 0, from the values of what it owns, (O, N), and borrows, (B, N)."""


@dataclass(frozen=True)
class Loan:
    """What one piece borrows from another.

    Attributes
    ----------
    lender : int
        The other piece.
    rows : ndarray of int64, shape (K,)
        Which of the lender's own values.
    places : ndarray of int64, shape (K,)
        Where they stand among the values that the borrower needs.
    """

    lender: int
    rows: NDArray[np.int64]
    places: NDArray[np.int64]


def plan_loans(pieces: Sequence[Piece], count: int) -> list[list[Loan]]:
    """Find out who lends what to whom.

    Parameters
    ----------
    pieces : sequence of Piece
        Which own every sample once.
    count : int
        S, the samples of all.

    Returns
    -------
    list of list of Loan
        For each piece what it borrows.
    """
    owner, row = np.full(count, -1, np.int32), np.zeros(count, np.int64)
    for number, piece in enumerate(pieces):
        owner[piece.owned] = number
        row[piece.owned] = np.arange(len(piece.owned))
    plans = []
    for piece in pieces:
        lenders = owner[piece.borrowed]
        loans = []
        for lender in np.unique(lenders).tolist():
            places = np.flatnonzero(lenders == lender)
            loans.append(Loan(lender, row[piece.borrowed[places]], places))
        plans.append(loans)
    return plans


def collect(loans: Sequence[Loan], lent: Sequence[NDArray[np.float32]], width: int) -> NDArray[np.float32]:
    """Put what others lend, an array of shape (K, `width`) a loan, in the order that the borrower needs."""
    values = np.empty((sum(len(loan.places) for loan in loans), width), np.float32)
    for loan, rows in zip(loans, lent, strict=True):
        values[loan.places] = rows
    return values
