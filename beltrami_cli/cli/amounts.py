"""Amounts of colour on the command line: of 255, as a fraction, or in per cent."""

from __future__ import annotations

import math

import click


def amount(context: click.Context, parameter: click.Parameter, text: str | None) -> float | None:
    """Read a part of full scale: 20 is 20/255, and 20/255, 1310/65535 and 8% are what they say.

    Raises
    ------
    click.BadParameter
        If it is none, or negative.
    """
    if text is None:
        return None
    try:
        value = _parsed(text.strip())
    except (ValueError, ZeroDivisionError):
        raise click.BadParameter(f"{text!r} is no amount such as 20 (of 255), 20/255 or 8%") from None
    if not (math.isfinite(value) and value >= 0):
        raise click.BadParameter(f"{text!r} must be a number from 0 on")
    return value


def sure_amount(context: click.Context, parameter: click.Parameter, text: str | None) -> float | None:
    """Read it, but refuse plain numbers between 0 and 1, of which nobody can tell whether they are of 255 or of 1."""
    value = amount(context, parameter, text)
    if text is not None and value is not None and 0 < value < 1 / 255 and not set(text) & set("/%"):
        number = text.strip()
        raise click.BadParameter(
            f"{number} may be of 255 or of full scale; write {number}/255 or {100 * float(number):g}%"
        )
    return value


def _parsed(text: str) -> float:
    if text.endswith("%"):
        return float(text[:-1]) / 100
    if "/" in text:
        part, whole = text.split("/")
        return float(part) / float(whole)
    return float(text) / 255
