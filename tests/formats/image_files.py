"""Image files of the tests' own, encoded by OpenImageIO without any code of the package."""

import io
import struct
import tempfile
import zlib
from pathlib import Path

import numpy as np
import OpenImageIO
import pytest
from PIL import Image

NAMES = {1: ("Y",), 2: ("Y", "A"), 3: ("R", "G", "B"), 4: ("R", "G", "B", "A")}
LOSSLESS = [
    *(("png", kind, channels) for kind in ("uint8", "uint16") for channels in (1, 2, 3, 4)),
    *(("tiff", kind, channels) for kind in ("uint8", "uint16", "half", "float") for channels in (1, 2, 3, 4)),
    *(("openexr", kind, channels) for kind in ("half", "float") for channels in (1, 2, 3, 4)),
    *(("targa", "uint8", channels) for channels in (1, 2, 3, 4)),
    *(("bmp", "uint8", channels) for channels in (3, 4)),
    *(("webp", "uint8", channels) for channels in (3, 4)),
]
RARER = [
    *(("jpegxl", kind, channels) for kind in ("uint8", "uint16", "half", "float") for channels in (1, 3, 4)),
    *((known, kind, n) for known, n in (("pgm", 1), ("ppm", 3)) for kind in ("uint8", "uint16")),
    *(("pfm", "float", channels) for channels in (1, 3)),
]
ONLY_READ = [
    ("bmp", "uint8", 1),  # with a palette of greys
    *((known, kind, n) for known in ("jpeg2000", "j2k") for kind in ("uint8", "uint16") for n in (1, 3, 4)),
    *(("dpx", kind, channels) for kind in ("uint8", "uint16", "float") for channels in (1, 3, 4)),
    *(("sgi", kind, channels) for kind in ("uint8", "uint16") for channels in (1, 3, 4)),
    *(("fits", kind, channels) for kind in ("uint8", "float") for channels in (1, 3, 4)),
    *(("rla", kind, channels) for kind in ("uint8", "uint16", "float") for channels in (1, 3, 4)),
]
SUFFIXES = {
    "png": ".png", "tiff": ".tif", "openexr": ".exr", "targa": ".tga", "bmp": ".bmp", "webp": ".webp",
    "jpeg": ".jpg", "hdr": ".hdr",
}  # fmt: skip
RARER_SUFFIXES = {
    "jpegxl": ".jxl", "jpeg2000": ".jp2", "j2k": ".j2k", "pgm": ".pgm", "ppm": ".ppm", "pfm": ".pfm", "dpx": ".dpx",
    "sgi": ".sgi", "fits": ".fits", "rla": ".rla", "gif": ".gif", "ico": ".ico", "zfile": ".z",
}  # fmt: skip


def noise(kind, channels, height=5, width=7, seed=0):
    """Random pixels, of which none has an alpha of 0 in integers."""
    rng = np.random.default_rng(seed)
    if kind in ("uint8", "uint16"):
        return rng.integers(1, np.iinfo(kind).max + 1, (height, width, channels)).astype(kind)
    return (rng.random((height, width, channels)) * 2 - 0.1).astype(
        np.float16 if kind == "half" else np.float32
    )


