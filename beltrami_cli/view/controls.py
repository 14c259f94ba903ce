"""The controls of the live view, made from the declarations of parameters, and the settings that they stand for."""

from __future__ import annotations

import dataclasses
import html
from typing import TYPE_CHECKING, Any

from beltrami_cli.errors import UsageError
from beltrami_cli.fields import Parameter, override, parameters
from beltrami_cli.flow.parameters import TUNABLE
from beltrami_cli.samples.settings import DEFAULTS, SmoothSettings

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from beltrami_cli.surface.records import Slot

_DECLARED = {each.name: each for each in parameters(SmoothSettings, deep=True)}
_CHOICES = ("strength", "patches")
_TEXTS = ("noise",)
_SLIDERS = {"iterations": (1, 20, 1), "t": (0.5, 10, 0.1), "beta": (0, 40, 0.5), "window": (3, 31, 2)}
_NAMES = (*_CHOICES, *_TEXTS, *_SLIDERS)


def plain_settings(settings: SmoothSettings) -> SmoothSettings:
    """Return settings with what the controls set as it is where nothing is given."""
    kernel = settings.kernel
    reset = {name: _DECLARED[name].default for name in _NAMES}
    given = [name for name in TUNABLE if name in _SLIDERS and getattr(kernel, name) is not None]
    free = tuple(name for name in TUNABLE if name in kernel.free or name in given)
    textures = dataclasses.replace(settings.textures, slots=DEFAULTS.textures.slots)
    kernel = dataclasses.replace(kernel, **reset, free=free)
    return dataclasses.replace(settings, kernel=kernel, textures=textures)


def given_values(settings: SmoothSettings) -> dict[str, Any]:
    """Return what the controls show at first: what is given."""
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
            made[name] = tuple(value) if isinstance(value, list) else _value(_DECLARED[name], value)
    return override(plain, **made)


def _value(declared: Parameter, value: Any) -> Any:
    if declared.kind is int and isinstance(value, float) and value.is_integer():
        return int(value)
    return float(value) if declared.kind is float and isinstance(value, int) else value


def controls(layers: Sequence[Slot | None]) -> str:
    """Return the controls as parts of a page."""
    rows = [_choice(_DECLARED[name]) for name in _CHOICES]
    rows += [_text(_DECLARED[name]) for name in _TEXTS]
    rows += [_slider(_DECLARED[name], *bounds) for name, bounds in _SLIDERS.items()]
    slots = [slot for slot in layers if slot is not None]
    if len(slots) > 1:
        box = '<label><input type="checkbox" name="slots" value="{0}">{0}</label>'
        boxes = "".join(map(box.format, slots))
        rows.append(f"<fieldset><legend>textures</legend>{boxes}</fieldset>")
    return "\n".join(rows)


def _choice(declared: Parameter) -> str:
    chosen = {declared.default: " selected"}
    options = "".join(f"<option{chosen.get(each, '')}>{each}</option>" for each in declared.choices)
    return (
        f'<div class="control"><label for="{declared.name}">{declared.name}</label>'
        f'<select id="{declared.name}" name="{declared.name}" aria-describedby="about-{declared.name}">'
        f"{options}</select>{_about(declared)}</div>"
    )


def _text(declared: Parameter) -> str:
    return (
        f'<div class="control"><label for="{declared.name}">{declared.name}</label>'
        f'<input type="text" id="{declared.name}" name="{declared.name}" placeholder="{declared.unset}" '
        f'aria-describedby="about-{declared.name}" autocomplete="off" spellcheck="false">{_about(declared)}</div>'
    )


def _slider(declared: Parameter, low: float, high: float, step: float) -> str:
    name, label = declared.name, {"t": "time step"}.get(declared.name, declared.name)
    auto = (
        f'<label class="auto"><input type="checkbox" data-auto="{name}" checked>'
        f'<span>chosen</span><span class="hidden">: {label}</span></label>'
    )
    auto = auto if name in TUNABLE else ""
    value = declared.default if declared.default is not None else (low + high) / 4
    return (
        f'<div class="control"><label for="{name}">{label}</label><output id="{name}-value"></output>{auto}'
        f'<input type="range" id="{name}" name="{name}" min="{low}" max="{high}" step="{step}" value="{value}" '
        f'aria-describedby="about-{name}">{_about(declared)}</div>'
    )


def _about(declared: Parameter) -> str:
    first = declared.help.partition(". ")[0].removesuffix(".")
    return f'<p class="about" id="about-{declared.name}">{html.escape(first)}.</p>'
