"""Images: every pixel through OpenImageIO, every byte of metadata carried over.

A file becomes a `DecodedImage` in `reading`, by what `file_formats`, `opening`, `sizes` and `channels` know. `writing`
makes a file of new pixels: as another format holds them (`conversion`), encoded (`encoding`), with `metadata`, which
`containers` read and write in each format. KTX2 and AVIF are coded by `extra_codecs`.
"""

from __future__ import annotations

from beltrami_cli.formats.image.conversion import losses
from beltrami_cli.formats.image.decoded_image import DecodedImage, is_unchanged, without_alpha
from beltrami_cli.formats.image.file_formats import (
    WRITABLE,
    format_of,
    format_of_suffix,
    is_image,
    label_of,
    suffix_for,
)
from beltrami_cli.formats.image.reading import read_image, read_texture
from beltrami_cli.formats.image.writing import check_writable, is_exact, write_image

__all__ = [
    "WRITABLE", "DecodedImage", "check_writable", "format_of", "format_of_suffix",
    "is_exact", "is_image", "is_unchanged", "label_of", "losses", "read_image", "read_texture", "suffix_for",
    "without_alpha", "write_image",
]  # fmt: skip
