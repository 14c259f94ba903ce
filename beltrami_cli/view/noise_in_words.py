"""Noise, and the parameters chosen for it, in words that are shared by messages, `info`, reports and the live view."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from beltrami_cli.flow.noise_amount import NEGLIGIBLE, VISIBLE
from beltrami_cli.layers.reported_noise import noise_size, root_mean_square
from beltrami_cli.quantities import BYTE_STEP, of_255, show_amount

NO_NOISE_FOUND = "no noise detected"

# Ratio of the ends of an interval of the noise from which on it is shown. Where it is less, the median is off by a
# factor of 1.22 at most, which costs about half a decibel: see `_REMOVED_PER_MEDIAN` in flow/noise/model.py.
_WIDE_RATIO = 1.5


def noise_of(part: Mapping[str, Any]) -> str:
    """Return the noise of a part of a report, or of `info`, as a quantity, with its interval where that is wide."""
    reading = part["reading"]
    if reading is None or reading["high"] <= _WIDE_RATIO * reading["low"]:
        return show_amount(noise_size(part))
    low, median, high = (_rounded(reading[key]) for key in ("low", "median", "high"))
    return f"about {median}/255 ({low} to {high})"


def noise_in_words(part: Mapping[str, Any], *, is_smoothed: bool) -> str:
    """Say of a part of a report, or of `info`, how noisy it is, how sure that is, and which channels and levels are."""
    if doubt := doubt_in_words(part, is_smoothed=is_smoothed):
        return doubt
    if not any(part["noise"].values()):
        return "none" if part["reading"] is None else NO_NOISE_FOUND
    return ", ".join([noise_of(part), *_details(part)])


def doubt_in_words(part: Mapping[str, Any], *, is_smoothed: bool, moved: str = "") -> str:
    """Say that grain may be noise or texture, whether it is removed, and how to do otherwise; empty if it is clear.

    `moved` says by how much colours changed.
    """
    reading = part["reading"]
    if reading is None or reading["none"] <= NEGLIGIBLE:
        return ""
    is_removed = is_smoothed and any(part["noise"].values())
    if is_clean(reading) and not is_removed:
        return ""
    grain = f"grain of about {_rounded(reading['median'])}/255 may be noise or texture"
    if is_removed:
        return f"{grain}: removed{moved}; --noise 0 keeps it"
    if is_smoothed:
        return f"{grain}: smoothed as the options say{moved}"
    return f"{grain}: left as it is; --noise {noise_to_give(reading)} removes it"


def reason_in_words(part: Mapping[str, Any]) -> str:
    strongest = max(part["noise"].values(), default=0.0)
    if not strongest:
        return "no noise" if part["reading"] is None else NO_NOISE_FOUND
    is_less_than_rounding = strongest <= BYTE_STEP / 2 and not _choice_of(part)
    why = "no more than rounding makes" if is_less_than_rounding else "which smoothing would not reduce"
    return f"noise {noise_of(part)}, {why}"


def advice_in_words(part: Mapping[str, Any]) -> str:
    """Advise how to smooth a part that was left, unless it has less noise than rounding makes."""
    reading, choice = part["reading"], _choice_of(part)
    was_worse = bool(choice and choice["chosen"].get("iterations"))
    if reading is None or (any(part["noise"].values()) and not was_worse):
        return ""
    if reading["median"] <= BYTE_STEP / 2:
        return ""
    at_least = {"median": max(reading["median"], VISIBLE)}  # less would change hardly any colour of 8 bits
    return f"; to smooth all the same, give --noise {noise_to_give(at_least)}"


def _choice_of(part: Mapping[str, Any]) -> Any:
    """Return what was chosen, of a part of a report, or of `info`; None: nothing."""
    return part["choice"] if "choice" in part else part["smooth"].get("choice")


def is_clean(reading: Mapping[str, float]) -> bool:
    """Whether fewer than one in ten such pictures have noise that people see."""
    return reading["visible"] < NEGLIGIBLE


def noise_to_give(reading: Mapping[str, float]) -> str:
    """Return what `--noise` is to be if there is noise; plain numbers below 1 would be ambiguous."""
    number = _rounded(reading["median"])
    return number if float(number) >= 1 else f"{number}/255"


def _rounded(share: float) -> str:
    return f"{255 * share:.0f}" if 255 * share >= 9.95 else of_255(share).removesuffix(".0")


def _details(part: Mapping[str, Any]) -> Iterator[str]:
    noise, model = part["noise"], part["noise_model"]
    # If strong, more is removed than the median.
    share = noise_size(part) / root_mean_square(noise) if any(noise.values()) else 1.0
    if len(noise) > 1:
        yield ", ".join(f"{name} {of_255(share * sigma)}" for name, sigma in noise.items())
    names = {"quiet": "quiet places", "loud": "loud places"}
    for name, sigma in model.items():
        if name != "grain":
            yield f"{names.get(name, name)} {of_255(share * sigma)}"
    if model.get("grain", 1.0) >= 1.05:  # rounds to more than one sample
        yield f"shared over {model['grain']:.1f} samples"


def reading_in_words(reading: Mapping[str, float]) -> str:
    low, median, high = (_rounded(reading[key]) for key in ("low", "median", "high"))
    return (
        f"{median}/255 ({low} to {high}) with a probability of {100 * (1 - reading['none']):.0f} %, else none"
    )


def choice_in_words(choice: Mapping[str, Any]) -> str:
    """Describe the chosen parameters, how they were chosen, and the expected PSNR."""
    chosen = ", ".join(f"{name.replace('_', ' ')} {value:.3g}" for name, value in choice["chosen"].items())
    if not choice["candidates"]:
        return f"{chosen}; by the fixed rule of --fast"
    return f"{chosen}; {psnr_in_words(choice)}"


def psnr_in_words(choice: Mapping[str, Any]) -> str:
    """Return the PSNR that is predicted, or why there is none."""
    if choice["psnr"] is None and choice["samples"] == 1:
        return "PSNR is undefined for a single sample"
    if choice["psnr"] is None:
        return (
            "no PSNR can be predicted, as most colours are plain, as where JPEG took the noise, or at a limit"
        )
    if (predicted := choice["predicted"]) is None:
        cause = "neighbours share noise" if choice["correlated"] else "the noise is not known well enough"
        return f"no PSNR can be predicted, as {cause}"
    before, psnr, least, most = (f"{predicted[key]:.1f}" for key in ("before", "psnr", "least", "most"))
    return f"predicted PSNR {before} -> {psnr} dB (90 %: {least} to {most})"
