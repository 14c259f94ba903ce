"""The controls of a live page, made from the declarations of parameters."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from beltrami_cli.errors import UsageError
from beltrami_cli.fields import override, parameters
from beltrami_cli.flow.parameters import STRENGTHS, TUNABLE
from beltrami_cli.layers.settings import DEFAULTS, SmoothSettings, given_values

_DECLARED = {each.name: each for each in parameters(SmoothSettings, deep=True)}
_NAMES = ("strength", "patches", "noise", "iterations", "t", "beta", "window")

CONTROLS = [_DECLARED[name] for name in _NAMES]
"""Parameters with controls."""

SLIDERS = {
    "strength": (STRENGTHS["gentle"], STRENGTHS["strong"], 0.05),
    "iterations": (1, 20, 1), "t": (0.5, 10, 0.1), "beta": (0, 40, 0.5), "window": (3, 31, 2),
}  # fmt: skip
"""Minimum, maximum and step of controls."""


def plain_settings(settings: SmoothSettings) -> SmoothSettings:
    """Return settings with the defaults for all parameters that have controls."""
    kernel = settings.kernel
    reset = {name: _DECLARED[name].default for name in _NAMES}
    given = [name for name in TUNABLE if name in SLIDERS and getattr(kernel, name) is not None]
    free = tuple(name for name in TUNABLE if name in kernel.free or name in given)
    textures = dataclasses.replace(settings.textures, slots=DEFAULTS.textures.slots)
    kernel = dataclasses.replace(kernel, **reset, free=free)
    return dataclasses.replace(settings, kernel=kernel, textures=textures)


def values_of(settings: SmoothSettings) -> dict[str, Any]:
    """Return the initial values of the controls: the given parameters."""
    given = given_values(settings)
    values = {name: given[name] for name in _NAMES if name in given}
    return {**values, "slots": list(settings.textures.slots)}


def settings_from(plain: SmoothSettings, values: Mapping[str, Any]) -> SmoothSettings:
    """Return settings with the values of controls; UsageError if one is invalid."""
    made: dict[str, Any] = {}
    for name, value in values.items():
        if name not in (*_NAMES, "slots"):
            raise UsageError(f"there is no control {name}")
        if value not in (None, ""):
            made[name] = tuple(value) if isinstance(value, list) else value
    return override(plain, **made)
