"""Images: every pixel through OpenImageIO, every byte of metadata carried over."""

from __future__ import annotations

from functools import cached_property
from typing import ClassVar, NoReturn

from beltrami_cli.errors import InputError
from beltrami_cli.formats.document import Changes, Document, Naming, Written
from beltrami_cli.formats.image.picture import (
    WRITABLE,
    Picture,
    format_of,
    format_of_suffix,
    is_image,
    is_unchanged,
    label_of,
    suffix_for,
    to_float,
    without_alpha,
)
from beltrami_cli.formats.image.reading import read_image, read_texture
from beltrami_cli.formats.image.writing import check_writable, is_exact, losses, write_image

__all__ = [
    "WRITABLE", "ImageDocument", "Picture", "check_writable", "format_of", "format_of_suffix",
    "is_exact", "is_image", "is_unchanged", "label_of", "losses", "read_image", "read_texture", "suffix_for",
    "to_float", "without_alpha", "write_image",
]  # fmt: skip


class ImageDocument(Document):
    """An image, which is decoded when its picture is asked for."""

    format: ClassVar[str] = "image"
    kind: ClassVar[str] = "image"

    @cached_property
    def _picture(self) -> Picture:
        return read_image(self.data, self.name, finite=False)

    def picture(self) -> Picture:
        return self._picture

    @property
    def _mesh(self) -> NoReturn:
        raise InputError(self.name, "it is an image, and no model")

    def facts(self) -> dict[str, object]:
        return {"format": self._picture.format, "bytes": len(self.data)}

    def _patched(self, new: Changes, naming: Naming) -> Written:
        return Written([image.data for image in new.images.values()] or [self.data])
