"""Arrays as long as a surface has samples: in memory, or memory-mapped files if memory is limited.

Files behave like arrays. The system reads and writes pages as they are accessed, so code that processes such arrays
sequentially, block by block, only needs memory for blocks.

The limit is a context and not a parameter: memory belongs to the whole run, and functions that make or pass over such
arrays are reached from every package.
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
from numpy.typing import DTypeLike

from beltrami_cli.arrays import Array, Indices
from beltrami_cli.errors import OutputError
from beltrami_cli.surface.temporary_files import unwritable

AnyArray = TypeVar("AnyArray", bound=np.ndarray[Any, Any])

BLOCK = 1 << 20
"""Samples that passes over all of them take at a time."""

CACHED = 1 << 16
"""Samples whose values stay in the cache of a processor while a pass works on them."""

SCATTERED = 1 << 14
"""The same of samples that lie all over the arrays, each on a page of its own, or 64 KB that are read with it."""

ROWS = 512
"""Rows of an image that passes over it take at a time."""

# Share of the remaining memory for arrays in memory; the rest is for blocks of them.
_SHARE = 3 / 4
# Minimum size in bytes of a mapped array. With a quarter of it, `smooth` of 3 million points under --max-memory 680M
# takes 18 s of system time instead of 10.
_MMAP_BYTES = 1 << 22
_M_MMAP_THRESHOLD = -3  # of mallopt, in <malloc.h> of glibc
MIN_COUNTED_BYTES = 1 << 16
"""Smaller arrays stay in memory, and do not count: a file costs some pages."""


@dataclass
class _Limit:
    """Limit above which arrays are put into files, and what counts towards it."""

    folder: Path | None  # None: for temporary files
    max_in_memory: int  # bytes
    in_memory: int = 0  # bytes of arrays that live
    maps: weakref.WeakSet[mmap.mmap] = field(default_factory=weakref.WeakSet)

    def has_room(self, size: int) -> bool:
        return size < MIN_COUNTED_BYTES or self.in_memory + size <= self.max_in_memory

    def count(self, array: Array) -> None:
        """Count the bytes of an array during its lifetime."""
        if array.nbytes >= MIN_COUNTED_BYTES:
            self.in_memory += array.nbytes
            weakref.finalize(array, self._release, array.nbytes).atexit = False

    def _release(self, size: int) -> None:
        self.in_memory -= size


_LIMIT: ContextVar[_Limit | None] = ContextVar("limit", default=None)


@contextlib.contextmanager
def arrays_in_files(memory: int, folder: Path | None = None, *, in_chunks: bool = False) -> Iterator[None]:
    """Put arrays made in this context and thread into anonymous files in a folder if memory is short.

    `memory`: bytes for arrays and temporary blocks; `in_chunks`: work on chunks needs the memory, so all arrays of the
    whole are files.
    """
    if in_chunks:
        _return_freed_memory()
    token = _LIMIT.set(_Limit(folder, 0 if in_chunks else int(_SHARE * memory)))
    try:
        yield
    finally:
        _LIMIT.reset(token)


def _return_freed_memory() -> None:
    """Let the C library return large freed arrays to the system, for the rest of the process.

    Otherwise glibc keeps blocks of up to 32 MB, which took a quarter of the memory of a cloud of 3 million points.
    """
    if sys.platform == "linux":
        import ctypes

        with contextlib.suppress(AttributeError):  # musl has no such parameter, and always returns them
            ctypes.CDLL(None).mallopt(_M_MMAP_THRESHOLD, _MMAP_BYTES)


def zeros(shape: int | Sequence[int], dtype: DTypeLike) -> Array:
    """Return an array of zeros, like `numpy.zeros`; OutputError if the disk is full."""
    return _allocate(np.zeros, shape, dtype)


def empty(shape: int | Sequence[int], dtype: DTypeLike) -> Array:
    """Return an uninitialised array, like `numpy.empty`; OutputError if the disk is full."""
    return _allocate(np.empty, shape, dtype)


def _allocate(make: Callable[..., Array], shape: int | Sequence[int], dtype: DTypeLike) -> Array:
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
    """Return the array, moved to a file if memory is short."""
    limit = _LIMIT.get()
    if limit is None:
        return array
    if not limit.has_room(array.nbytes):
        return copy_of(array)
    limit.count(array)
    return array


def kept_bytes(data: bytes) -> bytes | memoryview:
    """Return the bytes, moved to a file if memory is short."""
    return data if _LIMIT.get() is None else kept(np.frombuffer(data, np.uint8)).data


def _in_file(limit: _Limit, size: int) -> Array:
    """Return an array of bytes in an anonymous file."""
    import tempfile

    try:
        with tempfile.TemporaryFile(dir=limit.folder) as file:
            # Otherwise a full disk would kill the process when a page is written.
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
    """A large array that is computed on demand, and again after it was dropped."""

    array: AnyArray | None
    compute: Callable[[], AnyArray] | None = None  # None: never dropped

    def get(self) -> AnyArray:
        if self.array is None:
            assert self.compute is not None
            self.array = self.compute()
        return self.array

    def drop(self) -> None:
        if self.compute is not None:
            self.array = None


def copy_of(array: Array) -> Array:
    """Copy an array block by block, with the same memory order of axes."""
    if array.T.flags.c_contiguous and not array.flags.c_contiguous:
        return copy_of(array.T).T
    copy = empty(array.shape, array.dtype)
    source, target = array.reshape(-1), copy.reshape(-1)
    for block in blocks(len(source)):
        target[block] = source[block]
    return copy


def indices_of(array: Array, value: int) -> Indices:
    """Return the flat indices of elements with a value, ascending, in the smallest integer type."""
    flat, at = array.reshape(-1), 0
    counts = [int(np.count_nonzero(flat[block] == value)) for block in blocks(len(flat))]
    indices: Indices = empty(sum(counts), np.int32 if len(flat) < 1 << 31 else np.int64)
    for block, count in zip(blocks(len(flat)), counts, strict=True):
        indices[at : at + count] = np.flatnonzero(flat[block] == value) + block.start
        at += count
    return indices


def blocks(count: int, size: int = BLOCK) -> Iterator[slice]:
    """Yield slices of samples block by block; between blocks, pages of arrays in files leave memory."""
    release_pages()
    for first in range(0, count, size):
        yield slice(first, min(count, first + size))
        release_pages()


def release_pages() -> None:
    """Release accessed pages of arrays in files; they are read again on demand."""
    limit = _LIMIT.get()
    if limit is not None and hasattr(mmap, "MADV_DONTNEED"):
        for pages in limit.maps:
            pages.madvise(mmap.MADV_DONTNEED)


def any_in_files() -> bool:
    limit = _LIMIT.get()
    return limit is not None and len(limit.maps) > 0
