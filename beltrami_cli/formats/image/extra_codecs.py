"""Formats that OpenImageIO does not know: Basis Universal textures (KTX2) and AVIF."""

from __future__ import annotations

import importlib
import os
from collections.abc import Mapping
from typing import Protocol

import numpy as np

from beltrami_cli.arrays import Uint8s
from beltrami_cli.errors import InputError, install_hint
from beltrami_cli.formats.image import avif, ktx2

EXTRA = "beltrami-cli[textures]"
FAILURES = (OSError, ValueError, RuntimeError)  # of encoders
# Bytes for each thread of a codec, one per processor: a stack of 8 MiB, and as much for small arrays.
_THREAD_BYTES = 16 << 20


class Codec(Protocol):
    """A module that reads and writes a format.

    How much memory it takes is the growth of VmHWM of a process, on slopes and on noise of 256 to 2048 texels a side.
    With less memory alktx2 aborts the process, and Pillow calls sound files damaged.
    """

    DECODING_BYTES: int  # per texel, at most

    def measure(self, data: bytes, name: str) -> tuple[int, int, int]:
        """Return width, height and channels by the header; InputError if it promises what cannot be."""

    def decode(self, data: bytes, name: str) -> tuple[Uint8s, tuple[str, ...], bytes | None]:
        """Decode an image whose header `measure` has accepted: pixels (H, W, 3 or 4), notices, and an ICC profile."""

    def encoding_bytes(self, texels: int, source: bytes) -> int:
        """Return how much memory `encode` takes at most."""

    def encode(self, pixels: Uint8s, quality: int, source: bytes, *, as_data: bool) -> bytes:
        """Encode pixels as decoded ones are; `source` is the file that they came from if it is of the format."""

    def metadata_names(self, data: bytes) -> dict[str, bool]:
        """Name the metadata as a module of `containers` does, but for the colour profile."""


EXTRA_CODECS: Mapping[str, Codec] = {"ktx2": ktx2, "avif": avif}  # by the formats of `file_formats.FORMATS`
_PACKAGES = {"ktx2": ("alktx2", "alktx2"), "avif": ("PIL._avif", "Pillow 11.3 or later")}


def missing_package(file_format: str) -> str | None:
    """Return the package that a format needs and that is not installed, or None."""
    module, package = _PACKAGES[file_format]
    try:
        importlib.import_module(module)
    except ImportError:
        return package
    return None


def measure(data: bytes, file_format: str, name: str) -> tuple[int, int, int]:
    """Measure as `Codec.measure`; InputError also if its package is not installed."""
    package = missing_package(file_format)
    if package is not None:
        raise InputError(
            name, f"{file_format.upper()} images need the package {package}", install_hint(EXTRA)
        )
    return EXTRA_CODECS[file_format].measure(data, name)


def decode(data: bytes, file_format: str, name: str) -> tuple[Uint8s, tuple[str, ...], bytes | None]:
    width, height, _ = measure(data, file_format, name)
    _require_memory(width * height * EXTRA_CODECS[file_format].DECODING_BYTES)
    return EXTRA_CODECS[file_format].decode(data, name)


def encode(pixels: Uint8s, file_format: str, quality: int, source: bytes, *, as_data: bool) -> bytes:
    codec = EXTRA_CODECS[file_format]
    _require_memory(codec.encoding_bytes(pixels.shape[0] * pixels.shape[1], source))
    return codec.encode(pixels, quality, source, as_data=as_data)


def _require_memory(size: int) -> None:
    """Raise MemoryError if a codec might run out of it."""
    np.empty(size + _THREAD_BYTES * (os.cpu_count() or 1), np.uint8)
