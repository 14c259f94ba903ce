"""An image file as a document: a picture, and no model."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from beltrami_cli.errors import InputError
from beltrami_cli.formats.access import EVERYTHING_INSIDE, Access
from beltrami_cli.formats.document import NO_IMAGES, Document, Written
from beltrami_cli.formats.image.reading import read_image
from beltrami_cli.formats.image.recognition import format_of, label_of

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from typing import NoReturn

    import numpy as np
    from numpy.typing import NDArray

    from beltrami_cli.formats.document import Naming
    from beltrami_cli.formats.image.picture import Picture
    from beltrami_cli.surface.records import ImageFile, MovedVertices, Slot


class ImageDocument(Document):
    """An image, which is decoded when its picture is asked for."""

    format: ClassVar[str] = "image"

    def __init__(
        self, data: bytes, name: str, folder: Path | None = None, access: Access = EVERYTHING_INSIDE
    ) -> None:
        del folder, access  # it names no other files
        super().__init__(name)
        self.data = data

    @cached_property
    def _picture(self) -> Picture:
        return read_image(self.data, self.name, finite=False)

    def picture(self) -> Picture:
        """Return the decoded image; InputError if it is damaged."""
        return self._picture

    @property
    def suffix(self) -> str:
        """The extension that its name has, or else one of its format, with the dot."""
        return Path(self.name).suffix or f".{label_of(format_of(self.data, self.name) or '')}"

    def painted(self) -> NoReturn:
        """Raise: an image has no vertices."""
        raise InputError(self.name, "it is an image, and no model")

    def contents(self) -> NoReturn:
        """Raise: an image is no mesh."""
        raise InputError(self.name, "it is an image, and no model")

    def references(self) -> Sequence[str]:
        """Return nothing: an image names no other files."""
        return []

    def facts(self) -> dict[str, object]:
        """Return what the file is; InputError if it is damaged."""
        return {"format": self._picture.format, "bytes": len(self.data)}

    def patch(
        self,
        colours: NDArray[np.float32] | None,
        naming: Naming,
        *,
        images: Mapping[tuple[Slot, str], ImageFile] = NO_IMAGES,
        places: MovedVertices | None = None,
    ) -> Written:
        """Return the image that takes its place, or the file as it is."""
        del colours, naming, places
        return Written([image.data for image in images.values()] or [self.data])
