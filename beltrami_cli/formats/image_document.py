"""Images as documents."""

from __future__ import annotations

from functools import cached_property
from typing import NoReturn

from beltrami_cli.errors import InputError
from beltrami_cli.formats.changes import Changes, Naming, Written
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.image.decoded_image import DecodedImage
from beltrami_cli.formats.image.reading import read_image


class ImageDocument(Document):
    """An image file, decoded on demand."""

    format = "image"
    kind = "image"

    @cached_property
    def _image(self) -> DecodedImage:
        return read_image(self.data, self.name, finite=False)

    def image(self) -> DecodedImage:
        return self._image

    @property
    def _mesh(self) -> NoReturn:
        raise InputError(self.name, "it is an image, not a model")

    def facts(self) -> dict[str, object]:
        return {"format": self._image.format, "bytes": len(self.data)}

    def _patched(self, new: Changes, naming: Naming) -> Written:
        return Written([image.content for image in new.images.values()] or [self.data])
