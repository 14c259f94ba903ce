"""Formats that OpenImageIO does not know: Basis Universal textures (KTX2) by alktx2, AVIF by Pillow.

References
----------
.. [1] KTX File Format Specification, version 2.0, Khronos: section 3, header and level index.
.. [2] KHR_texture_basisu, in the registry of glTF extensions: two dimensions, ETC1S or UASTC.
.. [3] AV1 Image File Format, AOMedia; AV1 Codec ISO Media File Format Binding, section 2.3: av1C.
"""

from __future__ import annotations

import importlib
import io
import math
import os
import struct
import warnings
from typing import Any

import numpy as np

from beltrami_cli.arrays import Uint8s
from beltrami_cli.errors import InputError, install_hint

_PACKAGES = {"ktx2": ("alktx2", "alktx2"), "avif": ("PIL._avif", "Pillow 11.3 or later")}
EXTRA = "beltrami-cli[textures]"
EXTRA_CODECS = tuple(_PACKAGES)  # the formats of `file_formats.FORMATS` that are read and written here
_LARGEST_SIDE = 1 << 14  # of AV1 images and of textures on graphics cards
_BLOCK, _BLOCK_BYTES = 4, 16  # of UASTC
_HEADER = struct.Struct("<12x9I4I2Q")
_LEVEL = struct.Struct("<3Q")
_BASIS_LZ, _ZSTANDARD = 1, 2  # supercompressions
_HIGH_BITDEPTH, _TWELVE_BIT = 0x40, 0x20
_TGA_HEADER = 18  # bytes
_BEST_QUALITY = 100
_ZSTANDARD_LEVEL = 9
FAILURES = (OSError, ValueError, RuntimeError)  # of encoders
_DECODING_ERRORS = (*FAILURES, SyntaxError, MemoryError)  # by Pillow, of damaged files
_FASTEST_EFFORT, _SLOWEST_SPEED = 2, 6
# Bytes per texel that encoders and decoders take at most: the growth of VmHWM of a process, on slopes and on noise of
# 256 to 2048 texels a side. With less memory alktx2 aborts the process, and Pillow calls sound files damaged.
_UASTC_BYTES, _AVIF_BYTES = 40, 64
_DECODING_BYTES = {"ktx2": 16, "avif": 25}
# Bytes for each thread of theirs, one per processor: a stack of 8 MiB, and as much for small arrays.
_THREAD_BYTES = 16 << 20


def missing_package(file_format: str) -> str | None:
    """Return the package that a format needs and that is not installed, or None."""
    module, package = _PACKAGES[file_format]
    try:
        importlib.import_module(module)
    except ImportError:
        return package
    return None


def measured(data: bytes, file_format: str, name: str) -> tuple[int, int, int]:
    """Return width, height and channels by the header; InputError if it promises what cannot be."""
    package = missing_package(file_format)
    if package is not None:
        raise InputError(
            name, f"{file_format.upper()} images need the package {package}", install_hint(EXTRA)
        )
    if file_format == "ktx2":
        return _measured_ktx2(data, name)
    with _opened_avif(data, name) as image:
        width, height = image.size
        return width, height, 4 if image.mode == "RGBA" else 3


def decoded(data: bytes, file_format: str, name: str) -> tuple[Uint8s, tuple[str, ...], bytes | None]:
    """Decode an image whose header `measured` has accepted: pixels (H, W, 3 or 4), notices, and an ICC profile."""
    width, height, _ = measured(data, file_format, name)
    _require_memory(width * height * _DECODING_BYTES[file_format])
    if file_format == "ktx2":
        return _decoded_ktx2(data, name), (), None
    with _opened_avif(data, name) as image:
        try:
            pixels = np.array(image.convert(image.mode if image.mode == "RGBA" else "RGB"))
        except _DECODING_ERRORS as error:
            raise _damaged(name, "AVIF", error) from None
        notices, bits = [], _avif_bits(data)
        if getattr(image, "n_frames", 1) > 1:
            notices.append(f"{name} holds several images; only the first is read and kept.")
        if bits > 8:
            notices.append(f"{name} has {bits}-bit samples, which become 8-bit ones.")
        return pixels, tuple(notices), image.info.get("icc_profile")


def encoded(file_format: str, pixels: Uint8s, quality: int, source: bytes, *, as_data: bool) -> bytes:
    """Encode pixels as decoded ones are; `source` is the file that they came from if it is of the format."""
    if file_format == "ktx2":
        return _encoded_ktx2(pixels, quality, source, as_data=as_data)
    return _encoded_avif(pixels, quality, source)


def metadata_names(data: bytes, file_format: str) -> list[str]:
    """Return names for the metadata of a file, except its colour profile."""
    if file_format == "ktx2":
        return [f"KTX2 key {name}" for name in _ktx2_keys(data)]
    return [name.upper() for name in _avif_metadata(data) if name != "icc_profile"]


def _require_memory(size: int) -> None:
    """Raise MemoryError if a codec might run out of it."""
    np.empty(size + _THREAD_BYTES * (os.cpu_count() or 1), np.uint8)


def _etc1s_bytes(texels: int) -> int:
    """Return how much memory encoding as ETC1S takes at most: in large images codebooks have a fixed size."""
    # Measured as above: 23 MB for 256, 80 MB for 512, 259 MB for 1024, and 710 MB for 2048 texels of noise a side.
    return min(352 * texels, 170 * texels + (96 << 20))


