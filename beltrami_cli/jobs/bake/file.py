"""Move the colours of a file from its vertices to a texture, or back."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from beltrami_cli.formats.access import EVERYTHING_INSIDE, Access
from beltrami_cli.formats.registry import open_document, sidecar_names, write_contents, write_textured
from beltrami_cli.jobs.bake.settings import DEFAULT_BAKE, BakeSettings, BakeTo
from beltrami_cli.jobs.writing.output import Output
from beltrami_cli.samples.memory_check import require_room_for_textures
from beltrami_cli.samples.selection import choose_format
from beltrami_cli.samples.settings.smooth import DEFAULTS

if TYPE_CHECKING:
    from collections.abc import Callable

    from beltrami_cli.formats.document import Document, Written


@dataclass(frozen=True)
class BakeReport:
    """What was done.

    Attributes
    ----------
    input, output, format : str
        Where from, where to, and the format written.
    counts : dict of str to int
        How many triangles, charts or coloured vertices were made; the keys are their names in the singular.
    texture : str
        What kind of texture was made, in words; empty if none was.
    written : list of str
        The files.
    warnings : list of str
        What the user should know.
    """

    input: str
    output: str
    format: str
    counts: dict[str, int]
    texture: str
    written: list[str]
    warnings: list[str]


def bake_file(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    to: BakeTo,
    settings: BakeSettings = DEFAULT_BAKE,
    *,
    format: str | None = None,  # noqa: A002 -- the name of the option
    overwrite: bool = False,
    progress: Callable[[str, int, int], None] | None = None,
    access: Access = EVERYTHING_INSIDE,
) -> BakeReport:
    """Write a new file whose colours are in a texture, or in the vertices.

    Parameters
    ----------
    source, target : path
        PLY, OBJ, glTF or GLB; "-" for standard input or output.
    to : {"texture", "vertices"}
        Where the colours go.
    settings : BakeSettings
        How a texture is made.
    format : {"ply", "obj", "glb", "gltf"}, optional
        Format to write where the name of `target` does not tell.
    overwrite : bool
        Whether existing files may be replaced.
    progress : callable, optional
        Called with a label, the work done so far and the work to do; may raise to stop.
    access : Access
        What may be read.

    Returns
    -------
    BakeReport

    Raises
    ------
    UsageError, InputError, ProcessingError, OutputError
        As `smooth_file`; nothing is written then.
    """
    source, target = os.fspath(source), os.fspath(target)
    output = Output(target, overwrite=overwrite)
    document = open_document(source, access)
    kind, stem = choose_format(document, target, format), Path(target).stem
    output.check_sidecars(sidecar_names(kind, stem, ".png" if to == "texture" else None))
    if to == "texture":
        written, counts, texture, notices = _to_texture(document, kind, stem, settings, progress)
    else:
        require_room_for_textures(document, ("baseColor",), DEFAULTS.textures, access)
        written, counts, notices = _to_vertices(document, kind, stem)
        texture = ""
    output.write(written)
    warnings = [*document.notices, *notices, *written.notices]
    return BakeReport(source, target, kind, counts, texture, [target, *written.sidecars], warnings)


def _to_texture(
    document: Document,
    kind: str,
    stem: str,
    settings: BakeSettings,
    progress: Callable[[str, int, int], None] | None,
) -> tuple[Written, dict[str, int], str, tuple[str, ...]]:
    from beltrami_cli.jobs.bake.from_vertices import texture_from_vertices

    made = texture_from_vertices(document, settings, progress)
    height, width, _ = made.pixels.shape
    counts = {"triangle": len(made.faces), **({} if made.charts is None else {"chart": made.charts})}
    depth = "an 8-bit" if made.pixels.itemsize == 1 else "a 16-bit"
    written = write_textured(made.mesh(made.encoded()), kind, stem)
    return written, counts, f"{depth} texture of {width} x {height}", made.notices


def _to_vertices(document: Document, kind: str, stem: str) -> tuple[Written, dict[str, int], tuple[str, ...]]:
    from beltrami_cli.jobs.bake.new_vertex_colours import vertex_colours_from_textures

    contents, notices = vertex_colours_from_textures(document)
    counts = {"coloured vertex": len(contents.positions), "triangle": len(contents.offsets) - 1}
    return write_contents(contents, kind, stem), counts, notices
