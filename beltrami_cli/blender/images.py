"""The pixels of images: in Blender, and as files that keep every value, PNG for bytes and EXR for floats."""

from pathlib import Path

import bpy
import numpy as np

from .errors import ExtensionError


def pixels_of(image):
    """Return the pixels as they are kept, shape (H, W, C), the lowest row first."""
    width, height = image.size
    values = np.empty(width * height * image.channels, np.float32)
    if not len(values):
        raise ExtensionError(f"the image {image.name} cannot be read")
    image.pixels.foreach_get(values)
    return values.reshape(height, width, image.channels)


def set_pixels(image, pixels):
    """Give an image new pixels; a packed one is packed again, without loss."""
    values = pixels_of(image)
    values[...] = pixels[..., : image.channels]
    image.pixels.foreach_set(values.ravel())
    image.update()
    if image.packed_file is not None:
        image.pack()


def _take_values_as_stored(image):
    image.colorspace_settings.name = "Non-Color"
    image.alpha_mode = "CHANNEL_PACKED"


def _suffix(image):
    return ".exr" if image.is_float else ".png"


def _format(image):
    return "OPEN_EXR" if image.is_float else "PNG"


def save_pixels(pixels, path, form, *, is_float):
    height, width, channels = pixels.shape
    filled = np.ones((height, width, 4), np.float32)
    filled[..., :channels] = pixels
    made = bpy.data.images.new("beltrami", width, height, alpha=True, float_buffer=is_float)
    _take_values_as_stored(made)
    try:
        made.pixels.foreach_set(filled.ravel())
        made.filepath_raw, made.file_format = str(path), form
        made.save()
    finally:
        bpy.data.images.remove(made)


def load_pixels(path):
    image = bpy.data.images.load(str(path))
    try:
        _take_values_as_stored(image)
        return pixels_of(image)
    finally:
        bpy.data.images.remove(image)


def write_tiles(image, folder, number):
    """Write an image, or every tile of it, to files; give the number of the tile, 0 for none, and the path."""
    if image.source != "TILED":
        path = folder / f"{number}{_suffix(image)}"
        save_pixels(pixels_of(image), path, _format(image), is_float=image.is_float)
        yield 0, path
        return
    # Only the first tile can be reached by its pixels; a copy of all on disk has the new pixels, too.
    tiles = folder / f"tiles{number}"
    tiles.mkdir()
    suffix = Path(bpy.path.abspath(image.filepath_raw)).suffix or _suffix(image)
    save_copy(image, tiles / f"tile.<UDIM>{suffix}")
    for source in sorted(tiles.iterdir()):
        tile = int(source.name.split(".")[1])
        path = folder / f"{number}-{tile}{_suffix(image)}"
        save_pixels(load_pixels(source), path, _format(image), is_float=image.is_float)
        yield tile, path


def save(image):
    """Save an image that lies on disk where it lies."""
    if image.is_float and image.file_format == "OPEN_EXR":  # which Blender 4.2 would encode as sRGB
        save_pixels(pixels_of(image), bpy.path.abspath(image.filepath), "OPEN_EXR", is_float=True)
        image.reload()
    else:
        image.save()


def save_copy(image, path):
    """Write an image, all tiles of it, and keep the path that it has."""
    stored_path = image.filepath_raw
    try:
        image.save(filepath=str(path), save_copy=True)
    except TypeError:  # before Blender 4.3
        image.save(filepath=str(path))
        image.filepath_raw = stored_path


def set_tiles(image, tiles):
    """Write new tiles to the files of an image and read them again; packed ones stay packed."""
    stored_path, is_packed = image.filepath_raw, bool(image.packed_files)
    place = bpy.path.abspath(stored_path)
    if is_packed or "<UDIM>" not in place:
        place = str(next(iter(tiles.values())).parent / f"new.<UDIM>{_suffix(image)}")
    form = _format(image) if is_packed else image.file_format
    for tile, path in tiles.items():
        save_pixels(load_pixels(path), place.replace("<UDIM>", str(tile)), form, is_float=image.is_float)
    if is_packed:
        image.unpack(method="REMOVE")
    image.filepath_raw = stored_path if place == bpy.path.abspath(stored_path) else place
    image.reload()
    if is_packed:
        image.pack()
        image.filepath_raw = stored_path
