"""Study one kernel of a file, and write it to be looked at, or as numbers."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import TYPE_CHECKING

from beltrami_cli.errors import UsageError
from beltrami_cli.formats.access import EVERYTHING_INSIDE, Access, read_source
from beltrami_cli.formats.image.recognition import is_image
from beltrami_cli.jobs.kernel.encoding import SUFFIXES, encode
from beltrami_cli.jobs.kernel.place import read_place
from beltrami_cli.jobs.opening import document_from, refuse_options_of_level_sets
from beltrami_cli.jobs.writing.output import Output
from beltrami_cli.samples.memory_check import require_room_for_textures
from beltrami_cli.samples.selection import choose_work, require_scale
from beltrami_cli.samples.settings.smooth import DEFAULTS
from beltrami_cli.samples.vertices.guides import vertex_guides

if TYPE_CHECKING:
    from collections.abc import Callable

    from beltrami_cli.formats.document import Document
    from beltrami_cli.jobs.kernel.place import Place
    from beltrami_cli.jobs.kernel.study import KernelStudy
    from beltrami_cli.samples.settings.smooth import SmoothSettings


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
    access: Access = EVERYTHING_INSIDE,
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
    access : Access
        What may be read.

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
    if suffix not in SUFFIXES:
        raise UsageError(
            f"{target}: a kernel is written as .ply, .png, .csv, .json or .npz; end the name in one"
        )
    place = read_place(at)
    output = Output(target, overwrite=overwrite, is_text=suffix == ".csv")
    # What is restored of clipped colours comes after the averages of all iterations, and is none of them.
    kernel = dataclasses.replace(settings.kernel, iterations=iteration - 1, clipping="keep", free=())
    settings = dataclasses.replace(settings, kernel=kernel)
    data = read_source(source, access)
    if is_image(data, source):
        from beltrami_cli.jobs.kernel.pixels import study_pixel

        name = "<stdin>" if source == "-" else source
        refuse_options_of_level_sets(settings, name)
        study = study_pixel(data, name, place, settings, access, progress)
    else:
        document = document_from(data, source, settings, access)
        study = _study(document, place, settings, access, whole=whole, progress=progress)
    facts = {"input": source, "output": target, **study.facts}
    output.write(encode(study, facts, suffix))
    return facts


def _study(
    document: Document,
    place: Place,
    settings: SmoothSettings,
    access: Access,
    *,
    whole: bool,
    progress: Callable[[int, int], None] | None,
) -> KernelStudy:
    work = choose_work(document, settings)
    require_scale(document, work)
    if work.vertices and not work.slots:
        grid = document.grid()
        if grid is not None:
            from beltrami_cli.jobs.kernel.range import study_range

            guides = vertex_guides(document, settings, access)
            return study_range(document.painted(), grid, document.name, place, settings, progress, guides)
        from beltrami_cli.jobs.kernel.vertices import study_vertex

        return study_vertex(document, place, settings, whole=whole, progress=progress, access=access)
    if work.vertices or len(work.slots) > 1:
        raise UsageError(
            f"{document.name}: a kernel is of one image; choose --on vertices, or --on texture and one of --slots"
        )
    require_room_for_textures(document, work.slots, settings.textures, access)
    from beltrami_cli.jobs.kernel.texels import study_texel

    return study_texel(document, work.slots[0], place, settings, progress, access)
