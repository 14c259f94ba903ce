"""Parameters in JSON types: as asked for, as used, and what those that were chosen were chosen by."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from beltrami_cli.flow.beltrami_flow import BeltramiFlow
    from beltrami_cli.flow.tuning.choice import Choice
    from beltrami_cli.samples.settings.smooth import SmoothSettings


def describe_settings(settings: SmoothSettings) -> dict[str, object]:
    """Return what was asked for."""
    return {
        **dataclasses.asdict(settings.kernel),
        "threads": settings.kernel.thread_count,
        "space": settings.space,
        "channels": settings.channels,
        "on": settings.on,
        "textures": dataclasses.asdict(settings.textures),
        "image": dataclasses.asdict(settings.image),
        "level_set": dataclasses.asdict(settings.level_set),
        "embedding": dataclasses.asdict(settings.embedding),
    }


def describe_kernel(settings: SmoothSettings, flow: BeltramiFlow[Any]) -> dict[str, object]:
    """Return the parameters of the kernel that a flow uses."""
    choice = describe_choice(flow.choice)
    used = dataclasses.asdict(dataclasses.replace(flow.parameters, beta=flow.beta))
    del used["free"]  # nothing is any more
    return {
        **used,
        "threads": settings.kernel.thread_count,
        "space": settings.space,
        **({"guide_betas": flow.manifold.guide_betas} if flow.manifold.guide_betas else {}),
        **({"choice": choice} if choice else {}),
    }


def describe_choice(choice: Choice | None) -> dict[str, object] | None:
    """Return in JSON types what was chosen, and by what estimate."""
    return None if choice is None else dataclasses.asdict(choice)
