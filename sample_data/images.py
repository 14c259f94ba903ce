"""Image files: encoded through OpenImageIO, decoded again, and compared."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import OpenImageIO

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from textured import Texture

SUFFIX = {"png8": ".png", "png16": ".png", "jpeg": ".jpg", "exr": ".exr"}
MIME = {".png": "image/png", ".jpg": "image/jpeg"}
STORED = {"png8": "uint8", "png16": "uint16", "jpeg": "uint8", "exr": "half"}
ATTRIBUTES = {
    "png8": {"png:compressionLevel": 9},
    "png16": {"png:compressionLevel": 9},
    "jpeg": {"compression": "jpeg:95", "jpeg:subsampling": "4:2:0"},
    # Without a date of its own, the file would hold that of its making.
    "exr": {"compression": "zip", "DateTime": "2003:06:12 00:00:00"},
}


def encode(texture: Texture) -> bytes:
    """Return the texture as an image file, rounded once to its stored type."""
    pixels, kind = np.round(texture.pixels, 9), texture.kind
    if kind == "exr":
        stored = np.round(linear(np.maximum(pixels, 0)), 7).astype(np.float16)
    else:
        number = np.dtype(STORED[kind])
        stored = np.rint(np.clip(pixels, 0, 1) * np.iinfo(number).max).astype(number)
    height, width, channels = stored.shape
    spec = OpenImageIO.ImageSpec(width, height, channels, STORED[kind])
    for name, value in ATTRIBUTES[kind].items():
        spec[name] = value
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"image{SUFFIX[kind]}"
        output = OpenImageIO.ImageOutput.create(str(path))
        if output is None or not output.open(str(path), spec):
            raise SystemExit(f"{SUFFIX[kind]} cannot be written: {OpenImageIO.geterror()}")
        if not (output.write_image(np.ascontiguousarray(stored)) and output.close()):
            raise SystemExit(f"{SUFFIX[kind]} cannot be written: {output.geterror()}")
        return path.read_bytes()


def decode(data: bytes, suffix: str) -> NDArray[np.generic]:
    """Return the pixels of an image file in their stored type, shape (H, W, C).

    Raises
    ------
    ValueError
        If it is not an image of that kind.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"image{suffix}"
        path.write_bytes(data)
        image = OpenImageIO.ImageInput.open(str(path))
        if image is None:
            raise ValueError(OpenImageIO.geterror())
        spec = image.spec()
        pixels = image.read_image(0, 0, 0, spec.nchannels, spec.format)
        image.close()
        if pixels is None:
            raise ValueError(image.geterror())
    return np.asarray(pixels).reshape(spec.height, spec.width, spec.nchannels)


def same_image(one: bytes, other: bytes, suffix: str) -> bool:
    """Return whether two image files show the same, though another version of an encoder packed them.

    JPEG encoders may round differently: there a level of difference is allowed.
    """
    if one == other:
        return True
    try:
        a, b = decode(one, suffix), decode(other, suffix)
    except ValueError:
        return False
    allowed = 1 if suffix == ".jpg" else 0
    return a.shape == b.shape and a.dtype == b.dtype and float(np.abs(a.astype(float) - b).max()) <= allowed


def linear(display: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return linear light for sRGB display values."""
    return np.where(display <= 0.04045, display / 12.92, ((display + 0.055) / 1.055) ** 2.4)


def displayed(light: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return sRGB display values for linear light, not negative."""
    light = np.maximum(light, 0)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
