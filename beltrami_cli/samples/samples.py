"""What is coloured in a document, as samples of an image manifold, and the way back into the document.

Vertices, points, texels, pixels and vertices on a grid differ in how their colours are taken and given back, in nothing
else: whoever gives samples new colours does not ask which they are.
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from beltrami_cli.formats.image.picture import as_stored
from beltrami_cli.surface.colour_values import store_integers

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from beltrami_cli.flow.beltrami_flow import BeltramiFlow, FlowResult
    from beltrami_cli.flow.manifold import NewColours
    from beltrami_cli.formats.document import Document
    from beltrami_cli.samples.probes.probe import Probe
    from beltrami_cli.samples.reports import SamplesReport
    from beltrami_cli.surface.records import ImageFile, Slot

    Progress = Callable[[int, int], None]
    from collections.abc import Iterable, Sequence

    from beltrami_cli.formats.image import Picture
    from beltrami_cli.surface.atlas import Indices

Part = Literal["vertices", "textures", "image"]


@dataclass(frozen=True)
class Repainted:
    """What new colours make of a document: colours of vertices, and places of those that moved, or image files."""

    change: Change
    colours: NDArray[np.float32] | None = None
    positions: NDArray[np.float64] | None = None
    images: dict[tuple[Slot, str], ImageFile] = field(default_factory=dict)
    notices: tuple[str, ...] = ()


@dataclass(frozen=True)
class Grains:
    """What noise is added to: colours in the working space, shape (K, N), and how random numbers belong to them.

    `number_of`, shape (K,), has equal numbers where samples are one place of the surface; they change alike. Where
    `grey`, all channels are one. `stream` keeps the numbers of one part of a document apart from those of another.
    """

    colours: NDArray[np.float32]
    number_of: NDArray[np.integer[Any]]
    stream: int = 0
    grey: NDArray[np.bool_] | None = None

    @property
    def limits(self) -> tuple[float, float]:
        """Where colours with noise are cut off: at 0 and 1, unless some colours lie beyond."""
        low = 0.0 if self.colours.min(initial=0) >= 0 else -np.inf
        return low, 1.0 if self.colours.max(initial=1) <= 1 else np.inf


class Samples(ABC):
    """Coloured samples of a document, in the working space.

    Making them raises UsageError if the settings name channels that are not there, or contradict the document.
    """

    part: ClassVar[Part]
    """The part of a document that they belong to."""

    label: str
    """What people call them."""

    names: tuple[str, ...]
    """The channels that take part: those that change, and those that only enter the metric."""

    @abstractmethod
    def flow(self) -> BeltramiFlow[Any]:
        """Make the flow on these samples; it takes over what it needs, so that large surfaces are not held twice."""

    @abstractmethod
    def report(self, flow: BeltramiFlow[Any], result: FlowResult) -> SamplesReport:
        """Put together what a flow did, but for the change of colours."""

    @abstractmethod
    def repaint(self, new: NewColours) -> Repainted:
        """Put new colours, of which there are some for every sample, back; the samples are of no use afterwards."""

    @abstractmethod
    def grains(self) -> Grains:
        """Return what noise is added to."""

    @abstractmethod
    def shift(self, grains: Grains, after: NDArray[np.float32]) -> Repainted:
        """Put other colours in the place of those in `grains`; what lies beyond seams is shifted as far."""

    @abstractmethod
    def require_writable(self) -> None:
        """Raise what is wrong with images as outputs, before anything is computed."""

    @abstractmethod
    def describe(self) -> dict[str, object]:
        """Return facts about them, their noise, and what smoothing would do, in JSON types, by what they are about."""

    @abstractmethod
    def probe(self, document: Document, *, whole: bool) -> Probe:
        """Run the flow on them for single kernels; `whole`: all of a mesh is shown with a kernel."""

    def notices(self) -> list[str]:
        """Return what users should know of them."""
        return []

    def warnings(self, result: FlowResult) -> list[str]:
        """Return what users should know once a flow was run."""
        del result
        return []

    def named(self, values: NDArray[np.float64]) -> dict[str, float]:
        """Pair a value per channel with the channels' names."""
        return {name: float(value) for name, value in zip(self.names, values, strict=True)}


@dataclass(frozen=True)
class Change:
    """How much colour values changed: how many there are, the sums of changes and of their squares, the largest."""

    count: int = 0
    total: float = 0.0
    squares: float = 0.0
    largest: float = 0.0

    @classmethod
    def between(cls, before: NDArray[np.float32], after: NDArray[np.float32]) -> Change:
        """Compare two arrays of the same shape."""
        difference = np.abs(after - before)
        if not difference.size:
            return cls()
        squares = float(np.einsum("i,i->", difference.ravel(), difference.ravel(), dtype=np.float64))
        return cls(difference.size, float(difference.sum(dtype=np.float64)), squares, float(difference.max()))

    @classmethod
    def joined(cls, changes: Iterable[Change]) -> Change:
        """Take several together."""
        parts = [dataclasses.astuple(change) for change in changes]
        counts, totals, squares, largest = zip(*parts, strict=True) if parts else ((), (), (), (0.0,))
        return cls(sum(counts), sum(totals), sum(squares), max(largest))

    def summary(self) -> dict[str, float]:
        """Return the mean, the root mean square and the largest change."""
        count = max(1, self.count)
        return {"mean": self.total / count, "rms": (self.squares / count) ** 0.5, "largest": self.largest}


def store(
    picture: Picture,
    table: NDArray[Any],
    pixels: Indices,
    values: NDArray[np.float32],
    channels: Sequence[int],
    threads: int,
) -> Change:
    """Put values of full scale 1, shape (K, M), into pixels like a picture's, in place, each rounded once.

    They go into the M channels of the K pixels, and are clipped to the range of the stored type. Those that equal
    what is stored leave its bits as they are.
    """
    if table.dtype.kind == "f":
        before = table[pixels[:, None], channels]
        for channel, old, new in zip(channels, before.T, values.T, strict=True):
            moved = new != old  # -0 stays what it is
            table[pixels[moved], channel] = as_stored(new[moved], picture.kinds[channel])
        return Change.between(before, table[pixels[:, None], channels])
    return Change(values.size, *store_integers(table, pixels, values, channels, threads))
