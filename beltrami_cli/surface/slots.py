"""The slots of materials: what a texture stands for. The command line reads them, so nothing heavy is imported here."""

from typing import Literal, get_args

Slot = Literal["baseColor", "emissive", "normal", "occlusion", "metallicRoughness"]
SLOTS: tuple[Slot, ...] = get_args(Slot)
COLOUR_SLOTS: tuple[Slot, ...] = ("baseColor", "emissive")  # the other slots are data
