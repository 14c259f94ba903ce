"""The kernel of a pixel of an image."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.jobs.kernel.cells import find_cell, study_cell
from beltrami_cli.jobs.kernel.study import KernelStudy, Shown
from beltrami_cli.samples.images.prepare import prepare_image

if TYPE_CHECKING:
    from collections.abc import Callable

    from beltrami_cli.formats.access import Access
    from beltrami_cli.jobs.kernel.place import Place
    from beltrami_cli.samples.settings.smooth import SmoothSettings


def study_pixel(
    data: bytes,
    name: str,
    place: Place,
    settings: SmoothSettings,
    access: Access,
    progress: Callable[[int, int], None] | None = None,
) -> KernelStudy:
    """Study the kernel of a pixel after the iterations that the settings ask for.

    Parameters
    ----------
    data : bytes
        The image file.
    name : str
        Its name for messages.
    place : Place
        A pixel.
    settings : SmoothSettings
        As for smoothing.
    access : Access
        What may be read.
    progress : callable, optional
        Of the iterations before.

    Returns
    -------
    KernelStudy

    Raises
    ------
    UsageError, InputError
        If the place names no pixel that takes part, or as `prepare_image`.
    """
    prepared = prepare_image(data, name, settings, access)
    height, width = prepared.valid.shape
    column, row = place.pixel_of(width, height, name)
    flow = prepared.flow(settings)
    cell = find_cell(flow.manifold.atlas, 0, column, row, width, f"the pixel {column},{row} of {name}")
    flow.run(progress)
    kernel = flow.kernel_at(cell)
    y, x = np.divmod(
        flow.manifold.atlas.owned_texels[np.searchsorted(flow.manifold.atlas.owned_cells, kernel.samples)],
        width,
    )
    shown = Shown(prepared.colours.names, settings.space)
    facts: dict[str, object] = {"at": f"pixel {column},{row}"}
    unit = "pixel" if prepared.surface.positions is None else ""
    return study_cell(flow, kernel, shown, settings.kernel, facts, {"x": x, "y": y}, unit)
