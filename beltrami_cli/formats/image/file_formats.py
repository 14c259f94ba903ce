"""Image formats: what their files and samples are, and how they are recognised."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import PurePosixPath

from beltrami_cli.errors import InputError


@dataclass(frozen=True)
class ImageFormat:
    """The files and samples of a format."""

    suffixes: tuple[str, ...]
    types: tuple[str, ...] = ("uint8",)
    channels: tuple[int, ...] = (1, 2, 3, 4)  # numbers of channels; 2 and 4 include alpha
    signatures: tuple[bytes, ...] = ()
    writable: bool = True  # without loss of what it holds

    @property
    def alpha(self) -> bool:
        return 4 in self.channels


def _netpbm(kinds: bytes) -> tuple[bytes, ...]:
    return tuple(b"P%c%c" % (kind, space) for kind in kinds for space in b" \t\r\n")


_ANY_TYPE = ("uint8", "uint16", "float16", "float32")  # types of samples
FORMATS = {
    "png": ImageFormat((".png",), ("uint8", "uint16"), signatures=(b"\x89PNG\r\n\x1a\n",)),
    "jpeg": ImageFormat((".jpg", ".jpeg", ".jpe", ".jfif"), ("uint8",), (1, 3), (b"\xff\xd8\xff",)),
    "webp": ImageFormat((".webp",), ("uint8",), (3, 4), (b"RIFF",)),
    "tiff": ImageFormat(
        (".tif", ".tiff", ".tx"), _ANY_TYPE, signatures=(b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
    ),
    "openexr": ImageFormat((".exr",), ("float16", "float32"), signatures=(b"v/1\x01",)),
    "targa": ImageFormat((".tga", ".targa", ".tpic"), ("uint8",)),
    "bmp": ImageFormat((".bmp", ".dib"), ("uint8",), (3,), (b"BM",)),  # most programs ignore an alpha in it
    "hdr": ImageFormat((".hdr", ".rgbe"), ("float32",), (3,), (b"#?",)),
    "jpegxl": ImageFormat((".jxl",), _ANY_TYPE, (1, 3, 4), (b"\xff\x0a", b"\0\0\0\x0cJXL \r\n\x87\n")),
    "pnm": ImageFormat((".pnm",), ("uint8", "uint16"), (1, 3)),  # one of the next two
    "ppm": ImageFormat((".ppm", ".pnm"), ("uint8", "uint16"), (3,), _netpbm(b"36")),
    "pgm": ImageFormat((".pgm", ".pnm"), ("uint8", "uint16"), (1,), _netpbm(b"25")),
    "pfm": ImageFormat((".pfm",), ("float32",), (1, 3), _netpbm(b"Ff")),
    "ktx2": ImageFormat((".ktx2",), ("uint8",), (3, 4), (b"\xabKTX 20\xbb",)),
    "avif": ImageFormat((".avif",), ("uint8",), (3, 4)),
    # What most of these hold (two levels, palettes, layers, blocks, several sizes) would not come back as it was; the
    # first six are rare, and with them their headers.
    "jpeg2000": ImageFormat((".jp2",), signatures=(b"\0\0\0\x0cjP  \r\n\x87\n",), writable=False),
    "j2k": ImageFormat((".j2k", ".j2c"), signatures=(b"\xff\x4f\xff\x51",), writable=False),
    "dpx": ImageFormat((".dpx",), signatures=(b"SDPX", b"XPDS"), writable=False),
    "sgi": ImageFormat((".sgi", ".rgb", ".rgba", ".bw"), signatures=(b"\x01\xda",), writable=False),
    "fits": ImageFormat((".fits", ".fit", ".fts"), signatures=(b"SIMPLE  =",), writable=False),
    "rla": ImageFormat((".rla",), writable=False),
    "pbm": ImageFormat((".pbm",), signatures=_netpbm(b"14"), writable=False),
    "gif": ImageFormat((".gif",), signatures=(b"GIF87a", b"GIF89a"), writable=False),
    "psd": ImageFormat((".psd", ".psb"), signatures=(b"8BPS",), writable=False),
    "dds": ImageFormat((".dds",), signatures=(b"DDS ",), writable=False),
    "ico": ImageFormat((".ico",), signatures=(b"\0\0\1\0",), writable=False),
    "iff": ImageFormat((".iff",), signatures=(b"FOR4",), writable=False),
    "cineon": ImageFormat((".cin",), signatures=(b"\x80\x2a\x5f\xd7", b"\xd7\x5f\x2a\x80"), writable=False),
    "softimage": ImageFormat((".pic",), signatures=(b"\x53\x80\xf6\x34",), writable=False),
    "zfile": ImageFormat((".z",), signatures=(b"\x2f\x08\x67\xab", b"\xab\x67\x08\x2f"), writable=False),
    "heif": ImageFormat((".heic", ".heif"), writable=False),
}
"""The formats by OpenImageIO's names, but for `plugin_of` some; for KTX2 and AVIF see `extra_codecs`."""
FORMATS_WITH_EXIF = ("png", "jpeg", "webp", "tiff")
"""Formats with a place for EXIF data, which also say how an image is turned."""
WRITABLE = tuple(traits.suffixes[0] for traits in FORMATS.values() if traits.writable)
"""The usual extensions of the formats that can be written."""
READABLE = "PNG, JPEG, WebP, TIFF, EXR, TGA, BMP, HDR and what else OpenImageIO knows is read"
_TARGA_FOOTER = b"TRUEVISION-XFILE.\0"
_HEIF_BRANDS, _AVIF_BRANDS = {b"heic", b"heix", b"mif1", b"msf1"}, {b"avif", b"avis"}
_MAX_BRANDS = 256  # bytes of them
_TEXTS = (".ply", ".obj", ".gltf", ".xyz", ".pts", ".txt", ".asc", ".csv", ".nhdr")
_HEAD = 512  # bytes, in which binary files have a zero
_WITHOUT_MARK = ("targa", "rla")


