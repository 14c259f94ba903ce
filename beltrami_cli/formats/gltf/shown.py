"""The images that a surface shows in one slot, collected while its triangles are."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from beltrami_cli.formats.model_folder import UnfitReferenceError
from beltrami_cli.surface.records import Texture

if TYPE_CHECKING:
    from beltrami_cli.formats.gltf.materials import Painting
    from beltrami_cli.formats.gltf.pictures import Pictures
    from beltrami_cli.surface.records import Slot, Wrap


def key_of(image: int) -> str:
    """Return the key under which an image is handed out."""
    return f"image {image}"


@dataclass
class _Use:
    """An image that the surface shows: its file, and who uses it."""

    number: int
    data: bytes
    wraps: list[tuple[Wrap, Wrap]] = field(default_factory=list)
    materials: list[str] = field(default_factory=list)
    hides: bool = False


class Shown:
    """Images of one slot.

    Parameters
    ----------
    pictures : Pictures
        All images of the file.
    slot : Slot
        The slot, for messages.
    """

    def __init__(self, pictures: Pictures, slot: Slot) -> None:
        self._pictures, self._slot = pictures, slot
        self._uses: dict[int, _Use] = {}
        self._missing: dict[str, list[str]] = {}

    def __len__(self) -> int:
        return len(self._uses)

    def image(self, painting: Painting) -> int | None:
        """Return the image of a painting; None, and the reason is kept, if it cannot be shown."""
        place = self._pictures.textures[painting.texture].place
        try:
            image = self._pictures.canonical(self._pictures.shown(painting.texture))
            if image not in self._uses:
                place = self._pictures.images[image].place
                self._uses[image] = _Use(len(self._uses), self._pictures.data(image))
        except UnfitReferenceError as error:
            materials = self._missing.setdefault(f"{place}: {error}", [])
            if painting.material not in materials:
                materials.append(painting.material)
            return None
        return image

    def use(self, image: int, painting: Painting) -> int:
        """Take down that a painting shows an image; return the texture's number."""
        use = self._uses[image]
        use.wraps.append(self._pictures.wrap(painting.texture))
        use.hides |= painting.alpha_hides
        if painting.material not in use.materials:
            use.materials.append(painting.material)
        return use.number

    def textures(self) -> tuple[Texture, ...]:
        """Return the images in the order of their numbers."""
        return tuple(
            Texture(
                key=key_of(image),
                name=self._pictures.name(image),
                data=use.data,
                materials=tuple(use.materials),
                wrap=use.wraps[0],
                alpha_hides=use.hides,
            )
            for image, use in self._uses.items()
        )

    def excuse(self) -> str | None:
        """Return why an image cannot be shown, if there is such an image."""
        if not self._missing:
            return None
        return f"its {self._slot} texture cannot be read: {next(iter(self._missing))}"

    def notices(self) -> list[str]:
        """Return what the user should know."""
        left = [
            f"The {self._slot} texture of {', '.join(map(repr, materials))} is left as it is: {reason}."
            for reason, materials in self._missing.items()
        ]
        mixed = [
            f"The {self._slot} image {self._pictures.name(image)!r} is used with several wrap modes; the first is "
            "followed."
            for image, use in self._uses.items()
            if len(set(use.wraps)) > 1
        ]
        return left + mixed
