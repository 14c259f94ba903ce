"""Which channels of an image are its colours.

Layers of an EXR file are groups of channels with a common prefix, such as ViewLayer.Combined.R and .G.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

# Last parts of the names of layers with the final image: in Blender, in Arnold and V-Ray, in Nuke.
_FINAL_LAYERS = ("combined", "beauty", "rgba")


def layers_of(channels: Sequence[str]) -> dict[str, list[int]]:
    """Return the numbers of the channels in each layer; "" stands for channels outside of layers."""
    layers: dict[str, list[int]] = {}
    for number, channel in enumerate(channels):
        layers.setdefault(channel.rpartition(".")[0], []).append(number)
    return layers


def coloured_layers(channels: Sequence[str]) -> list[str]:
    """Return the layers that have channels for red, green and blue, or grey."""
    return [
        layer
        for layer, numbers in layers_of(channels).items()
        if named_colours(channel_names([channels[number] for number in numbers])) is not None
    ]


def colour_layer(channels: Sequence[str]) -> str | None:
    """Return the layer that holds the colours of a file, or None if that is ambiguous."""
    layers, coloured = layers_of(channels), coloured_layers(channels)
    if len(layers) == 1:
        return next(iter(layers))
    if "" in coloured:
        return ""
    final = [layer for layer in coloured if layer.lower().rpartition(".")[2] in _FINAL_LAYERS]
    candidates = final or coloured
    return candidates[0] if len(candidates) == 1 else None


def colour_part(parts: Mapping[str, Sequence[str]]) -> int | None:
    """Return the number of the part, of channels by the names of parts, that holds the colours; None if ambiguous."""
    coloured = {part: layers for part, channels in parts.items() if (layers := coloured_layers(channels))}
    final = [part for part in coloured if part.lower().rpartition(".")[2] in _FINAL_LAYERS]
    plain = [part for part, layers in coloured.items() if "" in layers]
    candidates = final or plain or [*coloured] or [*parts][:1]
    return [*parts].index(candidates[0]) if len(candidates) == 1 else None


def colours_and_alpha(channels: Sequence[str], layer: str | None) -> tuple[tuple[int, ...], int | None]:
    """Return the colour channels of a layer (None: of all together), and its alpha channel.

    Colours are red, green and blue by their names, or grey, or else the first channels that are not alpha.
    """
    numbers = list(range(len(channels))) if layer is None else layers_of(channels)[layer]
    names = channel_names([channels[number] for number in numbers])
    alpha = next((i for i, name in enumerate(names) if name in ("a", "alpha")), None)
    colour = named_colours(names)
    if colour is None:
        others = [i for i in range(len(names)) if i != alpha] or [0]
        colour = tuple(others[:3]) if len(others) >= 3 else (others[0],)
    return tuple(numbers[i] for i in colour), None if alpha is None else numbers[alpha]


def named_colours(names: Sequence[str]) -> tuple[int, ...] | None:
    """Return the numbers of the channels that are called red, green and blue, or luminance; None if there are none."""
    if all(letter in names for letter in "rgb"):
        return tuple(names.index(letter) for letter in "rgb")
    if "y" in names and "x" not in names:  # a luminance, and no coordinate
        return (names.index("y"),)
    return None


def channel_names(channels: Sequence[str]) -> list[str]:
    """Return the lower-case names of channels without the prefix of their layer."""
    return [channel.rpartition(".")[2].lower() for channel in channels]
