"""How a new texture is made, with the defaults; light enough for the command line to import."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from beltrami_cli.errors import UsageError

BakeTo = Literal["texture", "vertices"]
_SMALLEST, _LARGEST = 16, 16384  # sides of a texture: less is of no use, graphics cards take no more


@dataclass(frozen=True)
class BakeSettings:
    """How a new texture is made; UsageError if a value is out of its range."""

    # Longest side in texels. None: a texel is about half as long as an edge, or as large as in the old texture.
    size: int | None = None
    padding: int = 4  # texels between charts
    keep_uv: bool = False  # whether the texture coordinates of the file are used rather than new ones
    max_unwrap_faces: int = 100_000  # larger meshes are not unwrapped: the time grows faster than their size

    def __post_init__(self) -> None:
        if self.size is not None and not _SMALLEST <= self.size <= _LARGEST:
            raise UsageError(
                f"the size is {self.size}, but must be between {_SMALLEST} and {_LARGEST} texels"
            )
        if not 0 <= self.padding <= 64:
            raise UsageError(f"the padding is {self.padding}, but must be between 0 and 64 texels")
        if self.size is not None and self.size <= 4 * self.padding:
            raise UsageError(f"a size of {self.size} leaves no room between paddings of {self.padding}")
        if self.max_unwrap_faces < 1:
            raise UsageError("max_unwrap_faces must be 1 or more")


DEFAULT_BAKE = BakeSettings()
