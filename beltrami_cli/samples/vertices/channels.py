"""Which channels of vertices' colours change, and which enter the metric."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from beltrami_cli.errors import UsageError

if TYPE_CHECKING:
    from beltrami_cli.samples.settings import SmoothSettings
    from beltrami_cli.surface.records import PaintedVertices


@dataclass(frozen=True)
class ChosenChannels:
    """Which columns of vertices' colours do what.

    Attributes
    ----------
    taking_part : list of int
        Those that the samples have: those that change, and those that enter the metric.
    changing : list of int
        Those that change.
    metric : list of int or None
        Which of those that take part enter the metric, counted among these; None: all.
    """

    taking_part: list[int]
    changing: list[int]
    metric: list[int] | None

    @property
    def written(self) -> list[int]:
        """Those that change, counted among those that take part."""
        return [self.taking_part.index(channel) for channel in self.changing]


def choose_channels(painted: PaintedVertices, settings: SmoothSettings) -> ChosenChannels:
    """Choose the columns of vertices' colours by the settings.

    Raises
    ------
    UsageError
        If the settings name channels that are not there.
    """
    changing = _columns(painted, settings.channels)
    wanted = settings.embedding.metric_channels
    counting = changing if wanted is None else _columns(painted, wanted)
    channels = sorted({*changing, *counting})
    metric = None if counting == channels else [channels.index(channel) for channel in counting]
    return ChosenChannels(channels, changing, metric)


def _columns(painted: PaintedVertices, names: tuple[str, ...] | None) -> list[int]:
    """Find the columns of channels by their names or first letters; None: all."""
    if names is None:
        return list(range(len(painted.channels)))
    columns = []
    for name in names:
        fits = [i for i, channel in enumerate(painted.channels) if name.lower() in (channel, channel[0])]
        if not fits:
            raise UsageError(f"there is no channel {name}; the colours have {', '.join(painted.channels)}")
        columns.append(fits[0])
    return sorted(set(columns))
