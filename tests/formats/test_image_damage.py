"""Images that are damaged, too large or of no use end in one clear error, and never decode first."""

from __future__ import annotations

import errno
import io
import time
import zlib
from pathlib import Path

import numpy as np
import OpenImageIO
import pytest
from PIL import Image

from beltrami_cli.errors import InputError
from beltrami_cli.formats.image import read_image
from formats.image_files import LOSSLESS, SUFFIXES, encode, noise, png_file, riff, riff_chunks

KINDS = {known: each for known, *each in (*LOSSLESS, ("jpeg", "uint8", 3), ("hdr", "float", 3))}


def sample(known):
    kind, channels = KINDS[known]
    return encode(noise(kind, channels, 24, 24), known, kind)


def png(width, height, lines=b""):
    header = width.to_bytes(4) + height.to_bytes(4) + bytes([8, 2, 0, 0, 0])
    return png_file([(b"IHDR", header), (b"IDAT", zlib.compress(lines)), (b"IEND", b"")])


@pytest.mark.parametrize("known", sorted(KINDS))
def test_a_cut_off_image_is_refused_by_name(known):
    data = sample(known)
    pixels = len(data) - (521 if known == "targa" else 0)  # A TGA file ends with a table that may be missing.
    for part in (0.02, 0.3, 0.6, 0.9):
        with pytest.raises(InputError) as raised:
            read_image(data[: int(part * pixels)], "skin" + SUFFIXES[known])
        assert raised.value.name == "skin" + SUFFIXES[known]
        assert "/proc" not in str(raised.value)
        assert "\n" not in str(raised.value)
        assert OpenImageIO.geterror() == ""


@pytest.mark.parametrize("size", [(0, 4), (4, 0), (1 << 30, 1), (1, 1 << 30), (65535, 65535)])
def test_images_of_no_or_too_large_a_size_are_refused_by_their_header(size):
    begin = time.perf_counter()
    with pytest.raises(InputError, match=r"\d+ x \d+ pixels|size|damaged"):
        read_image(png(*size, bytes(1 << 16)), "bomb.png")
    assert time.perf_counter() - begin < 1


@pytest.mark.parametrize(("known", "at"), [("targa", 12), ("bmp", 18)])
def test_images_of_no_width_are_refused(known, at):
    data = bytearray(sample(known))
    data[at : at + 2] = bytes(2)
    with pytest.raises(InputError):
        read_image(bytes(data), "none" + SUFFIXES[known])


def test_what_is_no_image_is_refused_whatever_its_name():
    for data in (b"", b"hello", b"GIF89a" + bytes(30), b"RIFF\0\0\0\0WAVE", bytes(100)):
        with pytest.raises(InputError, match=r"no known image format|damaged|is empty"):
            read_image(data, "x.png")
    with pytest.raises(InputError):
        read_image(b"hello", "x.tga")


@pytest.mark.parametrize("transform", [0, 2])  # Adobe's: none, or luma and chroma of the inks
def test_inks_of_print_are_refused(transform):
    file = io.BytesIO()
    Image.fromarray(noise("uint8", 4), "CMYK").save(file, "JPEG")
    jpeg = bytearray(file.getvalue())
    jpeg[jpeg.index(b"Adobe") + 11] = transform
    with pytest.raises(InputError, match="CMYK"):
        read_image(bytes(jpeg), "print.jpg")
    tiff = encode(noise("uint8", 4), "tiff", tiff__ColorSpace="CMYK")
    with pytest.raises(InputError, match="CMYK"):
        read_image(tiff, "print.tif")


def test_values_and_types_that_cannot_be_used_are_refused():
    pixels = noise("float", 3)
    pixels[0, 0, 0], pixels[1, 1, 1] = np.nan, np.inf
    with pytest.raises(InputError, match="2 of its values are not finite"):
        read_image(encode(pixels, "openexr", "float"), "x.exr")
    with pytest.raises(InputError, match="int16"):
        read_image(encode(noise("uint8", 3).astype(np.int16), "tiff", "int16"), "x.tif")


def test_of_an_animation_the_first_image_is_taken_and_said_so():
    frames = []
    for seed in (0, 1):
        pixels = noise("uint8", 4, 8, 8, seed)
        pixels[..., 3] = 255
        payload = riff(riff_chunks(encode(pixels, "webp")))[12:]
        frames.append((b"ANMF", bytes(6) + bytes([7, 0, 0, 7, 0, 0, 100, 0, 0, 0]) + payload))
    chunks = [(b"VP8X", bytes([0x12, 0, 0, 0, 7, 0, 0, 7, 0, 0])), (b"ANIM", bytes(6)), *frames]
    picture = read_image(riff(chunks), "moving.webp")
    assert picture.pixels.shape[:2] == (8, 8)
    assert "moving.webp holds several images" in picture.notices[0]
    assert not read_image(sample("webp"), "still.webp").notices


def test_a_compression_that_is_not_built_in_is_no_damage():
    data = bytearray(sample("tiff"))
    first = int.from_bytes(data[4:8], "little")
    for entry in range(int.from_bytes(data[first : first + 2], "little")):
        at = first + 2 + 12 * entry
        if int.from_bytes(data[at : at + 2], "little") == 259:  # Compression
            data[at + 8 : at + 10] = (34712).to_bytes(2, "little")  # JPEG 2000, which libtiff never decodes
    reported = r"does not read how the TIF image is compressed .* save it without compression"
    with pytest.raises(InputError, match=reported):
        read_image(bytes(data), "x.tif")


def test_no_room_for_a_copy_names_the_image(monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    data = sample("png")
    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(InputError, match=r"skin\.png: there is no room for a copy of its \d+ bytes"):
        read_image(data, "skin.png")
