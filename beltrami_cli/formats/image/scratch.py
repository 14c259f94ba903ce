"""Files that exist only for a library which reads and writes nothing else."""

from __future__ import annotations

import os
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from beltrami_cli.errors import ProcessingError

if TYPE_CHECKING:
    from collections.abc import Iterator

_OPEN_FILES = Path("/proc/self/fd")


@contextmanager
def scratch_file(data: bytes = b"", suffix: str = "") -> Iterator[Path]:
    """Give a file a name for a while: in memory on Linux, in the folder for temporary files elsewhere.

    Parameters
    ----------
    data : bytes
        What it holds at first.
    suffix : str
        Extension with the dot, which no file in memory has.

    Yields
    ------
    pathlib.Path
        Its name.

    Raises
    ------
    ProcessingError
        If there is no room for it.
    """
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
