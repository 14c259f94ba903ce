"""Files for OpenImageIO, which reads and writes only what has a name, and its reader with errors cleared behind it."""

from __future__ import annotations

import os
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beltrami_cli.errors import ProcessingError

if TYPE_CHECKING:
    from collections.abc import Iterator

TYPES = {"uint8": "uint8", "uint16": "uint16", "float16": "half", "float32": "float"}
"""OpenImageIO's names of NumPy's types."""

_OPEN_FILES = Path("/proc/self/fd")


@contextmanager
def opened(data: bytes, config: Any = None) -> Iterator[tuple[Any, Path]]:
    """Open an image file; give an OpenImageIO.ImageInput, or None if that fails, and its path, which errors name."""
    import OpenImageIO

    with scratch_file(data) as path:
        arguments = (str(path),) if config is None else (str(path), config)
        file = OpenImageIO.ImageInput.open(*arguments)
        if file is None:
            yield None, path
            return
        try:
            yield file, path
        finally:
            file.close()
            file.geterror()
            OpenImageIO.geterror()


@contextmanager
def scratch_file(data: bytes = b"", suffix: str = "") -> Iterator[Path]:
    """Give a file a name for a while: in memory on Linux if it needs no suffix, else among temporary files."""
    if not suffix and hasattr(os, "memfd_create") and _OPEN_FILES.is_dir():
        descriptor = os.memfd_create("image")
        try:
            path = _OPEN_FILES / str(descriptor)
            _fill(path, data)
            yield path
        finally:
            os.close(descriptor)
    else:
        import tempfile

        with tempfile.TemporaryDirectory(prefix="beltrami-") as folder:
            path = Path(folder) / f"image{suffix}"
            _fill(path, data)
            yield path


def _fill(path: Path, data: bytes) -> None:
    try:
        path.write_bytes(data)
    except OSError as error:
        raise ProcessingError(
            f"there is no room for a copy of an image of {len(data)} bytes ({error.strerror})"
        ) from error
