"""Tables of the parameters that were used for smoothing, from its report."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from beltrami_cli.quantities import show_amount
from beltrami_cli.view.noise_in_words import noise_in_words, psnr_in_words

# Kernel parameters that are shown even if they have their defaults.
_ALWAYS_SHOWN = ("iterations", "t", "beta", "beta_growth", "metric_steps", "space")
_NEVER_SHOWN = ("free", "given", "fast", "on", "threads", "noise")
_WORDS = {"t": "time step, t", "on": "smoothed, --on"}


def used_parameters(report: dict[str, Any]) -> dict[str, list[Any]]:
    """Return rows about the parts of a report of `smooth`, and its job; KeyError and the like for other files."""
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
    choice = done["choice"] or {"chosen": {}, "candidates": 0}
    used = {**requested, **choice["chosen"], "beta": done["beta"], "iterations": done["iterations"]}
    names = [
        each for each, value in requested.items() if not isinstance(value, dict) and each not in _NEVER_SHOWN
    ]
    for name in names if done["iterations"] else ["iterations"]:
        if name in choice["chosen"]:
            how = "chosen from the data" if choice["candidates"] else "by the fixed rule"
        elif name == "beta" and requested[name] is None:
            how = "from the noise"
        elif name == "iterations" and name in requested["free"] and not done["iterations"]:
            how = "as no noise is removed"
        else:
            how = "given" if name in requested["given"] else "default"
        if how != "default" or name in _ALWAYS_SHOWN:
            yield [_WORDS.get(name, name.replace("_", " ")), _in_words(used[name]), how]


def _measured(given: str | None, done: dict[str, Any]) -> Iterator[list[str]]:
    """Yield the noise of a part, its mean change, and the estimated error of the chosen parameters."""
    how = "measured" if given is None else f"given as {given}"
    yield ["noise", noise_in_words(done, is_smoothed=done["iterations"] > 0), how]
    if wrong := done.get("wrong_samples"):
        what = "replaced" if wrong["replaced"] else "kept"
        yield ["wrong samples", f"{wrong['count']} ({100 * wrong['share']:.2g} %) {what}", "measured"]
    if done["change"]:
        yield ["mean change", show_amount(done["change"]["mean"]), "measured"]
    choice = done["choice"]
    if choice and choice["psnr"] is not None:
        yield ["result", psnr_in_words(choice), f"the best of {choice['candidates']}"]


def _given(requested: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield the given parameters of the job, except kernel parameters."""
    if "on" in requested["given"]:
        yield _WORDS["on"], requested["on"]
    for group in [name for name, value in requested.items() if isinstance(value, dict)]:
        for name, value in requested[group].items():
            if name in requested["given"]:
                yield name.replace("_", " "), _in_words(value)


def _in_words(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list):
        return ", ".join(map(_in_words, value)) or "none"
    return "none" if value is None else str(value)
