"""What an image file has that is not read as it is, or cannot be written again."""

from __future__ import annotations

from typing import Any

from beltrami_cli.formats.image.metadata import has_palette, is_animated

_COLOURED = 3  # channels
_PALETTE_IN_TIFF = 3  # its photometric interpretation
_COMPRESSIONS_OF_TIFF = ("", "none", "lzw", "zip", "packbits")  # that OpenImageIO writes
_WHOLE_BYTES = (8, 16, 32)


def changes(file: Any, spec: Any, data: bytes, known: str, name: str) -> tuple[str, ...]:
    """Say what of an image file is not kept, one sentence each, with its name.

    Parameters
    ----------
    file : OpenImageIO.ImageInput
        Opened. Its first image is read already, since this looks for others.
    spec : OpenImageIO.ImageSpec
        The description of that one.
    data : bytes
        The file.
    known : str
        Its format, a key of `recognition.FORMATS`.
    name : str
        Its name.
    """
    notices = []
    if known == "psd":  # whose first image is all its layers together
        notices.append(f"{name} is taken as it is shown, its layers together.")
    elif is_animated(data, known) or file.seek_subimage(1, 0):
        notices.append(f"{name} holds several images, of which only the first is read and kept.")
    if file.seek_subimage(0, 1):
        notices.append(f"{name} holds smaller copies of itself (mip levels), which are left out.")
    in_tiff = spec.get_int_attribute("tiff:PhotometricInterpretation") == _PALETTE_IN_TIFF
    # In a palette of greys alone OpenImageIO sees grey, and so writes it.
    palette = in_tiff or has_palette(data, known)
    if palette and spec.nchannels >= _COLOURED:
        notices.append(f"{name} has a palette, which becomes full colours.")
    bits = 0 if palette else _bits_a_sample(spec, data, known)
    if bits and bits not in _WHOLE_BYTES:
        notices.append(f"{name} has {bits}-bit samples, which become {8 * spec.format.size()}-bit ones.")
    if known == "tiff":
        notices += _changes_of_tiff(spec, name)
    return tuple(notices)


def _bits_a_sample(spec: Any, data: bytes, known: str) -> int:
    """Return how many bits a sample has in the file; 0 if that is not told."""
    return data[24] if known == "png" else int(spec.get_int_attribute("oiio:BitsPerSample"))


def _changes_of_tiff(spec: Any, name: str) -> list[str]:
    notices = []
    if spec.get_string_attribute("tiff:ColorSpace") == "YCbCr":
        notices.append(f"{name} stores brightness and hues (YCbCr), which become red, green and blue.")
    compression = spec.get_string_attribute("compression")
    if compression not in _COMPRESSIONS_OF_TIFF:
        notices.append(
            f"{name} is compressed by {compression}; what is written as TIFF is compressed by zip."
        )
    return notices
