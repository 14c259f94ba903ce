"""Amounts of colour as options."""

from __future__ import annotations

import click

from beltrami_cli.jobs import settings as amounts


def amount(context: click.Context, parameter: click.Parameter, text: str | None) -> float | None:
    """Read a part of full scale."""
    try:
        return None if text is None else amounts.amount(text)
    except ValueError as error:
        raise click.BadParameter(str(error)) from None


def sure_amount(context: click.Context, parameter: click.Parameter, text: str | None) -> float | None:
    """Read it, but refuse what may be of 255 or of 1."""
    try:
        return None if text is None else amounts.sure_amount(text)
    except ValueError as error:
        raise click.BadParameter(str(error)) from None
