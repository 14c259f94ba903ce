"""NumPy's arrays, alone (.npy) and in archives (.npz): what they are by their headers, and none larger than allowed.

Nothing is unpickled, and nothing is allocated before the headers have been checked: an archive costs no more than its
refusal. The format: https://numpy.org/doc/stable/reference/generated/numpy.lib.format.html
"""

from __future__ import annotations

import io
import math
import tokenize
import warnings
import zipfile
import zlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from beltrami_cli.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

_MAGIC = b"PK\x03\x04"
NPY_MAGIC = b"\x93NUMPY"
_LONGEST_HEADER = 10_000  # as NumPy has it: a longer one could burden the parser of Python literals
_DEFLATE_RATIO = 1032  # a byte cannot stand for more: zlib's technical notes

# The first name that is there is taken. A level set has one of these, and a cloud of points has not.
LEVEL_SET_KEYS = ("values", "sdf", "tsdf", "level_set")
POSITION_KEYS = ("positions", "points", "xyz")


@dataclass(frozen=True)
class Header:
    """What an array is, before it is read.

    Attributes
    ----------
    shape : tuple of int
        None is negative.
    dtype : numpy.dtype
        Numbers or booleans.
    fortran : bool
        Whether the first index runs fastest.
    offset : int
        Where the numbers start in the member.
    """

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    fortran: bool
    offset: int

    @property
    def size(self) -> int:
        """Bytes of all numbers."""
        return math.prod(self.shape) * self.dtype.itemsize


class NpzArchive:
    """An opened archive.

    Parameters
    ----------
    data : bytes
        The whole file.
    name : str
        The file as the user named it.

    Attributes
    ----------
    names : tuple of str
        The arrays in it.

    Raises
    ------
    InputError
        If it is no archive of arrays.
    """

    def __init__(self, data: bytes, name: str) -> None:
        self._name = name
        try:
            self._archive = zipfile.ZipFile(io.BytesIO(data))
        except (zipfile.BadZipFile, ValueError, NotImplementedError) as error:
            raise InputError(name, f"the archive is damaged ({error})", "write it again") from error
        members = (member.filename for member in self._archive.infolist())
        self.names = tuple(member[:-4] for member in members if member.endswith(".npy"))

    @staticmethod
    def recognises(data: bytes) -> bool:
        """Tell whether a file is an archive that starts with an array."""
        if data[:4] != _MAGIC or len(data) < 30:
            return False
        # The name of the first member follows its local header: PKWARE's APPNOTE.TXT, section 4.3.7.
        return data[30 : 30 + int.from_bytes(data[26:28], "little")].endswith(b".npy")

    def kind(self) -> Literal["level set", "points"] | None:
        """Tell what the archive holds, by the names of its arrays."""
        if self.first(LEVEL_SET_KEYS):
            return "level set"
        return "points" if self.first(POSITION_KEYS) else None

    def first(self, names: Iterable[str]) -> str | None:
        """Return the first of some names that is there."""
        return next((name for name in names if name in self.names), None)

    def header(self, key: str) -> Header:
        """Return what an array is.

        Raises
        ------
        InputError
            If it is damaged, or holds anything but numbers or booleans.
        """
        member = self._archive.getinfo(f"{key}.npy")
        if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise self._error(key, "is compressed in a way that NumPy does not write")
        try:
            with self._archive.open(member) as file:
                start = file.read(_LONGEST_HEADER + 12)
            header = _parse(start)
        except (ValueError, zipfile.BadZipFile, zlib.error, RuntimeError, EOFError, OSError) as error:
            raise self._error(key, f"is damaged ({error})") from error
        if header.dtype.kind not in "buif" or header.dtype.itemsize > 8:
            raise self._error(key, f"is of type {header.dtype}, and not of real numbers")
        if member.file_size < header.offset + header.size:
            raise self._error(key, f"of shape {header.shape} has too few numbers")
        if member.file_size > _DEFLATE_RATIO * (member.compress_size + 1):
            raise self._error(key, "says that it is longer than its bytes can be")
        return header

    def read(self, key: str, most: int) -> NDArray[Any]:
        """Read an array.

        Parameters
        ----------
        key : str
            Its name, one of `names`.
        most : int
            Numbers that it may have.

        Returns
        -------
        ndarray
            In the byte order of the machine.

        Raises
        ------
        InputError
            As `header`; or if it is too large.
        """
        header = self.header(key)
        count = math.prod(header.shape)
        if count > most:
            cause = f"the array {key} of shape {header.shape} has {count} numbers, and {most} are allowed"
            raise InputError(self._name, cause, "raise --max-voxels or --max-memory")
        try:
            with self._archive.open(f"{key}.npy") as file:
                file.read(header.offset)
                data = file.read(header.size)
                file.read(1)  # reaching the end checks the archive's checksum
        except (zipfile.BadZipFile, zlib.error, RuntimeError, EOFError, OSError) as error:
            raise self._error(key, f"is damaged ({error})") from error
        if len(data) < header.size:
            raise self._error(key, "ends too early")
        flat = np.frombuffer(data, header.dtype)
        array = flat.reshape(header.shape, order="F" if header.fortran else "C")
        return array.astype(header.dtype.newbyteorder("="), copy=False)

    def _error(self, key: str, cause: str) -> InputError:
        return InputError(self._name, f"the array {key} {cause}", "write it with numpy.savez_compressed")


def read_npy(data: bytes, name: str) -> NDArray[Any]:
    """Read the file of a single array.

    Parameters
    ----------
    data : bytes
        The whole file.
    name : str
        The file as the user named it.

    Returns
    -------
    ndarray
        Of numbers or booleans, in the byte order of the machine.

    Raises
    ------
    InputError
        If it is damaged, or holds anything else.
    """
    try:
        header = _parse(data[: _LONGEST_HEADER + 12])
    except (ValueError, EOFError, OSError) as error:
        raise InputError(name, f"the array is damaged ({error})", "write it with numpy.save") from error
    if header.dtype.kind not in "buif" or header.dtype.itemsize > 8:
        raise InputError(name, f"the array is of type {header.dtype}, and not of real numbers")
    if len(data) - header.offset < header.size:
        raise InputError(
            name, f"the array of shape {header.shape} has too few numbers", "the file is cut off"
        )
    flat = np.frombuffer(data, header.dtype, math.prod(header.shape), header.offset)
    array = flat.reshape(header.shape, order="F" if header.fortran else "C")
    return array.astype(header.dtype.newbyteorder("="), copy=False)


def _parse(start: bytes) -> Header:
    """Parse the header of an array from its first bytes."""
    file = io.BytesIO(start)
    version = np.lib.format.read_magic(file)
    if version not in ((1, 0), (2, 0)):
        raise ValueError(f"version {version} of the format is for records only")
    # The length stands in the header itself; what was read is bounded, so a false one is found, not followed.
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    with warnings.catch_warnings(action="ignore"):  # of headers as Python 2 wrote them, which are understood
        try:
            shape, fortran, dtype = read(file, max_header_size=_LONGEST_HEADER)
        except (SyntaxError, tokenize.TokenError, TypeError, RecursionError, MemoryError) as error:
            raise ValueError("its header is no description of an array") from error
    if any(side < 0 for side in shape):
        raise ValueError(f"the shape is {shape}")
    return Header(shape, dtype, fortran, file.tell())