def format_of(data: bytes, name: str) -> str | None:
    """Return a key of `FORMATS` by the content; for TGA and RLA, which need not have a mark, also by the name."""
    for file_format, traits in FORMATS.items():
        if data.startswith(traits.signatures) and (file_format != "webp" or data[8:12] == b"WEBP"):
            return file_format
    if data[4:8] == b"ftyp":
        # The major brand, its version, and the brands that the file is compatible with.
        end = min(int.from_bytes(data[:4], "big"), _MAX_BRANDS, len(data))
        brands = {data[8:12], *(data[at : at + 4] for at in range(16, end, 4))}
        if brands & _AVIF_BRANDS:
            return "avif"
        if data[8:12] in _HEIF_BRANDS:
            return "heif"
    if data.endswith(_TARGA_FOOTER):
        return "targa"
    by_name = format_of_suffix(suffix_of(name))
    return by_name if by_name in _WITHOUT_MARK else None


def suffix_for(data: bytes, name: str) -> str:
    """Return the suffix of an image with its dot: its name's if that fits, else its format's, "" if unknown."""
    file_format, suffix = format_of(data, name), suffix_of(name).lower()
    if file_format is None:
        return ""
    return suffix if suffix in FORMATS[file_format].suffixes else FORMATS[file_format].suffixes[0]


def is_image(data: bytes, name: str) -> bool:
    """Whether a file is an image, and not the text of a model or cloud that starts like one."""
    is_text = b"\0" not in data[:_HEAD] and suffix_of(name).lower() in _TEXTS
    return not is_text and format_of(data, name) is not None


def format_of_suffix(suffix: str) -> str | None:
    """Return the format whose files have an extension (with the dot, in any case), or None."""
    return next(
        (file_format for file_format, traits in FORMATS.items() if suffix.lower() in traits.suffixes), None
    )


def plugin_of(file_format: str) -> str:
    """Return OpenImageIO's name of a format."""
    return {"j2k": "jpeg2000", **dict.fromkeys(("ppm", "pgm", "pfm", "pbm"), "pnm")}.get(
        file_format, file_format
    )


def label_of(file_format: str) -> str:
    """Return what users call a format."""
    return FORMATS[file_format].suffixes[0][1:].upper()


def damaged_image(name: str, file_format: str, reason: object) -> InputError:
    cause = f"the {label_of(file_format)} image is damaged or cut off ({str(reason)[:150]})"
    return InputError(name, cause, "export it again")


def suffix_of(name: str) -> str:
    """Return the extension of a file's name with its dot, or nothing; slashes and backslashes separate folders."""
    return PurePosixPath(name.replace("\\", "/")).suffix
