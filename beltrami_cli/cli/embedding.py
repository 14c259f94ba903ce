"""The options of the embedding: guides, which colours enter the metric, and whether positions move."""

from __future__ import annotations

from typing import Any

import click

from beltrami_cli.errors import UsageError
from beltrami_cli.samples.settings import EmbeddingSettings

_NOTHING = "none"

guide = click.option(
    "--guide", "guides", multiple=True, metavar="NAME|FILE",
    help="Channels that count as distance and stay as they are, such as a clean normal map beside a noisy base colour. "
    "For textures a slot of the same materials, or an image of the same size; for images such an image; for "
    "vertices an attribute (normal, or as the file calls it), an array (.npy, .npz) with a row for each vertex, or a "
    "model whose vertex colours guide. May be repeated.",
)  # fmt: skip
guide_beta = click.option(
    "--guide-beta", "guide_betas", type=float, multiple=True, metavar="B",
    help="Sample spacings per unit of the guide (images have full scale 1, other numbers are taken as they are); once "
    "for all guides, or once for each.  [default: 6 / its standard deviation, less if it is noisy or steep]",
)  # fmt: skip
metric_channels = click.option(
    "--metric-channels", metavar="LIST|none",
    help="Which colour channels count as distance, such as r,g. With none, only the surface and the guides do.  "
    "[default: those that are smoothed]",
)  # fmt: skip
smooth_geometry = click.option(
    "--smooth-geometry", is_flag=True,
    help="Smooth the positions of vertices along with their colours. Creases are kept by the normals, which count as "
    "distance; open borders stay. Curved parts shrink a little.",
)  # fmt: skip
normal_beta = click.option(
    "--normal-beta", type=float, metavar="B",
    help="How strongly --smooth-geometry keeps creases: sample spacings per radian that the normal turns. 0 rounds "
    "them off.  [default: from the noise of the normals]",
)  # fmt: skip

GUIDING = (guide, guide_beta, metric_channels)
MOVING = (smooth_geometry, normal_beta)


def embedding_from(options: dict[str, Any]) -> EmbeddingSettings:
    """Make the settings from the values of these options; those that a command does not have are not given.

    Raises
    ------
    UsageError
        If a value is out of its range.
    """
    return EmbeddingSettings(
        guides=tuple(options["guides"]),
        guide_betas=tuple(options["guide_betas"]),
        metric_channels=_channels(options["metric_channels"]),
        smooth_geometry=options.get("smooth_geometry", False),
        normal_beta=options.get("normal_beta"),
    )


def _channels(text: str | None) -> tuple[str, ...] | None:
    if text is None:
        return None
    names = tuple(name.strip() for name in text.split(",") if name.strip())
    if names == (_NOTHING,):
        return ()
    if not names or _NOTHING in names:
        raise UsageError(
            f"--metric-channels is {text!r}; give channels with commas between them, or {_NOTHING}"
        )
    return names
