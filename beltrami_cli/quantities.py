"""Quantities as text: lists of names, shares, amounts of full scale, and sizes of memory."""

from __future__ import annotations

import math
import re

BYTE_STEP = 1 / 255
"""The step of colours in files of 8 bits, where full scale is 1."""


def names_in(text: str) -> tuple[str, ...]:
    """Return the names of a list with commas; ValueError if there are none."""
    names = tuple(name.strip() for name in text.split(",") if name.strip())
    if not names:
        raise ValueError("names nothing; give names, with commas between them, or leave it out")
    return names


def number_in(text: str) -> tuple[float, bool]:
    """Read 0.08, 8% or 20/255; return the value and whether the number is plain; ValueError if it is none of these."""
    part, slash, whole = text.strip().partition("/")
    if slash:
        if not float(whole):
            raise ValueError(text)
        return float(part) / float(whole), False
    return (float(part[:-1]) / 100, False) if part.endswith("%") else (float(part), True)


def share_in(text: str) -> float:
    """Read a part of something, such as 0.001 or 0.1%; ValueError names the fault."""
    try:
        return number_in(text)[0]
    except ValueError:
        raise ValueError(f"is {text!r}, but must be a share such as 0.001 or 0.1%") from None


_AMOUNT = "an amount such as 20 (of 255), 20/255 or 8%"


def amount_in(text: str, forms: str = _AMOUNT) -> float:
    """Read a part of full scale: 20 is 20/255, and 20/255, 1310/65535 and 8% are what they say; or ValueError."""
    try:
        value, is_plain = number_in(text)
    except ValueError:
        raise ValueError(f"is {text!r}, but must be {forms}") from None
    if not (math.isfinite(value) and value >= 0):
        raise ValueError(f"is {text!r}, but must be a number from 0 on")
    return value / 255 if is_plain else value


def of_255(share: float) -> str:
    """Write a share of full scale as a number of 255; with two digits where it is of values that are far smaller."""
    value = 255 * share
    return f"{value:.1f}" if value >= 0.05 or value == 0 else f"{value:.2g}"


def show_amount(share: float) -> str:
    """Write a share of full scale as `amount_in` reads it: 20.0/255."""
    return f"{of_255(share)}/255"


def unambiguous_amount_in(text: str, forms: str = _AMOUNT) -> float:
    """Read a part of full scale; plain numbers between 0 and 1 are rejected, which may be of 255 or of full scale."""
    value = amount_in(text, forms)
    if value > 1:
        raise ValueError(f"is {text.strip()}, but must be at most 255 (of 255), or 100%")
    if 0 < value < 1 / 255 and not set(text) & set("/%"):
        number = text.strip()
        remedy = f"write {number}/255 or {100 * float(number):g}%"
        raise ValueError(f"is {number}, which is ambiguous: of 255 or of full scale; {remedy}")
    return value


_SIZE = re.compile(r"(\d+(?:\.\d+)?)\s*([KMGT]?)(?:i?B)?", re.IGNORECASE)
_UNITS = {"": 1, "K": 1 << 10, "M": 1 << 20, "G": 1 << 30, "T": 1 << 40}
_LARGEST_SIZE = 1 << 60  # bytes; accepted by the system as a limit


def size_in(text: str) -> int:
    """Read an amount of memory such as 500M or 1.5G, in powers of 1024; return bytes; ValueError names the fault."""
    match = _SIZE.fullmatch(text.strip())
    if match is None or len(match[1]) > 20:
        raise ValueError(f"is {text!r}, which is not a size such as 500M or 4G")
    size = min(int(float(match[1]) * _UNITS[match[2].upper()]), _LARGEST_SIZE)
    if size == 0:
        raise ValueError(f"is {text!r}, and nothing can be done in no memory")
    return size


def show_size(size: int) -> str:
    """Return a number of bytes in the unit that suits it."""
    for unit, scale in reversed(_UNITS.items()):
        if size >= scale > 1:
            return f"{size / scale:.3g}{unit}"
    return str(size)
