"""Parameters on pages: controls, made from their declarations, and tables of the parameters that were used."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any

from beltrami_cli.errors import UsageError
from beltrami_cli.fields import override, parameters
from beltrami_cli.flow.parameters import STRENGTHS, TUNABLE
from beltrami_cli.layers.settings import DEFAULTS, SmoothSettings, describe_settings

NO_NOISE_FOUND = "no noise detected"

_DECLARED = {each.name: each for each in parameters(SmoothSettings, deep=True)}
_NAMES = ("strength", "patches", "noise", "iterations", "t", "beta", "window")

CONTROLS = [_DECLARED[name] for name in _NAMES]
"""What the controls of a page set."""

SLIDERS = {
    "strength": (STRENGTHS["gentle"], STRENGTHS["strong"], 0.05),
    "iterations": (1, 20, 1), "t": (0.5, 10, 0.1), "beta": (0, 40, 0.5), "window": (3, 31, 2),
}  # fmt: skip
"""Least and greatest value of controls, and step."""

# Kernel parameters that are shown even with their defaults.
_ALWAYS = ("iterations", "t", "beta", "beta_growth", "metric_steps", "space")
_NEVER = ("free", "fast", "on", "threads", "noise")
_WORDS = {"t": "time step, t", "on": "smoothed, --on"}


def plain_settings(settings: SmoothSettings) -> SmoothSettings:
    """Return settings with what the controls set as it is where nothing is given."""
    kernel = settings.kernel
    reset = {name: _DECLARED[name].default for name in _NAMES}
    given = [name for name in TUNABLE if name in SLIDERS and getattr(kernel, name) is not None]
    free = tuple(name for name in TUNABLE if name in kernel.free or name in given)
    textures = dataclasses.replace(settings.textures, slots=DEFAULTS.textures.slots)
    kernel = dataclasses.replace(kernel, **reset, free=free)
    return dataclasses.replace(settings, kernel=kernel, textures=textures)


def given_values(settings: SmoothSettings) -> dict[str, Any]:
    """Return the first values of the controls: the parameters that are given."""
    kernel, values = settings.kernel, dict[str, Any]()
    for name in _NAMES:
        value = getattr(kernel, name)
        is_given = name not in kernel.free if name in TUNABLE else value != _DECLARED[name].default
        if is_given and value is not None:
            values[name] = value
    return {**values, "slots": list(settings.textures.slots)}


def settings_from(plain: SmoothSettings, values: Mapping[str, Any]) -> SmoothSettings:
    """Return settings with the values of controls; UsageError if one cannot be."""
    made: dict[str, Any] = {}
    for name, value in values.items():
        if name not in (*_NAMES, "slots"):
            raise UsageError(f"there is no control {name}")
        if value not in (None, ""):
            made[name] = tuple(value) if isinstance(value, list) else value
    return override(plain, **made)


def used_parameters(report: dict[str, Any]) -> dict[str, list[Any]]:
    """Return rows about the parts in a report of `smooth`, and its job; KeyError and the like if it is none."""
    requested = report["parameters"]
    return {
        "parts": [
            (name, [*_kernel(requested, done), *_measured(requested.get("noise"), done)])
            for name, done in _parts(report)
        ],
        "given": [[*each, "given"] for each in _given(requested)],
        "stages": [[name, f"{spent['wall']:.2f}"] for name, spent in report["stages"].items()],
    }


def _parts(report: dict[str, Any]) -> list[tuple[str, dict[str, Any]]]:
    found = [("vertex colours", report["vertices"]), ("image", report["image"])]
    for done in report["textures"]:
        names = [each["name"] for each in done["textures"]]
        is_one = sum(other["slot"] == done["slot"] for other in report["textures"]) == 1
        found.append((f"{done['slot']} textures" + ("" if is_one else f": {', '.join(names)}"), done))
    return [(name, done) for name, done in found if done]


def _kernel(requested: dict[str, Any], done: dict[str, Any]) -> Iterator[list[str]]:
    """Give the parameters of the kernel as they were used on a part."""
    defaults, choice = describe_settings(DEFAULTS), done["choice"] or {"chosen": {}, "candidates": 0}
    # Parameters that are not given if they have their defaults: tunable ones are free then.
    may_be_default = (requested.keys() - set(DEFAULTS.kernel.free)) | set(requested["free"])
    used = {**requested, **choice["chosen"], "beta": done["beta"], "iterations": done["iterations"]}
    for name, value in requested.items():
        if isinstance(value, dict) or name in _NEVER or (name != "iterations" and not done["iterations"]):
            continue
        if name in choice["chosen"]:
            how = "chosen from the data" if choice["candidates"] else "by the fixed rule"
        elif name == "beta" and value is None:
            how = "from the noise"
        elif name == "iterations" and name in requested["free"] and not done["iterations"]:
            how = "no more noise than rounding makes"
        else:
            how = "default" if value == _plain(defaults[name]) and name in may_be_default else "given"
        if how != "default" or name in _ALWAYS:
            yield [_WORDS.get(name, name.replace("_", " ")), _in_words(used[name]), how]


def noise_in_words(noise: dict[str, float], model: dict[str, float]) -> str:
    """Describe the `noise` and `noise_model` of a report, of 255: the strongest channel first."""
    strongest = max(noise.values(), default=0.0)
    if not strongest:
        return NO_NOISE_FOUND
    parts = [f"{name} {255 * sigma:.1f}" for name, sigma in noise.items()] if len(noise) > 1 else []
    words = f"{255 * strongest:.1f}/255" + (f" ({', '.join(parts)})" if parts else "")
    names = {"quiet": "quiet places", "loud": "loud places"}
    details = [
        f"{names.get(name, name)} {255 * sigma:.1f}" for name, sigma in model.items() if name != "grain"
    ]
    if model.get("grain", 1.0) >= 1.05:  # rounds to more than one sample
        details.append(f"shared over {model['grain']:.1f} samples")
    return ", ".join([words, *details])


def _measured(given: str | None, done: dict[str, Any]) -> Iterator[list[str]]:
    """Give the noise of a part, its mean change, and the estimated error by which its parameters were chosen."""
    how = "measured" if given is None else f"given as {given}"
    yield ["noise", noise_in_words(done["noise"], done["noise_model"]), how]
    if done["change"]:
        yield ["mean change", f"{255 * done['change']['mean']:.1f}/255", "measured"]
    choice = done["choice"]
    if choice and choice["psnr"] is not None:
        gain = f"{choice['psnr']:.1f} dB, {choice['gain']:+.1f} dB against the input"
        yield ["PSNR", gain, f"estimated, the best of {choice['candidates']}"]


def _given(requested: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Give the parameters of the job outside the kernel that are not the defaults."""
    defaults: dict[str, Any] = describe_settings(DEFAULTS)
    if requested["on"] != defaults["on"]:
        yield _WORDS["on"], requested["on"]
    for group in [name for name, value in requested.items() if isinstance(value, dict)]:
        for name, value in requested[group].items():
            if value != _plain(defaults[group].get(name)):
                yield name.replace("_", " "), _in_words(value)


def _plain(value: Any) -> Any:
    """Return a value as JSON gives it back."""
    return list(value) if isinstance(value, tuple) else value


def _in_words(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list):
        return ", ".join(map(_in_words, value)) or "none"
    return "none" if value is None else str(value)
