"""Basis Universal textures (KTX2), by alktx2.

References
----------
.. [1] KTX File Format Specification, version 2.0, Khronos: section 3, header and level index.
.. [2] KHR_texture_basisu, in the registry of glTF extensions: two dimensions, ETC1S or UASTC.
"""

from __future__ import annotations

import math
import struct
from typing import Any

import numpy as np

from beltrami_cli.arrays import Uint8s
from beltrami_cli.errors import InputError
from beltrami_cli.formats.image.file_formats import damaged_image

DECODING_BYTES = 16  # as of `extra_codecs.Codec`
_LARGEST_SIDE = 1 << 14  # of textures on graphics cards
_BLOCK, _BLOCK_BYTES = 4, 16  # of UASTC
_HEADER = struct.Struct("<12x9I4I2Q")
_LEVEL = struct.Struct("<3Q")
_BASIS_LZ, _ZSTANDARD = 1, 2  # supercompressions
_TGA_HEADER = 18  # bytes
_BEST_QUALITY, _FASTEST_EFFORT, _ZSTANDARD_LEVEL = 100, 2, 9


def measure(data: bytes, name: str) -> tuple[int, int, int]:
    if len(data) < _HEADER.size:
        raise damaged_image(name, "ktx2", "no header")
    vk, _, width, height, depth, layers, faces, levels, scheme, *_ = _HEADER.unpack_from(data)
    if vk != 0 or scheme not in (0, _BASIS_LZ, _ZSTANDARD):
        cause = f"it is KTX2 with other samples (format {vk}, compression {scheme}) than Basis Universal"
        raise InputError(name, cause, "encode it as ETC1S or UASTC, or export it as PNG")
    if depth or layers > 1 or faces != 1 or not 0 < height <= _LARGEST_SIDE or not 0 < width <= _LARGEST_SIDE:
        cause = f"its size of {width} x {height} x {depth}, {layers} layers, {faces} faces cannot be used"
        raise InputError(name, cause, "export it as a plain image")
    if levels > max(width, height).bit_length():
        raise damaged_image(name, "ktx2", f"{levels} mip levels")
    for level in range(max(1, levels)):
        at = _HEADER.size + level * _LEVEL.size
        if at + _LEVEL.size > len(data):
            raise damaged_image(name, "ktx2", "no index of its levels")
        offset, length, unpacked = _LEVEL.unpack_from(data, at)
        blocks = math.prod(-(-max(1, side >> level) // _BLOCK) for side in (width, height))
        if offset + length > len(data) or (scheme != _BASIS_LZ and unpacked > blocks * _BLOCK_BYTES):
            raise damaged_image(name, "ktx2", f"level {level} leaves the file")
    return width, height, 4 if _inspected(data, name)["has_alpha"] else 3


def _inspected(data: bytes, name: str) -> Any:
    import alktx2

    try:
        return alktx2.inspect_ktx2(data)
    except RuntimeError as error:
        raise damaged_image(name, "ktx2", error) from None


def decode(data: bytes, name: str) -> tuple[Uint8s, tuple[str, ...], bytes | None]:
    import alktx2

    about = _inspected(data, name)
    try:
        # An uncompressed TGA: a header, then rows from below as blue, green, red and alpha.
        targa, _ = alktx2.decode_ktx2_to_bytes(data, format="tga")
    except (RuntimeError, MemoryError) as error:
        raise damaged_image(name, "ktx2", error) from None
    shape = about["height"], about["width"], 4
    rows = np.frombuffer(targa, np.uint8, math.prod(shape), _TGA_HEADER).reshape(shape)[::-1]
    order = [2, 1, 0, 3] if about["has_alpha"] else [2, 1, 0]
    return np.ascontiguousarray(rows[..., order]), (), None


def encoding_bytes(texels: int, source: bytes) -> int:
    import alktx2

    if not source or not alktx2.inspect_ktx2(source)["is_etc1s"]:
        return 40 * texels
    # In large images codebooks have a fixed size: 23 MB for 256, 80 MB for 512, 259 MB for 1024, and 710 MB for 2048
    # texels of noise a side.
    return min(352 * texels, 170 * texels + (96 << 20))


def encode(pixels: Uint8s, quality: int, source: bytes, *, as_data: bool) -> bytes:
    """Keep codec, transfer function, mip levels and supercompression of a source; else UASTC for sRGB, with mips."""
    import alktx2

    height, width, channels = pixels.shape
    opaque = np.full((height, width, 1), 255, np.uint8)
    filled = pixels if channels == 4 else np.concatenate([pixels, opaque], axis=2)
    is_etc1s, is_srgb, has_levels, packed = False, not as_data, True, True
    if source:
        about: Any = alktx2.inspect_ktx2(source)
        is_etc1s, is_srgb, has_levels = about["is_etc1s"], about["is_srgb"], about["levels"] > 1
        packed = _HEADER.unpack_from(source)[8] == _ZSTANDARD
    found: bytes = alktx2.encode_raw_rgba_to_ktx2(
        filled.tobytes(),
        width,
        height,
        channels == 4,
        codec="etc1s" if is_etc1s else "uastc",
        quality=quality if is_etc1s else _BEST_QUALITY,  # below it UASTC searches long for what packs well
        effort=_FASTEST_EFFORT,
        srgb=is_srgb,
        linear=not is_srgb,
        mipmaps=has_levels,
        force_alpha=channels == 4,
        check_for_alpha=channels == 4,
        zstd_supercompression_level=None if is_etc1s or not packed else _ZSTANDARD_LEVEL,
    )
    return found


def metadata_names(data: bytes) -> dict[str, bool]:
    """Return names for the key/value pairs of a file, except that of the program that wrote it."""
    at, size = _HEADER.unpack_from(data)[11:13]
    keys, end = set[str](), min(at + size, len(data) - 4)
    while at < end:
        (length,) = struct.unpack_from("<I", data, at)
        keys.add(data[at + 4 : at + 4 + length].partition(b"\0")[0].decode("utf-8", "replace"))
        at += 4 + length + -length % 4
    return {f"KTX2 key {name}": False for name in keys - {"KTXwriter"}}
