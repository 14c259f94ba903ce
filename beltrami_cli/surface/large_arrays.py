"""Arrays as long as a surface has samples: in memory, or in a file where a job must do with less of it.

In a file they look the same to whoever uses them. The system reads and writes the pages of the file as they are
touched, so work that goes through such arrays from one end to the other, block by block, needs memory for blocks only.
"""

from __future__ import annotations

import contextlib
import math
import mmap
import os
import shutil
import weakref
from collections.abc import Callable, Iterator, Sequence
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import DTypeLike

from beltrami_cli.arrays import Array, Float32s, Int8s, Int64s
from beltrami_cli.errors import ProcessingError

BLOCK = 1 << 20
"""Samples that passes over all of them take at a time."""

CACHED = 1 << 16
"""Samples whose values stay in the cache of a processor while a pass works on them."""

SCATTERED = 1 << 14
"""The same of samples that lie all over the arrays, each on a page of its own, or 64 KB that are read with it."""

SMALLEST_FILE = 1 << 24
"""Bytes; smaller arrays stay in memory, where there is as much as `_SHARE` suggests."""

# Of the memory of a job: what the largest array may take that stays in it. Patches work on some twenty at a time.
_SHARE = 1 / 64
_FEWEST_BYTES = 1 << 16  # a file costs some pages


@dataclass(frozen=True)
class _Disk:
    folder: Path
    smallest: int
    maps: weakref.WeakSet[mmap.mmap] = field(default_factory=weakref.WeakSet)


_DISK: ContextVar[_Disk | None] = ContextVar("disk", default=None)


@contextlib.contextmanager
def kept_on_disk(folder: Path, memory: int | None = None) -> Iterator[None]:
    """Let arrays that are large for the memory, and made meanwhile in this thread, be files without a name."""
    smallest = SMALLEST_FILE
    if memory is not None:
        smallest = min(smallest, max(_FEWEST_BYTES, int(_SHARE * memory)))
    token = _DISK.set(_Disk(folder, smallest))
    try:
        yield
    finally:
        _DISK.reset(token)


def zeros(shape: int | Sequence[int], dtype: DTypeLike) -> Array:
    """Return an array of zeros, like `numpy.zeros`; ProcessingError if the disk is full where it belongs."""
    found = _on_disk(shape, dtype)
    return np.zeros(shape, dtype) if found is None else found


def empty(shape: int | Sequence[int], dtype: DTypeLike, smallest: int | None = None) -> Array:
    """Return an array whose values mean nothing yet, like `numpy.empty`; ProcessingError as for `zeros`."""
    found = _on_disk(shape, dtype, smallest)
    return np.empty(shape, dtype) if found is None else found


def _on_disk(shape: int | Sequence[int], dtype: DTypeLike, smallest: int | None = None) -> Array | None:
    disk = _DISK.get()
    shape = (shape,) if isinstance(shape, int) else tuple(shape)
    size = math.prod(shape) * np.dtype(dtype).itemsize
    if disk is None or size < (disk.smallest if smallest is None else smallest):
        return None
    import tempfile

    try:
        with tempfile.TemporaryFile(dir=disk.folder) as file:
            # Else a full disk would end the program when a page is written.
            if hasattr(os, "posix_fallocate"):
                os.posix_fallocate(file.fileno(), 0, size)
            else:
                file.truncate(size)
            pages = mmap.mmap(file.fileno(), size)
    except OSError as error:
        raise ProcessingError(
            f"{disk.folder}: there is no room for {size >> 20} MB of working space ({error.strerror}); "
            "free some, or raise --max-memory"
        ) from error
    disk.maps.add(pages)
    return np.frombuffer(pages, dtype).reshape(shape)


@dataclass
class Droppable:
    """A large array that is computed again if it is needed after it was dropped."""

    array: Float32s | None
    compute: Callable[[], Float32s] | None = None  # None: it is never dropped

    def get(self) -> Float32s:
        if self.array is None:
            assert self.compute is not None
            self.array = self.compute()
        return self.array

    def drop(self) -> None:
        if self.compute is not None:
            self.array = None


def copy_of(array: Array, smallest: int | None = None) -> Array:
    """Return a copy of an array, made block by block; where there are many, small ones belong into files, too."""
    copy = empty(array.shape, array.dtype, smallest)
    source, target = array.reshape(-1), copy.reshape(-1)
    for block in blocks(len(source)):
        target[block] = source[block]
    return copy


def flatnonzero(mask: Array) -> Int64s:
    """Return the flat indices of elements that are not 0, like `numpy.flatnonzero`, block by block."""
    flat, at = mask.reshape(-1), 0
    found: Int64s = empty(int(np.count_nonzero(flat)), np.int64)
    for block in blocks(len(flat)):
        places = np.flatnonzero(flat[block])
        found[at : at + len(places)] = places + block.start
        at += len(places)
    return found


def blocks(count: int, size: int = BLOCK) -> Iterator[slice]:
    """Go through a number of samples in blocks; what was touched of arrays in files leaves memory in between."""
    leave_memory()
    for first in range(0, count, size):
        yield slice(first, min(count, first + size))
        leave_memory()


def leave_memory() -> None:
    """Let what was touched of arrays in files leave memory; it is read again when it is needed."""
    disk = _DISK.get()
    if disk is not None and hasattr(mmap, "MADV_DONTNEED"):
        for pages in disk.maps:
            pages.madvise(mmap.MADV_DONTNEED)


def free_space() -> int:
    """Return the bytes that are free where large arrays are kept."""
    import tempfile

    from beltrami_cli.surface.worker_process import writing_temporary_files

    disk = _DISK.get()
    with writing_temporary_files():
        return shutil.disk_usage(tempfile.gettempdir() if disk is None else disk.folder).free


def kept(data: bytes) -> bytes | memoryview:
    """Return the same bytes, from now on in a file where large arrays are kept so."""
    if not is_on_disk():
        return data
    array = empty(len(data), np.uint8, smallest=1 << 16)
    array[:] = np.frombuffer(data, np.uint8)
    leave_memory()
    return array.data


def is_on_disk() -> bool:
    """Return whether large arrays that are made now are kept in files."""
    return _DISK.get() is not None


def random_signs(shape: Sequence[int], random: np.random.Generator) -> Int8s:
    """Draw independent signs: the same in blocks as at once, as blocks are multiples of one draw."""
    signs: Int8s = empty(shape, np.int8)
    flat = signs.reshape(-1)
    for block in blocks(len(flat)):
        flat[block] = random.integers(0, 2, block.stop - block.start, np.int8) * 2 - 1
    return signs
