"""Images that several slots show: one file, in which each slot changes channels of its own."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from beltrami_cli.samples.textures.colours import COLOUR_SLOTS

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from beltrami_cli.surface.records import Slot


@dataclass
class _Joined:
    pixels: NDArray[Any]
    columns: set[int]
    slots: tuple[Slot, ...]


class SharedImages:
    """What came of images so far, as far as further slots show them.

    Occlusion is the red channel of an image, roughness and metalness are green and blue; they are mostly in one.

    Parameters
    ----------
    keys : iterable of str
        The keys of the textures of all slots, one after the other.
    """

    def __init__(self, keys: Iterable[str] = ()) -> None:
        self._left = Counter(keys)
        self._joined: dict[str, _Joined] = {}

    def join(
        self, slot: Slot, key: str, pixels: NDArray[Any], columns: Sequence[int]
    ) -> tuple[NDArray[Any], tuple[Slot, ...]]:
        """Put what a slot made of an image together with what others made of it.

        Parameters
        ----------
        slot : Slot
            Which one.
        key : str
            The image's.
        pixels : ndarray, shape (H, W, C)
            The image, with the slot's changes alone.
        columns : sequence of int
            Which of its channels the slot changes.

        Returns
        -------
        pixels : ndarray, shape (H, W, C)
            With the changes of others too, as far as they change other channels.
        slots : tuple of Slot
            Those whose changes are in it. Colours and data are not put together: they are encoded in different ways.
        """
        self._left[key] -= 1
        known = self._joined.get(key)
        slots: tuple[Slot, ...] = (slot,)
        if known is not None:
            alike = (slot in COLOUR_SLOTS) == (known.slots[0] in COLOUR_SLOTS)
            if alike and known.columns.isdisjoint(columns):
                others = sorted(known.columns)
                pixels[..., others] = known.pixels[..., others]
                columns, slots = [*columns, *others], (*known.slots, slot)
        if self._left[key] > 0:
            self._joined[key] = _Joined(pixels, set(columns), slots)
        else:
            self._joined.pop(key, None)
        return pixels, slots
