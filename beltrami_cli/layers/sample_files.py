"""Numbers for each sample from files: tables for vertices, images for pixels; and known noise from these."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from beltrami_cli.arrays import Bools, Float32s, Float64s, Int64s
from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.files.access import Access, read_source
from beltrami_cli.formats.image.decoded_image import DecodedImage
from beltrami_cli.formats.image.reading import read_image
from beltrami_cli.formats.image.sample_types import full_scale_one
from beltrami_cli.formats.registry import open_document
from beltrami_cli.layers.image_memory import require_memory
from beltrami_cli.surface.precision import require_single

_MAX_NUMBERS = 1 << 31  # of an array, before it is known that it fits
_ONE_ROW_REMEDY = "it needs one row for each coloured vertex, in the order of the file"
# Side in pixels of the squares in which the deviation of a frame is measured: 289 pixels determine it to 4 %.
_FRAME_WINDOW = 17


def read_table(path: str, document: Document) -> Float64s:
    """Read numbers for the vertices of a document, shape (V, G): an array, an archive of one, or vertex colours."""
    from beltrami_cli.formats.files.numpy_files import NPY_MAGIC, NpzArchive, is_npz, read_npy

    access, rows = document.access, len(document.coloured_vertices().positions)
    data = read_source(path, access)
    if data[: len(NPY_MAGIC)] == NPY_MAGIC:
        table = read_npy(data, path)
    elif is_npz(data) and (archive := NpzArchive(data, path)).kind() != "points":
        if len(archive.names) != 1:
            which = ", ".join(archive.names)
            raise InputError(path, f"which of its arrays {which} is meant is not clear", "save it alone")
        table = archive.array(archive.names[0], _MAX_NUMBERS)
    else:
        # The given columns belong to the points that are smoothed, not to a guide.
        guide = open_document(path, dataclasses.replace(access, columns=(), channels=()), data)
        table = guide.coloured_vertices().colours
    if table.ndim == 1:
        table = table[:, None]
    if table.ndim != 2 or table.shape[0] != rows or not table.shape[1]:
        shape = " x ".join(map(str, table.shape))
        raise InputError(
            path, f"its {shape} numbers do not fit the {rows} vertices of {document.name}", _ONE_ROW_REMEDY
        )
    numbers = table.astype(np.float64)
    require_single(numbers, path, "its row")
    return numbers


def read_map(path: str, target: DecodedImage, access: Access) -> Float32s:
    """Read numbers for the pixels of an image, shape (H * W, G)."""
    image = read_of_size(path, target, access, "recoloured")
    channels = [i for i in range(image.pixels.shape[2]) if i != image.alpha]
    numbers = np.asarray(full_scale_one(image.pixels[..., channels]), np.float32)
    return numbers.reshape(-1, numbers.shape[2])


def read_of_size(path: str, target: DecodedImage, access: Access, work: str) -> DecodedImage:
    """Read an image with the size of another; `work`: see `require_memory`."""
    data = read_source(path, access)
    require_memory([(path, data)], access, work)
    image = read_image(data, path, finite=False)
    (rows, columns), size = image.pixels.shape[:2], target.pixels.shape[:2]
    if (rows, columns) != size:
        cause = f"its {columns} x {rows} pixels do not fit the {size[1]} x {size[0]} of {target.name}"
        raise InputError(path, cause, "both must have the same size, pixel by pixel")
    return image


def noise_of_pixels(
    kernel: KernelParameters, images: Sequence[DecodedImage], pixels: Int64s | Bools, access: Access
) -> Float32s | None:
    """Read the standard deviations of all pixels, one row per pixel; None if no file is given."""
    given = kernel.given_noise
    if given is None or not given.source:
        return None
    if given.kind == "attribute":
        raise UsageError(f"noise is of the attribute {given.source}, which only vertices have; name an image")
    if len(images) != 1:
        cause = f"{given.source} is the noise of one of {len(images)} textures; choose it by --texture"
        raise UsageError(cause)
    rows = read_map(given.source, images[0], access)
    if given.kind == "frame":
        frame = rows.reshape(*images[0].pixels.shape[:2], -1)
        rows = deviation_in_frame(frame).reshape(rows.shape)
    _require_deviations(rows[pixels], given.source, "pixel")
    return rows


def noise_of_vertices(kernel: KernelParameters, document: Document) -> Float32s | None:
    """Read the standard deviations of vertices, shape (V, K); None if neither file nor attribute is given."""
    given = kernel.given_noise
    if given is None or not given.source:
        return None
    if given.kind == "frame":
        cause = f"{given.source} is a frame of pixels, but vertices are smoothed; name their deviations"
        raise UsageError(cause)
    is_attribute = given.kind == "attribute"
    values = document.attribute(given.source) if is_attribute else read_table(given.source, document)
    _require_deviations(values, given.source, "vertex")
    return values.astype(np.float32)


def deviation_in_frame(frame: Float32s) -> Float32s:
    """Return the local standard deviation of a frame without a scene, (H, W, K); its light may fall off."""
    from scipy.ndimage import uniform_filter

    size = (_FRAME_WINDOW, _FRAME_WINDOW, 1)
    residual = frame - uniform_filter(frame, size, mode="reflect")
    return np.asarray(np.sqrt(uniform_filter(np.square(residual), size, mode="reflect").clip(0)), np.float32)


def _require_deviations(deviations: Float32s | Float64s, name: str, row: str) -> None:
    require_single(deviations, name, f"its {row}")
    low, high = deviations.min(initial=0), deviations.max(initial=0)
    if low < 0 or high > 1:
        extreme = f"down to {low:g}" if low < 0 else f"up to {high:g}"
        cause = f"its values go {extreme}, but standard deviations are from 0 to a full scale of 1"
        raise InputError(name, cause, "divide them by 255 if they are of 255")
