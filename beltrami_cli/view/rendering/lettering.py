"""Words in pictures, in the typeface that OpenImageIO brings with it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.errors import ProcessingError

if TYPE_CHECKING:
    from numpy.typing import NDArray

_FONT = "DroidSans"
_ELLIPSIS = "..."


def lettering(text: str, size: tuple[int, int], height: int) -> NDArray[np.float32]:
    """Write a line of text in the middle of a strip.

    Parameters
    ----------
    text : str
        What is longer than the strip loses its beginning: names of files differ at their end.
    size : (int, int)
        Width and height of the strip, in pixels.
    height : int
        Size of the letters, in pixels.

    Returns
    -------
    ndarray of float32, shape (height, width)
        How much of each pixel the letters cover, 0 to 1.

    Raises
    ------
    ProcessingError
        If this build of OpenImageIO has no typeface.
    """
    import OpenImageIO

    words, start = text, 0
    box = _measured(words, height)
    while box.width > 0.96 * size[0] and start < len(text):
        start += 1
        words = _ELLIPSIS + text[start:]
        box = _measured(words, height)
    strip = OpenImageIO.ImageBuf(OpenImageIO.ImageSpec(*size, 1, "float"))
    x = (size[0] - box.width) // 2 - box.xbegin
    y = round(size[1] / 2 + 0.36 * height)  # the base line; small letters and capitals look centred
    if not OpenImageIO.ImageBufAlgo.render_text(strip, x, y, words, height, _FONT, (1.0,)):
        raise ProcessingError(f"labels cannot be drawn ({strip.geterror()}); use --no-labels")
    return np.clip(np.asarray(strip.get_pixels(OpenImageIO.FLOAT), np.float32)[..., 0], 0, 1)


def _measured(text: str, height: int) -> Any:
    import OpenImageIO

    return OpenImageIO.ImageBufAlgo.text_size(text, height, _FONT)
