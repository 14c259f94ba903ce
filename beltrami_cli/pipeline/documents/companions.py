"""The files that belong to a model beside it, when it is written with other colours."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import TYPE_CHECKING

from beltrami_cli.formats.access import EVERYTHING_INSIDE, Access, read_regular
from beltrami_cli.mesh.textured import ImageFile
from beltrami_cli.pipeline.documents.conversion import make_files

if TYPE_CHECKING:
    from beltrami_cli.formats.document import Document, Written
    from beltrami_cli.pipeline.documents.work import Work
    from beltrami_cli.pipeline.settings.smooth import Format, SmoothSettings


def names_beside(
    document: Document,
    work: Work,
    settings: SmoothSettings,
    target_format: Format,
    target: str,
    references: list[str],
    *,
    moved: bool,
) -> set[str]:
    """Find the files that would be written beside the output, by writing the old images anew."""
    from beltrami_cli.pipeline.textures.prepare import choose_textures

    suffix = settings.textures.image_suffix
    images = {
        (slot, texture.key): ImageFile(texture.data, suffix or Path(texture.name).suffix.lower() or ".png")
        for slot in work.slots
        for texture in choose_textures(document.textured(slot), settings.textures).textures
    }
    written = make_files(document, None, images, target_format, Path(target).stem, moved=moved)
    return {*references, *written.sidecars}


def is_moved(source: str, target: str) -> bool:
    """Tell whether the output lies in another folder than the source."""
    if "-" in (source, target):
        return source != "-"
    return Path(source).resolve().parent != Path(os.path.realpath(target)).parent


def with_references(
    written: Written, folder: Path, references: list[str], access: Access = EVERYTHING_INSIDE
) -> Written:
    """Add the unchanged files that the model needs beside it in its new folder."""
    copied = {
        name: read_regular(folder / name, access) for name in references if name not in written.sidecars
    }
    return dataclasses.replace(written, sidecars={**written.sidecars, **copied})
