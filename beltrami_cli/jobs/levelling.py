"""Levelling as a painter, alone or before the flow."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

from beltrami_cli.samples.levelled_charts import photographs_of

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    from numpy.typing import NDArray

    from beltrami_cli.formats.document import Document
    from beltrami_cli.samples.reports import LevelReport
    from beltrami_cli.samples.samples import Repainted, Samples
    from beltrami_cli.samples.selection import OutputFormat, Selection
    from beltrami_cli.samples.settings import LevelSettings


class Levelling:
    """A painter that takes exposure steps out."""

    changes = True
    colours_only = True
    works_on_disk = True

    def __init__(self, wanted: LevelSettings) -> None:
        self._wanted = wanted
        self._photographs: NDArray[np.int64] | None = None
        self.done: list[LevelReport] = []

    def check(self, document: Document, selection: Selection, target: OutputFormat) -> None:
        """Raise InputError if vertex colours do not say which photograph they are from."""
        del target
        if selection.vertices:
            self._photographs = photographs_of(document, self._wanted.photographs)

    def level(self, samples: Samples) -> LevelReport:
        """Level samples, before they are painted otherwise."""
        return samples.level(self._wanted, self._photographs if samples.part == "vertices" else None)

    def paint(self, samples: Samples, progress: Callable[[int, int], None] | None) -> Repainted:
        """Level samples, and do nothing else to them."""
        del progress
        report = self.level(samples)
        repainted = samples.repaint(samples.levelled())
        self.done.append(dataclasses.replace(report, change=repainted.change.summary()))
        return repainted
