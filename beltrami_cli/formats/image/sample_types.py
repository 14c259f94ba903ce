"""The types of samples in images: stored ones, and single precision with a full scale of 1."""

from __future__ import annotations

import numpy as np

from beltrami_cli.arrays import Array, Float32s

TYPES = {"uint8": "uint8", "uint16": "uint16", "float16": "half", "float32": "float"}  # of OpenImageIO
STORED = {name: kind for kind, name in TYPES.items()}


def full_scale_one(pixels: Array) -> Float32s:
    """Return a copy of pixels in which the largest integer of their type is 1; floats stay as they are."""
    values = pixels.astype(np.float32)
    if pixels.dtype.kind != "f":
        values /= np.float32(np.iinfo(pixels.dtype).max)
    return values


def as_stored(values: Float32s, kind: str) -> Array:
    """Round values of full scale 1 to a type, clipped to its range; NaN becomes 0 in integers, halves are float32."""
    if kind == "float32":
        return values
    if kind == "float16":
        largest = np.finfo(np.float16).max
        return np.clip(values, -largest, largest).astype(np.float16).astype(np.float32)
    whole = np.clip(values, 0, 1).astype(np.float64)
    whole *= np.iinfo(kind).max
    np.rint(whole, out=whole)
    whole[np.isnan(whole)] = 0
    return whole.astype(kind)
