"""Arrays as long as a surface has samples: in memory, or in a file where a job must do with less of it.

In a file they look the same to whoever uses them. The system reads and writes the pages of the file as they are
touched, so work that goes through such arrays from one end to the other, block by block, needs memory for blocks only.
"""

from __future__ import annotations

import contextlib
import math
import mmap
import os
import sys
import weakref
from collections.abc import Callable, Iterator, Sequence
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import DTypeLike, NDArray

from beltrami_cli.arrays import Array, Int8s
from beltrami_cli.errors import OutputError

AnyArray = TypeVar("AnyArray", bound=np.ndarray[Any, Any])

BLOCK = 1 << 20
"""Samples that passes over all of them take at a time."""

CACHED = 1 << 16
"""Samples whose values stay in the cache of a processor while a pass works on them."""

SCATTERED = 1 << 14
"""The same of samples that lie all over the arrays, each on a page of its own, or 64 KB that are read with it."""

# Of the memory that is left for such arrays and for blocks of them: what they take before others are files.
_SHARE = 3 / 4
# Bytes from which on an array is a mapping of its own. With a quarter of it, `smooth` of 3 million points under
# --max-memory 680M takes 18 s of system time instead of 10.
_MMAP_BYTES = 1 << 22
_M_MMAP_THRESHOLD = -3  # of mallopt, in <malloc.h> of glibc
SMALLEST = 1 << 16
"""Bytes; smaller arrays stay in memory, and do not count: a file costs some pages."""


@dataclass
class _Limit:
    """Where arrays are files once those in memory take a number of bytes."""

    folder: Path | None  # None: for temporary files
    most: int
    held: int = 0  # bytes of arrays in memory
    maps: weakref.WeakSet[mmap.mmap] = field(default_factory=weakref.WeakSet)

    def has_room(self, size: int) -> bool:
        return size < SMALLEST or self.held + size <= self.most

    def count(self, array: Array) -> None:
        """Count an array as long as it lives."""
        if array.nbytes >= SMALLEST:
            self.held += array.nbytes
            weakref.finalize(array, self._release, array.nbytes).atexit = False

    def _release(self, size: int) -> None:
        self.held -= size


_LIMIT: ContextVar[_Limit | None] = ContextVar("limit", default=None)


@contextlib.contextmanager
def arrays_in_files(memory: int, folder: Path | None = None, *, in_chunks: bool = False) -> Iterator[None]:
    """Let arrays made in this context and thread be files without a name, in a folder, where memory is short.

    `memory`: bytes for the arrays and for temporary blocks of them; `in_chunks`: work on parts takes it, and all arrays
    of the whole are files.
    """
    if in_chunks:
        _return_freed_memory()
    token = _LIMIT.set(_Limit(folder, 0 if in_chunks else int(_SHARE * memory)))
    try:
        yield
    finally:
        _LIMIT.reset(token)


def _return_freed_memory() -> None:
    """Have the C library return large arrays to the system when they are freed, for the rest of the process.

    Else glibc keeps blocks of up to 32 MB for later, which took a quarter of the memory of a cloud of 3 million points.
    """
    if sys.platform == "linux":
        import ctypes

        with contextlib.suppress(AttributeError):  # musl has no such parameter, and returns them by itself
            ctypes.CDLL(None).mallopt(_M_MMAP_THRESHOLD, _MMAP_BYTES)


def zeros(shape: int | Sequence[int], dtype: DTypeLike) -> Array:
    """Return an array of zeros, like `numpy.zeros`; OutputError if the disk is full where it belongs."""
    return _made(np.zeros, shape, dtype)


def empty(shape: int | Sequence[int], dtype: DTypeLike) -> Array:
    """Return an array whose values mean nothing yet, like `numpy.empty`; OutputError as for `zeros`."""
    return _made(np.empty, shape, dtype)


def _made(make: Callable[..., Array], shape: int | Sequence[int], dtype: DTypeLike) -> Array:
    limit = _LIMIT.get()
    if limit is None:
        return make(shape, dtype)
    size = math.prod((shape,) if isinstance(shape, int) else shape) * np.dtype(dtype).itemsize
    if not limit.has_room(size):
        return _in_file(limit, size).view(dtype).reshape(shape)
    array = make(shape, dtype)
    limit.count(array)
    return array


