"""The optional packages for level sets."""

from __future__ import annotations

import importlib
from typing import Any

from beltrami_cli.errors import InputError, install_hint


def require_package(module: str, package: str, name: str, purpose: str) -> Any:
    """Import a module of a package; InputError that names the extra if it is not installed."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        cause = f"{purpose}, the package {package} is needed"
        raise InputError(name, cause, install_hint("beltrami-cli[volumes]")) from error
