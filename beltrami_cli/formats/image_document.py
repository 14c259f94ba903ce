"""Images as documents."""

from __future__ import annotations

from functools import cached_property
from typing import ClassVar, NoReturn

from beltrami_cli.errors import InputError
from beltrami_cli.formats.changes import Changes, Naming, Written
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.image import Picture, read_image


class ImageDocument(Document):
    """An image file, decoded on demand."""

    format: ClassVar[str] = "image"
    kind: ClassVar[str] = "image"

    @cached_property
    def _picture(self) -> Picture:
        return read_image(self.data, self.name, finite=False)

    def picture(self) -> Picture:
        return self._picture

    @property
    def _mesh(self) -> NoReturn:
        raise InputError(self.name, "it is an image, not a model")

    def facts(self) -> dict[str, object]:
        return {"format": self._picture.format, "bytes": len(self.data)}

    def _patched(self, new: Changes, naming: Naming) -> Written:
        return Written([image.content for image in new.images.values()] or [self.data])