def phantom(channels=3, side=32):
    """Smooth colours with noise."""
    rows, columns = np.mgrid[:side, :side] * (200 // side)
    plain = np.stack([rows, columns, (rows + columns) // 2, 255 - rows][:channels], axis=-1)
    return np.clip(plain + np.random.default_rng(3).normal(0, 4, plain.shape), 1, 255).astype(np.uint8)


def with_alpha(pixels):
    """Give rows of pixels, by turns, an alpha of 0, of 1, and any."""
    pixels[::3, :, -1] = 0
    pixels[1::3, :, -1] = np.iinfo(pixels.dtype).max if pixels.dtype.kind == "u" else 1
    return pixels


def bitmap(*masks):
    """Return a BMP file of version 5 with masks of red, green, blue and alpha, and a profile at its end."""
    plain, header = encode(noise("uint8", 4), "bmp"), bytearray(138)
    header[:54], header[10], header[14], header[30], header[70:74] = plain[:54], 138, 124, 3, b"DEBM"
    header[54:70], header[126:134] = struct.pack("<4I", *masks), struct.pack("<II", len(plain) + 70, 9)
    return bytes(header) + plain[54:] + b"a profile"


def exact_webp(pixels):
    """Return a lossless WebP file with the colours under an alpha of 0, which OpenImageIO would clear."""
    return saved(Image.fromarray(pixels), ".webp", lossless=True, exact=True)


def saved(image, suffix, **options):
    """Return an image of Pillow as a file."""
    buffer = io.BytesIO()
    image.save(buffer, Image.registered_extensions()[suffix], **options)
    return buffer.getvalue()


def encode(pixels, known, kind=None, types=None, **attributes):
    """Return an image file; "__" in names of attributes stands for ":"."""
    height, width, channels = pixels.shape
    spec = OpenImageIO.ImageSpec(width, height, channels, kind or str(pixels.dtype))
    if channels in NAMES:
        spec.channelnames = NAMES[channels]
        spec.alpha_channel = channels - 1 if channels in (2, 4) else -1
    else:
        spec.channelnames = tuple("RGBAZ"[:channels])
    if attributes.get("tiff__ColorSpace") == "CMYK":
        spec.channelnames, spec.alpha_channel = ("C", "M", "Y", "K"), -1
    if types:
        spec.channelformats = tuple(OpenImageIO.TypeDesc(name) for name in types)
    options = {"oiio__UnassociatedAlpha": 1, "tiff__half": 1}
    if known == "jpegxl":
        options |= {"compression": "jpegxl:100"}
    if known == "webp":
        options |= {"compression": "lossless", "webp__method": 0}
    for name, value in {**options, **attributes}.items():
        if isinstance(value, bytes):
            spec.attribute(name.replace("__", ":"), OpenImageIO.TypeDesc(f"uint8[{len(value)}]"), value)
        else:
            spec.attribute(name.replace("__", ":"), value)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"image{(SUFFIXES | RARER_SUFFIXES)[known]}"
        file = OpenImageIO.ImageOutput.create(known)
        if file is None:
            OpenImageIO.geterror()
            pytest.skip(f"this build of OpenImageIO does not write {known}")
        assert file.open(str(path), spec), file.geterror()
        assert file.write_image(np.ascontiguousarray(pixels))
        assert file.close()
        file.geterror()
        return path.read_bytes()


def png_chunk(kind, payload):
    return len(payload).to_bytes(4) + kind + payload + zlib.crc32(kind + payload).to_bytes(4)


def png_file(chunks):
    return b"\x89PNG\r\n\x1a\n" + b"".join(png_chunk(*chunk) for chunk in chunks)


def two_pixels(*chunks):
    """Return a PNG of two pixels by a palette, with further chunks behind it."""
    header = (2).to_bytes(4) + (1).to_bytes(4) + bytes([8, 3, 0, 0, 0])
    palette = (b"PLTE", bytes([1, 2, 3, 200, 100, 50]))
    data = (b"IDAT", zlib.compress(bytes([0, 0, 1])))
    return png_file([(b"IHDR", header), palette, *chunks, data, (b"IEND", b"")])


def png_chunks(data):
    chunks, at = [], 8
    while at < len(data):
        size = int.from_bytes(data[at : at + 4])
        chunks.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + size]))
        at += 12 + size
    return chunks


def riff(chunks):
    body = b"".join(k + len(p).to_bytes(4, "little") + p + b"\0" * (len(p) % 2) for k, p in chunks)
    return b"RIFF" + (len(body) + 4).to_bytes(4, "little") + b"WEBP" + body


def riff_chunks(data):
    chunks, at = [], 12
    while at < len(data):
        size = int.from_bytes(data[at + 4 : at + 8], "little")
        chunks.append((data[at : at + 4], data[at + 8 : at + 8 + size]))
        at += 8 + size + size % 2
    return chunks


def jpeg_segment(marker, payload):
    return bytes([0xFF, marker]) + (len(payload) + 2).to_bytes(2) + payload


def icc_profile():
    """The least that passes for an RGB profile: a header and an empty table of tags."""
    header = bytearray(128)
    header[0:4] = (132).to_bytes(4)
    header[8:12] = b"\x02\x10\0\0"
    header[12:24] = b"mntrRGB XYZ "
    header[24:36] = bytes([0x07, 0xD0, 0, 1, 0, 1, 0, 0, 0, 0, 0, 0])
    header[36:40] = b"acsp"
    header[68:80] = bytes.fromhex("0000f6d6000100000000d32d")
    return bytes(header) + bytes(4)


def stored(path):
    """Return the numbers of an image as its file has them."""
    config = OpenImageIO.ImageSpec()
    config.attribute("oiio:UnassociatedAlpha", 1)
    file = OpenImageIO.ImageInput.open(str(path), config)
    return file.read_image(file.spec().format)
