"""Progress of many iterations, told by one after the other."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable


def shifted(
    progress: Callable[[int, int], None] | None, before: int, total: int
) -> Callable[[int], None] | None:
    """Make the progress of one iteration count on from those before it."""
    return None if progress is None else lambda done: progress(before + done, total)
