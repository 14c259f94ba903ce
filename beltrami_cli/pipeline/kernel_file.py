"""Study one kernel of a file, and write it to be looked at, or as numbers."""

from __future__ import annotations

import csv
import dataclasses
import io
import json
import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import UsageError
from beltrami_cli.formats.document import Written
from beltrami_cli.formats.source import open_document
from beltrami_cli.pipeline.kernel_picture import draw_mesh, draw_window
from beltrami_cli.pipeline.kernel_place import read_place
from beltrami_cli.pipeline.kernel_study import MeshView
from beltrami_cli.pipeline.output import Output
from beltrami_cli.pipeline.settings import DEFAULTS, IMAGE_SUFFIXES
from beltrami_cli.pipeline.work import choose_work

if TYPE_CHECKING:
    from collections.abc import Callable

    from beltrami_cli.formats.document import Document
    from beltrami_cli.pipeline.kernel_place import Place
    from beltrami_cli.pipeline.kernel_study import KernelStudy
    from beltrami_cli.pipeline.settings import SmoothSettings

_TABLES = (".csv", ".json", ".npz")


def kernel_file(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    at: str,
    settings: SmoothSettings = DEFAULTS,
    *,
    iteration: int = 1,
    whole: bool = False,
    overwrite: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, object]:
    """Write the geodesic distances and the weights of one kernel.

    Parameters
    ----------
    source : path
        What `smooth_file` reads; "-" for standard input.
    target : path
        Where to. By its extension: ``.ply``, a mesh coloured by the distance, with ``distance`` and ``weight`` at its
        vertices; an image, the painting, the distances and the weights side by side; ``.csv``, ``.json``, ``.npz``, the
        kernel's samples. "-" for standard output, as CSV.
    at : str
        Which sample's kernel: a vertex as its index or X,Y,Z; a texel as texture coordinates U,V or as Xpx,Ypx, after
        GLOB: if there are several textures; a pixel of an image as X,Y. Indices and pixels count from 0.
    settings : SmoothSettings
        As for smoothing; the number of iterations has no effect.
    iteration : int
        Which iteration the kernel is of, from 1; those before it are run.
    whole : bool
        Show the whole mesh, and not only what is around the kernel.
    overwrite : bool
        Whether an existing file may be replaced.
    progress : callable, optional
        Called with the work done so far and the work to do of the iterations before; may raise to stop.

    Returns
    -------
    dict
        What the kernel is like, in JSON types.

    Raises
    ------
    UsageError
        If `at` names no sample of the file, or the extension does not fit.
    InputError
        If the source cannot be read or holds no colours.
    OutputError
        If the target cannot be written.
    """
    source, target = os.fspath(source), os.fspath(target)
    if iteration < 1:
        raise UsageError(f"iteration is {iteration}, but must be 1 or more")
    suffix = ".csv" if target == "-" else Path(target).suffix.lower()
    if suffix not in (*_TABLES, *IMAGE_SUFFIXES, ".ply"):
        raise UsageError(
            f"{target}: a kernel is written as .ply, .png, .csv, .json or .npz; end the name in one"
        )
    place = read_place(at)
    output = Output(target, overwrite=overwrite, is_text=suffix == ".csv")
    kernel = dataclasses.replace(settings.kernel, iterations=iteration - 1)
    settings = dataclasses.replace(settings, kernel=kernel)
    document = open_document(source)
    study = _study(document, place, settings, whole=whole, progress=progress)
    facts = {"input": source, "output": target, **study.facts}
    output.write(_written(study, facts, suffix))
    return facts


def _study(
    document: Document,
    place: Place,
    settings: SmoothSettings,
    *,
    whole: bool,
    progress: Callable[[int, int], None] | None,
) -> KernelStudy:
    work = choose_work(document, settings)
    if work.vertices and not work.slots:
        from beltrami_cli.pipeline.kernel_vertices import study_vertex

        return study_vertex(document, place, settings, whole=whole, progress=progress)
    if work.vertices or len(work.slots) > 1:
        raise UsageError(
            f"{document.name}: a kernel is of one image; choose --on vertices, or --on texture and one of --slots"
        )
    from beltrami_cli.pipeline.kernel_texels import study_texel

    return study_texel(document, work.slots[0], place, settings, progress)


def _written(study: KernelStudy, facts: dict[str, object], suffix: str) -> Written:
    """Encode a study in the form that the extension asks for."""
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
    from beltrami_cli.formats.image.fresh import fresh_picture

    pixels = draw_window(view, study.radius)
    return Written([write_image(fresh_picture(pixels, str(facts["output"])), pixels, suffix=suffix).data])


def _as_csv(study: KernelStudy) -> str:
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(study.columns)
    rows.writerows(zip(*(values.tolist() for values in study.columns.values()), strict=True))
    return text.getvalue()
