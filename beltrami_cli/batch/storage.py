"""Files of a batch by name: on this machine, or at URLs that fsspec knows."""

from __future__ import annotations

import hashlib
import os
import re
from pathlib import Path, PurePath, PurePosixPath
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote

from beltrami_cli.errors import InputError, OutputError

if TYPE_CHECKING:
    from collections.abc import Iterator

_URL = re.compile(r"[a-z][a-z0-9+.-]+://", re.IGNORECASE)
_HERE = re.compile(r"(?:file|local)://", re.IGNORECASE)
_MAGIC = set("*?[")
_CHUNK = 1 << 20


def is_url(name: str) -> bool:
    """Tell whether a name is a URL of another place than this machine's own files."""
    return bool(_URL.match(name)) and not _HERE.match(name)


def without_scheme(name: str) -> str:
    """Return the path that a file:// URL means, and any other name as it is."""
    found = _HERE.match(name)
    return name if found is None else unquote(name[found.end() :])


def place_of(name: str) -> str:
    """Return what two names of one file have in common: its resolved path, or its URL."""
    return name if is_url(name) else os.path.realpath(name)


def joined(folder: str, place: PurePath) -> str:
    """Return the name of a file in a folder, either of which may be a URL."""
    if is_url(folder):
        return f"{folder.rstrip('/')}/{PurePosixPath(place)}"
    return str(Path(folder) / place)


def filesystem(url: str) -> tuple[Any, str]:
    """Return what fsspec opens a URL with, and the path in it.

    Raises
    ------
    InputError
        If fsspec, or its plug-in for such URLs, is not installed, or it does not know them.
    """
    try:
        from fsspec.core import url_to_fs
    except ImportError as error:
        cause = "URLs need fsspec, which is not installed"
        raise InputError(url, cause, "pip install 'beltrami-cli[cluster]'") from error
    try:
        filesystem, path = url_to_fs(url)
    except (ImportError, ValueError) as error:
        raise InputError(url, f"cannot be opened ({error})", "install the plug-in of fsspec") from error
    return filesystem, path


def exists(name: str) -> bool:
    """Tell whether there is a file, or a folder, of that name."""
    if not is_url(name):
        return Path(name).exists()
    files, path = filesystem(name)
    return bool(files.exists(path))


def make_folder_of(name: str) -> None:
    """Make the folder that a file is to be written into.

    Raises
    ------
    OutputError
        If that fails.
    """
    try:
        if is_url(name):
            files, path = filesystem(name)
            files.makedirs(path.rpartition("/")[0], exist_ok=True)
        else:
            Path(name).parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        cause = f"its folder cannot be made ({error.strerror or error})"
        raise OutputError(name, cause, "choose another --out-dir") from error


def hash_at(name: str) -> str:
    """Return the SHA-256 of a file in hexadecimal digits; OSError if it cannot be read."""
    if not is_url(name):
        with Path(name).open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    files, path = filesystem(name)
    digest = hashlib.sha256()
    with files.open(path, "rb") as file:
        while data := file.read(_CHUNK):
            digest.update(data)
    return digest.hexdigest()


def find_at(url: str) -> Iterator[tuple[str, PurePosixPath]]:
    """Give the URLs of the files that a URL stands for, and their places below its folder or fixed part.

    Parameters
    ----------
    url : str
        Of a file, of a folder, or a glob.

    Raises
    ------
    InputError
        If it cannot be listed.
    """
    files, path = filesystem(url)
    try:
        if _MAGIC & set(path):
            names, root = files.glob(path), _fixed_part(path)
        elif files.isfile(path):
            names, root = [path], path.rpartition("/")[0]
        else:
            names, root = files.find(path), path
        found = [name for name in sorted(names) if files.isfile(name)]
    except OSError as error:
        raise InputError(url, f"cannot be listed ({error})", "check the URL and your rights") from error
    for name in found:
        yield files.unstrip_protocol(name), PurePosixPath(name).relative_to(root or "")


def _fixed_part(pattern: str) -> str:
    parts = pattern.split("/")
    return "/".join(parts[: next(number for number, part in enumerate(parts) if _MAGIC & set(part))])
