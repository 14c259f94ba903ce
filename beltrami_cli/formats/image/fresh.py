"""A picture that comes from no file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from beltrami_cli.formats.image.picture import Picture

if TYPE_CHECKING:
    from numpy.typing import NDArray


def fresh_picture(pixels: NDArray[Any], name: str) -> Picture:
    """Describe new pixels as a PNG file without any metadata.

    Parameters
    ----------
    pixels : ndarray of uint8 or uint16, shape (H, W, 3) or (H, W, 4)
        sRGB values, and alpha that is not multiplied into them.
    name : str
        For messages.

    Returns
    -------
    Picture
        `write_image` can write it as any format.
    """
    import OpenImageIO

    height, width, channels = pixels.shape
    stored = "uint8" if pixels.dtype == "uint8" else "uint16"
    return Picture(
        name=name,
        pixels=pixels,
        channels=("R", "G", "B", "A")[:channels],
        colour=(0, 1, 2),
        alpha=3 if channels == 4 else None,
        encoding="srgb",
        stored=stored,
        kinds=(stored,) * channels,
        format="png",
        suffix=".png",
        notices=(),
        source=b"",
        spec=OpenImageIO.ImageSpec(width, height, channels, str(pixels.dtype)),
    )
