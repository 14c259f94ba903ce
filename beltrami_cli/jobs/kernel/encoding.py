"""A kernel as a file: a mesh or a picture to be looked at, or numbers."""

from __future__ import annotations

import csv
import io
import json
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import UsageError
from beltrami_cli.formats.document import Written
from beltrami_cli.jobs.kernel.picture import draw_mesh, draw_window
from beltrami_cli.jobs.kernel.study import MeshView
from beltrami_cli.samples.settings.smooth import IMAGE_SUFFIXES

if TYPE_CHECKING:
    from beltrami_cli.jobs.kernel.study import KernelStudy

_TABLES = (".csv", ".json", ".npz")
SUFFIXES = (".ply", *IMAGE_SUFFIXES, *_TABLES)


def encode(study: KernelStudy, facts: dict[str, object], suffix: str) -> Written:
    """Encode a study in the form that an extension asks for.

    Parameters
    ----------
    study : KernelStudy
        The kernel.
    facts : dict
        Its facts, with the names of input and output.
    suffix : str
        One of `SUFFIXES`.

    Returns
    -------
    Written
        One file.

    Raises
    ------
    UsageError
        If a picture of the wrong kind is asked for.
    """
    if suffix == ".csv":
        return Written([_as_csv(study).encode()])
    if suffix == ".json":
        columns = {name: values.tolist() for name, values in study.columns.items()}
        return Written([(json.dumps({**facts, "columns": columns}, indent=2) + "\n").encode()])
    if suffix == ".npz":
        buffer = io.BytesIO()
        np.savez(buffer, allow_pickle=False, facts=json.dumps(facts), **study.columns)
        return Written([buffer.getvalue()])
    view = study.view
    if isinstance(view, MeshView) != (suffix == ".ply"):
        shown = ".ply" if isinstance(view, MeshView) else ".png"
        raise UsageError(
            f"{facts['output']}: the kernel of a {str(facts['at']).split()[0]} is drawn as {shown}, or written as "
            f"{', '.join(_TABLES)}"
        )
    if isinstance(view, MeshView):
        from beltrami_cli.formats.ply.scalar_writer import write_scalars_as_ply

        scalars = {"distance": view.distances, "weight": view.weights}
        comments = [f"kernel of {facts['at']}, beta {facts['beta']:.6g}, t {facts['t']:.6g}"]
        shades = draw_mesh(view, study.radius)
        return write_scalars_as_ply(view.positions, view.faces, shades, scalars, comments)
    from beltrami_cli.formats.image import write_image
    from beltrami_cli.formats.image.picture import new_picture

    pixels = draw_window(view, study.radius)
    return Written([write_image(new_picture(pixels, str(facts["output"])), pixels, suffix=suffix).data])


def _as_csv(study: KernelStudy) -> str:
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(study.columns)
    rows.writerows(zip(*(values.tolist() for values in study.columns.values()), strict=True))
    return text.getvalue()
