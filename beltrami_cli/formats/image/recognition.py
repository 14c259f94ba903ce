"""Which image formats there are, what each can hold, and how their files are told apart."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import PurePosixPath


@dataclass(frozen=True)
class ImageFormat:
    """What a format can hold.

    Attributes
    ----------
    suffixes : tuple of str
        Extensions of its files, the usual one first.
    types : tuple of str
        Sample types as NumPy names, the coarsest first.
    channels : tuple of int
        Numbers of channels: 1 is grey, 3 red, green and blue; 2 and 4 have alpha besides.
    signatures : tuple of bytes
        What its files start with.
    """

    suffixes: tuple[str, ...]
    types: tuple[str, ...]
    channels: tuple[int, ...] = (1, 2, 3, 4)
    signatures: tuple[bytes, ...] = ()

    @property
    def alpha(self) -> bool:
        """Whether there may be alpha beside the colours."""
        return 4 in self.channels


FORMATS = {
    "png": ImageFormat((".png",), ("uint8", "uint16"), signatures=(b"\x89PNG\r\n\x1a\n",)),
    "jpeg": ImageFormat((".jpg", ".jpeg", ".jpe", ".jfif"), ("uint8",), (1, 3), (b"\xff\xd8\xff",)),
    "webp": ImageFormat((".webp",), ("uint8",), (3, 4), (b"RIFF",)),
    "tiff": ImageFormat(
        (".tif", ".tiff"),
        ("uint8", "uint16", "float16", "float32"),
        signatures=(b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"),
    ),
    "openexr": ImageFormat((".exr",), ("float16", "float32"), signatures=(b"v/1\x01",)),
    "targa": ImageFormat((".tga", ".targa", ".tpic"), ("uint8",)),
    "bmp": ImageFormat((".bmp", ".dib"), ("uint8",), (1, 3, 4), (b"BM",)),
    "hdr": ImageFormat((".hdr", ".rgbe"), ("float32",), (3,), (b"#?",)),
}
"""The formats by OpenImageIO's names."""

READABLE = "PNG, JPEG, WebP, TIFF, EXR, TGA, BMP and HDR images are read"
_TARGA_FOOTER = b"TRUEVISION-XFILE.\0"


def format_of(data: bytes, name: str) -> str | None:
    """Tell the format of an image file by its content; TGA, which need not have a mark, also by its name.

    Parameters
    ----------
    data : bytes
        The file.
    name : str
        Its name.

    Returns
    -------
    str or None
        A key of `FORMATS`.
    """
    for known, traits in FORMATS.items():
        if data.startswith(traits.signatures) and (known != "webp" or data[8:12] == b"WEBP"):
            return known
    if data.endswith(_TARGA_FOOTER) or format_of_suffix(suffix_of(name)) == "targa":
        return "targa"
    return None


def format_of_suffix(suffix: str) -> str | None:
    """Return the format whose files have an extension (with the dot, in any case), or None."""
    for known, traits in FORMATS.items():
        if suffix.lower() in traits.suffixes:
            return known
    return None


def suffix_of(name: str) -> str:
    """Return the extension of a file's name with its dot, or nothing; slashes and backslashes separate folders."""
    return PurePosixPath(name.replace("\\", "/")).suffix
