"""An archive with one array exchanged, all others as they are."""

from __future__ import annotations

import contextlib
import io
import zipfile
import zlib
from typing import TYPE_CHECKING, Any

from beltrami_cli.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from beltrami_cli.formats.npz import Header


def repacked(data: bytes, key: str, header: Header, array: NDArray[Any], name: str) -> bytes:
    """Exchange the numbers of one array.

    Parameters
    ----------
    data : bytes
        The archive.
    key : str
        The array's name.
    header : Header
        What it is.
    array : ndarray
        New numbers, of its shape.
    name : str
        The file's name for messages.

    Returns
    -------
    bytes
        An archive of the same members in the same order, each with its name, date, attributes and way of compression.

    Raises
    ------
    InputError
        If another member cannot be unpacked.
    """
    buffer = io.BytesIO()
    with _damage_told(name), zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(buffer, "w") as new:
        new.comment = old.comment
        for member in old.infolist():
            content = old.read(member)
            is_meant = member.filename == f"{key}.npy"
            new.writestr(_alike(member), exchanged(content, header, array) if is_meant else content)
    return buffer.getvalue()


def exchanged(content: bytes, header: Header, array: NDArray[Any]) -> bytes:
    """Return a member with other numbers, what stands before and behind them staying as it is."""
    numbers = array.astype(header.dtype).tobytes("F" if header.fortran else "C")
    return content[: header.offset] + numbers + content[header.offset + len(numbers) :]


def members(data: bytes, name: str) -> dict[str, bytes]:
    """Return the contents of all members by their names; InputError if one cannot be unpacked."""
    with _damage_told(name), zipfile.ZipFile(io.BytesIO(data)) as archive:
        return {member.filename: archive.read(member) for member in archive.infolist()}


@contextlib.contextmanager
def _damage_told(name: str) -> Iterator[None]:
    try:
        yield
    except (zipfile.BadZipFile, zlib.error, RuntimeError, NotImplementedError, EOFError, OSError) as error:
        raise InputError(name, f"the archive is damaged ({error})", "write it again") from error


def _alike(member: zipfile.ZipInfo) -> zipfile.ZipInfo:
    """Return a description for writing, without where and how long the old member is."""
    new = zipfile.ZipInfo(member.filename, member.date_time)
    new.compress_type, new.comment = member.compress_type, member.comment
    new.external_attr, new.create_system = member.external_attr, member.create_system
    return new
