"""Undo of smoothed images. Blender's undo does not restore pixels, so the pixels of each step are kept in files."""

import tempfile
from pathlib import Path

import bpy
import numpy as np

from . import images

_STEP = "beltrami_step"  # property of an image: how often it was smoothed, which undo takes back
_kept = {}  # (name of an image, step) -> path
_shown = {}  # name of an image -> the step whose pixels it has
_folder = None


def remember(image, before):
    """Keep the pixels of an image before and after a step."""
    global _folder
    _folder = _folder or tempfile.TemporaryDirectory(prefix="beltrami-undo-")
    step = image.get(_STEP, 0)
    for number, pixels in ((step, before), (step + 1, images.pixels_of(image))):
        path = _kept.setdefault((image.name, number), Path(_folder.name) / f"{len(_kept)}.npy")
        np.save(path, pixels)
    image[_STEP] = _shown[image.name] = step + 1


@bpy.app.handlers.persistent
def follow_undo(*_):
    """Give images the pixels of the step that undo or redo went to."""
    for name, shown in list(_shown.items()):
        image = bpy.data.images.get(name)
        step = shown if image is None else image.get(_STEP, 0)
        if step != shown and (name, step) in _kept:
            images.set_pixels(image, np.load(_kept[name, step]))
            _shown[name] = step


@bpy.app.handlers.persistent
def forget(*_):
    """Drop what was kept of the images of a file that is closed."""
    global _folder
    _kept.clear()
    _shown.clear()
    if _folder is not None:
        _folder.cleanup()
        _folder = None
