"""Access to files by name: local paths, or URLs that fsspec opens."""

from __future__ import annotations

import hashlib
import os
import re
from glob import has_magic
from pathlib import Path, PurePath, PurePosixPath
from typing import Any
from urllib.parse import unquote

from beltrami_cli.errors import InputError, OutputError, install_hint
from beltrami_cli.formats.files.paths import is_file, is_there, is_url, open_regular

_LOCAL_URL = re.compile(r"(?:file|local)://", re.IGNORECASE)


def without_scheme(name: str) -> str:
    """Return the path of a file:// URL, and any other name unchanged."""
    found = _LOCAL_URL.match(name)
    return name if found is None else unquote(name[found.end() :])


def require_name(name: object) -> str:
    """Return a valid file name; ValueError if it is not text, or cannot name a file."""
    if not isinstance(name, str) or "\0" in name:
        raise ValueError("it cannot be the name of a file")
    os.fsencode(name)  # a UnicodeError is a ValueError
    return name


def canonical_name(name: str) -> str:
    """Return the canonical name of a file: its resolved path, or its URL."""
    return name if is_url(name) else os.path.realpath(name)


def _fixed_part(pattern: PurePath) -> PurePath:
    """Return the innermost folder that contains all files of a glob."""
    fixed = next(number for number, part in enumerate(pattern.parts) if has_magic(part))
    return type(pattern)(*pattern.parts[:fixed])


def joined(folder: str, place: PurePath) -> str:
    """Return the name of a file in a folder; both may be URLs."""
    if is_url(folder):
        return f"{folder.rstrip('/')}/{PurePosixPath(place)}"
    return str(Path(folder) / place)


def filesystem(url: str) -> tuple[Any, str]:
    """Return the fsspec file system of a URL, and the path in it; InputError if the protocol is unknown."""
    try:
        from fsspec.core import url_to_fs
    except ImportError as error:
        cause = "URLs need fsspec, which is not installed"
        raise InputError(url, cause, install_hint("beltrami-cli[cluster]")) from error
    try:
        files, path = url_to_fs(url)
    except (ImportError, ValueError) as error:
        remedy = "install the package that it needs, or check the URL"
        raise InputError(url, f"cannot be opened ({error})", remedy) from error
    return files, path


def exists(name: str) -> bool:
    if not is_url(name):
        return is_there(name)
    files, path = filesystem(name)
    return bool(files.exists(path))


def make_folder_of(name: str) -> None:
    """Make the folder of a new file; OutputError if that fails."""
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
    if is_url(name):
        files, path = filesystem(name)
        opened = files.open(path, "rb")
    else:
        opened = open_regular(Path(name))
    with opened as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def is_glob(name: str) -> bool:
    """Whether a name is a glob; existing files may have names that look like globs."""
    return has_magic(name) and (is_url(name) or not is_there(name))


def find(name: str) -> tuple[str, list[tuple[str, PurePath]]]:
    """Return the base folder of a folder or a glob (empty for a file), and the files with their relative paths."""
    if is_url(name):
        return _find_at(name)
    path = Path(name)
    if is_file(path):
        return "", [(str(path), PurePath(path.name))]
    if not is_glob(name) and not is_there(path):
        raise InputError(name, "there is no such file", "check the path")
    root = Path(_fixed_part(path)) if is_glob(name) else path
    paths = root.glob(str(path.relative_to(root))) if is_glob(name) else root.rglob("*")
    return str(root), [(str(each), each.relative_to(root)) for each in sorted(paths) if is_file(each)]


def _find_at(url: str) -> tuple[str, list[tuple[str, PurePath]]]:
    files, path = filesystem(url)
    try:
        if files.isfile(path):
            return "", [(url, PurePosixPath(path.rpartition("/")[2]))]
        root = str(_fixed_part(PurePosixPath(path))) if has_magic(path) else path
        names = files.glob(path) if has_magic(path) else files.find(path)
        found = [name for name in sorted(names) if files.isfile(name)]
    except OSError as error:
        raise InputError(url, f"cannot be listed ({error})", "check the URL and your rights") from error
    places = ((name, PurePosixPath(name).relative_to(root or "")) for name in found)
    return files.unstrip_protocol(root), [(files.unstrip_protocol(name), place) for name, place in places]
