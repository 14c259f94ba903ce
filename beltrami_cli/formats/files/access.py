"""Limits of what a job may read, and functions that read within them."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

from beltrami_cli.errors import InputError, MemoryLimitError
from beltrami_cli.fields import Checked, Parameter, parameter
from beltrami_cli.formats.files.paths import NotRegularError, is_url, open_regular
from beltrami_cli.quantities import names_in, show_size, size_in

_BLOCK = 1 << 24  # bytes of standard input read at a time: a larger request is allocated at once


@dataclass(frozen=True)
class Hooks:
    """What a job does as files are read."""

    # Called with the path and content of every file that was read, so that a job can record its inputs.
    on_read: Callable[[Path, bytes], None] | None = None
    # Called with the path of every sidecar file before it is opened, so that it can be fetched from elsewhere.
    fetch: Callable[[Path], None] | None = None
    # Replacements of files, by resolved path: new files that are not in place yet.
    replacements: Mapping[Path, Path] = field(default_factory=dict)

    def found_at(self, path: Path) -> Path:
        """Return the path that a file is read from: its own, or its replacement."""
        if not self.replacements:
            return path
        return self.replacements.get(Path(os.path.realpath(path.parent), path.name), path)


@dataclass(frozen=True)
class Access(Checked):
    """What a job may read, and how where a file leaves that open.

    Attributes
    ----------
    outside : bool
        Whether a model may refer to files outside of its folder. Networks are never used.
    memory : int or None
        Bytes that the job may use; None: no limit. Larger files and images are refused before they are read.
    columns : tuple of str
        Names of all columns of points in text files, where neither the file nor its values determine them.
    channels : tuple of str
        Channels of PLY vertices to smooth, which may include one scalar.
    typed : tuple of Parameter
        Parameters given on the command line, where there is a single input; each must apply to it.
    hooks : Hooks
        Callables for files as they are read, and replacements of files.
    """

    group: ClassVar[str] = "Files and memory"

    outside: bool = parameter(
        False,
        "Also read files that INPUT names beyond its own folder (absolute paths, '..', links). What OUTPUT needs of "
        "them again goes into its own folder; nothing is written out there.",
        flags=("--allow-outside",), lifts_limit=True,
    )  # fmt: skip
    memory: int | None = parameter(
        None,
        "Take no more memory: smooth keeps textures and images that need more in files meanwhile, and all else that "
        "does is refused.",
        kind=int, low=1, allowed="a size such as 500M or 4G", unset="half of the available memory",
        flags=("--max-memory",), metavar="SIZE", parse=size_in, show=show_size, lifts_limit=True,
    )  # fmt: skip
    channels: tuple[str, ...] = ()
    typed: tuple[Parameter, ...] = field(default=(), compare=False)
    columns: tuple[str, ...] = parameter(
        (),
        "For points in text files: the names of all columns, in their order, such as x,y,z,r,g,b,scalar. "
        "Columns with other names stay unchanged.",
        unset="those in the file, or by the values", metavar="LIST", parse=names_in, show=",".join,
        of=("points in text files",),
    )  # fmt: skip
    hooks: Hooks = field(default=Hooks(), compare=False)


DEFAULT_ACCESS = Access()  # the default: files in the model's folder, of any size


def read_regular(path: Path, access: Access, most: int = -1) -> bytes:
    """Return the content of a regular file, or its first `most` bytes; OSError if it cannot be read."""
    with open_regular(access.hooks.found_at(path)) as file:
        size = os.fstat(file.fileno()).st_size
        if most < 0 and access.memory is not None and size > access.memory:
            raise OSError(errno.EFBIG, f"its {size} bytes are more than the memory it may take")
        data = file.read(most)
    if access.hooks.on_read is not None and not 0 <= most <= len(data):  # otherwise there may be more of it
        access.hooks.on_read(path, data)
    return data


def read_source(source: str, access: Access = DEFAULT_ACCESS) -> bytes:
    """Return the bytes of a file, or of standard input for "-"; InputError if it cannot be read."""
    if source == "-":
        return _read_stdin(access)
    try:
        return read_regular(Path(source), access)
    except IsADirectoryError as error:
        remedy = f"name a file in it; beltrami batch {source} --out-dir OUT smooths all of them"
        raise InputError(source, "it is a folder", remedy) from error
    except NotRegularError as error:
        remedy = "give a file, or pipe the model in and name it -"
        raise InputError(source, "it is not a regular file", remedy) from error
    except OSError as error:
        if error.errno == errno.EFBIG:
            cause = f"cannot be read ({error.strerror})"
            raise MemoryLimitError(source, cause, "raise --max-memory") from error
        raise unreadable(source, error) from error


def unreadable(name: str, error: Exception, remedy: str = "check the path and its permissions") -> InputError:
    """Return the error for a file that cannot be read; `remedy` applies if it exists and is not a URL."""
    if is_url(name):
        return InputError(
            name, "it is a URL, which batch alone reads", "download it, or give it to beltrami batch"
        )
    if isinstance(error, FileNotFoundError):
        return InputError(name, "there is no such file", "check its name")
    return InputError(name, f"cannot be read ({getattr(error, 'strerror', None) or error})", remedy)


def _read_stdin(access: Access) -> bytes:
    blocks, size = [], 0
    try:
        while block := sys.stdin.buffer.read(_BLOCK):
            blocks.append(block)
            size += len(block)
            if access.memory is not None and size > access.memory:
                cause = f"it has more than {access.memory} bytes"
                raise MemoryLimitError("<stdin>", cause, "raise --max-memory")
    except OSError as error:
        cause = f"cannot be read ({error.strerror or error})"
        raise InputError("<stdin>", cause, "pipe the model in, or give a file") from error
    return b"".join(blocks)