def _damaged(name: str, label: str, error: object) -> InputError:
    return InputError(
        name, f"the {label} image is damaged or cut off ({str(error)[:150]})", "export it again"
    )


def _measured_ktx2(data: bytes, name: str) -> tuple[int, int, int]:
    if len(data) < _HEADER.size:
        raise _damaged(name, "KTX2", "no header")
    vk, _, width, height, depth, layers, faces, levels, scheme, *_ = _HEADER.unpack_from(data)
    if vk != 0 or scheme not in (0, _BASIS_LZ, _ZSTANDARD):
        cause = f"it is KTX2 with other samples (format {vk}, compression {scheme}) than Basis Universal"
        raise InputError(name, cause, "encode it as ETC1S or UASTC, or export it as PNG")
    if depth or layers > 1 or faces != 1 or not 0 < height <= _LARGEST_SIDE or not 0 < width <= _LARGEST_SIDE:
        cause = f"its size of {width} x {height} x {depth}, {layers} layers, {faces} faces cannot be used"
        raise InputError(name, cause, "export it as a plain image")
    if levels > max(width, height).bit_length():
        raise _damaged(name, "KTX2", f"{levels} mip levels")
    for level in range(max(1, levels)):
        at = _HEADER.size + level * _LEVEL.size
        if at + _LEVEL.size > len(data):
            raise _damaged(name, "KTX2", "no index of its levels")
        offset, length, unpacked = _LEVEL.unpack_from(data, at)
        blocks = math.prod(-(-max(1, side >> level) // _BLOCK) for side in (width, height))
        if offset + length > len(data) or (scheme != _BASIS_LZ and unpacked > blocks * _BLOCK_BYTES):
            raise _damaged(name, "KTX2", f"level {level} leaves the file")
    return width, height, 4 if _inspected(data, name)["has_alpha"] else 3


def _inspected(data: bytes, name: str) -> Any:
    import alktx2

    try:
        return alktx2.inspect_ktx2(data)
    except RuntimeError as error:
        raise _damaged(name, "KTX2", error) from None


def _decoded_ktx2(data: bytes, name: str) -> Uint8s:
    import alktx2

    about = _inspected(data, name)
    try:
        # An uncompressed TGA: a header, then rows from below as blue, green, red and alpha.
        targa, _ = alktx2.decode_ktx2_to_bytes(data, format="tga")
    except (RuntimeError, MemoryError) as error:
        raise _damaged(name, "KTX2", error) from None
    shape = about["height"], about["width"], 4
    rows = np.frombuffer(targa, np.uint8, math.prod(shape), _TGA_HEADER).reshape(shape)[::-1]
    order = [2, 1, 0, 3] if about["has_alpha"] else [2, 1, 0]
    return np.ascontiguousarray(rows[..., order])


def _encoded_ktx2(pixels: Uint8s, quality: int, source: bytes, *, as_data: bool) -> bytes:
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
    _require_memory(_etc1s_bytes(width * height) if is_etc1s else width * height * _UASTC_BYTES)
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


def _ktx2_keys(data: bytes) -> set[str]:
    """Return the names of the key/value pairs of a KTX2 file, except that of the program that wrote it."""
    at, size = _HEADER.unpack_from(data)[11:13]
    keys, end = set[str](), min(at + size, len(data) - 4)
    while at < end:
        (length,) = struct.unpack_from("<I", data, at)
        keys.add(data[at + 4 : at + 4 + length].partition(b"\0")[0].decode("utf-8", "replace"))
        at += 4 + length + -length % 4
    return keys - {"KTXwriter"}


def _opened_avif(data: bytes, name: str) -> Any:
    from PIL import Image

    try:
        with warnings.catch_warnings():  # of large images, which are checked by their size
            warnings.simplefilter("ignore")
            return Image.open(io.BytesIO(data), formats=["AVIF"])
    except (*_DECODING_ERRORS, Image.DecompressionBombError) as error:
        raise _damaged(name, "AVIF", str(error).partition("<")[0].strip()) from None


def _avif_metadata(data: bytes) -> dict[str, bytes]:
    """Return the colour profile, EXIF and XMP of an AVIF file, by the names of Pillow's options."""
    with _opened_avif(data, "") as image:
        return {key: image.info[key] for key in ("icc_profile", "exif", "xmp") if image.info.get(key)}


def _avif_bits(data: bytes) -> int:
    """Return the bits of a sample, by the first configuration of a codec."""
    at = data.find(b"av1C")
    flags = data[at + 6] if 0 <= at < len(data) - 6 else 0
    if not flags & _HIGH_BITDEPTH:
        return 8
    return 12 if flags & _TWELVE_BIT else 10


def _encoded_avif(pixels: Uint8s, quality: int, source: bytes) -> bytes:
    from PIL import Image

    kept = _avif_metadata(source) if source else {}
    _require_memory(pixels.shape[0] * pixels.shape[1] * _AVIF_BYTES)
    buffer = io.BytesIO()
    # Tiles that follow the number of processors would make the file depend on the machine.
    options = {"quality": quality, "subsampling": "4:4:4", "speed": _SLOWEST_SPEED, "autotiling": False}
    Image.fromarray(pixels).save(buffer, "AVIF", **options, **kept)
    return buffer.getvalue()