def kept(array: Array) -> Array:
    """Return an array made elsewhere, from now on in a file if there is no room for it."""
    limit = _LIMIT.get()
    if limit is None:
        return array
    if not limit.has_room(array.nbytes):
        return copy_of(array)
    limit.count(array)
    return array


def kept_bytes(data: bytes) -> bytes | memoryview:
    """Return the same bytes, from now on in a file if there is no room for them."""
    return data if _LIMIT.get() is None else kept(np.frombuffer(data, np.uint8)).data


def _in_file(limit: _Limit, size: int) -> Array:
    """Return an array of bytes in a file."""
    import tempfile

    from beltrami_cli.surface.worker_process import unwritable

    try:
        with tempfile.TemporaryFile(dir=limit.folder) as file:
            # Else a full disk would end the program when a page is written.
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(file.fileno(), 0, size)
            else:
                file.truncate(size)
            pages = mmap.mmap(file.fileno(), size)
    except OSError as error:
        if limit.folder is None:
            raise unwritable(error.strerror or str(error)) from error
        cause = f"there is no room for {size >> 20} MB of working space ({error.strerror})"
        raise OutputError(str(limit.folder), cause, "free some, or raise --max-memory") from error
    limit.maps.add(pages)
    return np.frombuffer(pages, np.uint8)


@dataclass
class Droppable(Generic[AnyArray]):
    """A large array that is computed when it is needed, and again after it was dropped."""

    array: AnyArray | None
    compute: Callable[[], AnyArray] | None = None  # None: it is never dropped

    def get(self) -> AnyArray:
        if self.array is None:
            assert self.compute is not None
            self.array = self.compute()
        return self.array

    def drop(self) -> None:
        if self.compute is not None:
            self.array = None


def copy_of(array: Array) -> Array:
    """Return a copy of an array, made block by block, with its axes in the same order in memory."""
    if array.T.flags.c_contiguous and not array.flags.c_contiguous:
        return copy_of(array.T).T
    copy = empty(array.shape, array.dtype)
    source, target = array.reshape(-1), copy.reshape(-1)
    for block in blocks(len(source)):
        target[block] = source[block]
    return copy


def find(array: Array, value: int) -> NDArray[np.signedinteger[Any]]:
    """Return the flat indices of elements that have a value, ascending, in as few bytes as they need."""
    flat, at = array.reshape(-1), 0
    counts = [int(np.count_nonzero(flat[block] == value)) for block in blocks(len(flat))]
    found: NDArray[np.signedinteger[Any]] = empty(sum(counts), np.int32 if len(flat) < 1 << 31 else np.int64)
    for block, count in zip(blocks(len(flat)), counts, strict=True):
        found[at : at + count] = np.flatnonzero(flat[block] == value) + block.start
        at += count
    return found


def blocks(count: int, size: int = BLOCK) -> Iterator[slice]:
    """Go through a number of samples in blocks; what was touched of arrays in files leaves memory in between."""
    release_pages()
    for first in range(0, count, size):
        yield slice(first, min(count, first + size))
        release_pages()


def release_pages() -> None:
    """Let what was touched of arrays in files leave memory; it is read again when it is needed."""
    limit = _LIMIT.get()
    if limit is not None and hasattr(mmap, "MADV_DONTNEED"):
        for pages in limit.maps:
            pages.madvise(mmap.MADV_DONTNEED)


def any_in_files() -> bool:
    """Return whether there are arrays in files."""
    limit = _LIMIT.get()
    return limit is not None and len(limit.maps) > 0


def random_signs(shape: Sequence[int], random: np.random.Generator) -> Int8s:
    """Draw independent signs: the same in blocks as at once, as blocks are multiples of one draw."""
    signs: Int8s = empty(shape, np.int8)
    flat = signs.reshape(-1)
    for block in blocks(len(flat)):
        flat[block] = random.integers(0, 2, block.stop - block.start, np.int8) * 2 - 1
    return signs
