"""Packages that only volumes need, which an extra installs."""

from __future__ import annotations

import importlib
from typing import Any

from beltrami_cli.errors import InputError


def require(module: str, package: str, name: str, purpose: str) -> Any:
    """Import a module of the extra.

    Parameters
    ----------
    module : str
        Its name.
    package : str
        The package that it is in.
    name : str
        The file that needs it, as the user named it.
    purpose : str
        What for, as an infinitive.

    Returns
    -------
    module

    Raises
    ------
    InputError
        If it is not installed; the message names the extra.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise InputError(
            name,
            f"{purpose}, the package {package} is needed",
            "install it with: pip install 'beltrami-cli[volumes]'",
        ) from error
