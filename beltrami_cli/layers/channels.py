"""Choice of channels by their names, and of a layer of an EXR file."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence
from dataclasses import dataclass

from beltrami_cli.errors import UsageError
from beltrami_cli.formats.image.channels import coloured_layers, colours_and_alpha, layers_of
from beltrami_cli.formats.image.decoded_image import DecodedImage, with_colours_of
from beltrami_cli.layers.settings import SmoothSettings

COLOURS = ("red", "green", "blue", "grey")


@dataclass(frozen=True)
class ChosenChannels:
    """The sampled channels, by their numbers among all channels."""

    names: tuple[str, ...]  # of the sampled channels: changing ones, and ones that only enter the metric
    sampled: list[int]
    changing: list[int]
    written: list[int]  # channels that change, numbered among the sampled ones
    metric: list[int] | None  # channels of the metric, numbered likewise; None: all


def choose_channels(
    names: tuple[str, ...], settings: SmoothSettings, owner_has: str, *,
    used: Collection[str] | None = None, opacity: bool = False, abbreviable: tuple[str, ...] | None = None,
) -> ChosenChannels:  # fmt: skip
    """Choose channels by name, or by first letter among all or `abbreviable` ones; UsageError if one is absent.

    Only the `used` channels may change; channels that only enter the metric are sampled too. `opacity`, if it is
    smoothed, follows them as one more channel.
    """

    def numbers_of(wanted: tuple[str, ...] | None) -> list[int]:
        numbers = set(range(len(names))) if wanted is None else set[int]()
        for word in wanted or ():
            lower = word.lower()
            fits = [lower == name or (lower == name[0] and name in (abbreviable or names)) for name in names]
            if not any(fits):
                raise UsageError(f"there is no channel {word}; {owner_has} {', '.join(names)}")
            numbers.add(fits.index(True))
        return sorted(numbers)

    changing = [i for i in numbers_of(settings.channels) if used is None or names[i] in used]
    if opacity:
        changing.append(len(names))
        names = (*names, "alpha")
    wanted = settings.embedding.metric_channels
    in_metric = changing if wanted is None else numbers_of(wanted)
    sampled = sorted({*changing, *in_metric})
    metric = None if in_metric == sampled else [sampled.index(channel) for channel in in_metric]
    written = [sampled.index(channel) for channel in changing]
    return ChosenChannels(tuple(names[i] for i in sampled), sampled, changing, written, metric)


def further_channels(image: DecodedImage, names: Sequence[str]) -> dict[str, int]:
    """Return the channels of an image that are neither colours nor opacity, by name."""
    known = dict.fromkeys(names, -1)
    for channel, name in enumerate(image.channels):
        if channel not in (*image.colour, image.alpha):
            # EXR distinguishes R from r.
            known[name.lower() if name.lower() not in known else f"{name}:{channel}"] = channel
    return {name: channel for name, channel in known.items() if channel >= 0}


def with_chosen_layer(image: DecodedImage, settings: SmoothSettings) -> tuple[DecodedImage, SmoothSettings]:
    """Return an image with the colours of the layer that `settings.channels` chooses, if any.

    In the returned settings, the channels of that layer have the names of colours.
    """
    if settings.channels is None or not image.is_layered:
        return image, settings
    members = layers_of(image.channels)
    layers = {layer.lower(): layer for layer in members if layer}
    words = [word.lower() for word in settings.channels]
    layer = _chosen_layer(image, layers, words)
    if layer is not None:
        image = with_colours_of(image, layer)
    names = COLOURS[:3] if len(image.colour) == 3 else COLOURS[3:]
    colours = {image.channels[i].lower(): name for i, name in zip(image.colour, names, strict=True)}
    chosen = list[str]()
    for word in words:
        if word not in layers:
            chosen.append(colours.get(word, word))
        elif layers[word] == image.layer:
            chosen += names
        else:
            chosen += (image.channels[i].lower() for i in members[layers[word]])
    return image, dataclasses.replace(settings, channels=tuple(chosen))


def _chosen_layer(image: DecodedImage, layers: dict[str, str], words: Sequence[str]) -> str | None:
    """Return the first layer that a word names, or whose colour it names; None if words only name colours."""
    if any(name.startswith(word) for word in words for name in COLOURS):
        return None
    colours = {
        image.channels[i].lower(): layer
        for layer in coloured_layers(image.channels)
        for i in colours_and_alpha(image.channels, layer)[0]
    }
    return next(
        (layer for word in words if (layer := layers.get(word) or colours.get(word)) is not None), None
    )
