"""Temporary files and folders, and the error of a full disk."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from beltrami_cli.errors import OutputError


@contextmanager
def writing_temporary_files() -> Iterator[None]:
    """Convert errors of writing files, such as on a full disk, to OutputError."""
    try:
        yield
    except OSError as error:
        raise unwritable(error.strerror or str(error)) from error


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """Make a temporary folder for this context; OutputError if it cannot be made."""
    from tempfile import TemporaryDirectory

    with ExitStack() as stack:
        with writing_temporary_files():
            # The work is complete when the folder is removed, so a failed removal is ignored.
            temporary = TemporaryDirectory(prefix="beltrami-", ignore_cleanup_errors=True)
            folder = stack.enter_context(temporary)
        yield Path(folder)


def unwritable(cause: str) -> OutputError:
    remedy = "free space, or name another folder in the variable TMPDIR"
    return OutputError("temporary files", f"cannot be written ({cause})", remedy)
