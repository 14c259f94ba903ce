"""The format of an output: chosen by its name, and the files that a mesh or an image has in it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from beltrami_cli.errors import UsageError
from beltrami_cli.formats.changes import Written
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.image.file_formats import FORMATS, WRITABLE, format_of, format_of_suffix
from beltrami_cli.formats.loading import mesh_writer
from beltrami_cli.formats.meshes.writing import image_names, with_slots
from beltrami_cli.formats.registry import KEPT_FORMATS, OUTPUT_FORMATS, READ_ONLY, WRITERS, Format
from beltrami_cli.surface.records import MeshContents


@dataclass(frozen=True)
class OutputFormat:
    name: str
    # Whether the document is patched, and keeps everything but its colours; otherwise it is converted.
    is_patched: bool
    suffix: str | None = None  # with its dot, if an image is written in another format


def choose_format(document: Document, target: str, chosen: str | None) -> OutputFormat:
    """Choose the output format by option, by the output's name, or as the source; UsageError if it is unknown."""
    if document.kind == "image":
        return _image_format(document, target, chosen)
    wanted = chosen or Path(target).suffix.lower().lstrip(".")
    usual = OUTPUT_FORMATS.get(document.format, document.format if document.forms else "ply")
    if wanted in OUTPUT_FORMATS:
        name = OUTPUT_FORMATS[wanted]
    elif wanted in document.forms:
        name = wanted
    elif target == "-" or not wanted:
        name = usual
    elif (image := format_of_suffix(f".{wanted}")) is not None:
        cause = f".{wanted} is an image format, but {document.name} is a model"
        drawing = target if FORMATS[image].writable else Path(target).with_suffix(".png")
        drawn = f"beltrami render {document.name} {drawing} draws it"
        raise UsageError(f"{cause}; {drawn}, or end the name in .{usual}", target)
    else:
        known = ", ".join("." + f for f in OUTPUT_FORMATS)
        cause = f"no format is known for .{wanted}"
        if wanted in READ_ONLY:
            why = ": the STL format has no colours" if wanted == "stl" else ""
            cause = f".{wanted} files are read, but not written{why}"
        elif wanted in KEPT_FORMATS:
            cause = f"a .{document.format} file is not converted to .{wanted}"
        raise UsageError(f"{cause}; end the name in {known}, or say --format", target)
    return OutputFormat(name, is_patched=name in (document.format, *document.forms))


def _image_format(document: Document, target: str, chosen: str | None) -> OutputFormat:
    suffix = f".{chosen}" if chosen else "" if target == "-" else Path(target).suffix
    if suffix and format_of_suffix(suffix) is None:
        is_model = suffix[1:].lower() in (*OUTPUT_FORMATS, *READ_ONLY)
        cause = f"no image format is known for {suffix}"
        if is_model:
            cause = f"{document.name} is an image, not a model"
        raise UsageError(f"{cause}; end the name in {', '.join(WRITABLE)}, or say --format", target)
    own = format_of(document.data, document.name)
    assert own is not None  # by which it was recognised
    if not suffix or suffix.lower() in FORMATS[own].suffixes:
        own_suffix = Path(document.name).suffix or FORMATS[own].suffixes[0]
        return OutputFormat(own_suffix.lower()[1:], is_patched=True)
    return OutputFormat(suffix.lower()[1:], is_patched=True, suffix=suffix)


def _writer(form: str) -> Format:
    if form not in WRITERS:
        cause = f".{form} files are not made from a new mesh"
        raise UsageError(f"{cause}; end the name of the output in .glb, .obj or .ply")
    return WRITERS[form]


def _fitted(mesh: MeshContents, line: Format) -> MeshContents:
    """Leave out the maps that a new file cannot hold."""
    return with_slots(mesh, line.slots) if line.slots else mesh


def write_mesh(mesh: MeshContents, form: str, stem: str) -> Written:
    """Write a mesh as a new file; UsageError if the format cannot hold its textures."""
    line = require_textures(form) if mesh.materials else _writer(form)
    mesh = _fitted(mesh, line)
    for image in mesh.images:
        require_textures(form, image.file.suffix)
    assert line.writer is not None  # or else `_writer` had refused it
    written = mesh_writer(line.writer)(mesh, stem)
    return replace(written, notices=(*mesh.notices, *written.notices))


def sidecars_of_mesh(mesh: MeshContents, form: str, stem: str) -> list[str]:
    """Return the names of the sidecar files of `write_mesh`; images have the suffixes of `with_suffixes`."""
    line = _writer(form)
    images = image_names(_fitted(mesh, line), stem, line.images) if mesh.materials else None
    return _sidecar_names(line, stem, images)


def usual_sidecars(form: str, stem: str, image_suffix: str | None) -> list[str]:
    """Return the names of the sidecar files of `write_mesh` for a mesh with one image, or without."""
    line = _writer(form) if image_suffix is None else require_textures(form, image_suffix)
    return _sidecar_names(line, stem, None if image_suffix is None else [stem + image_suffix])


def _sidecar_names(line: Format, stem: str, images: list[str] | None) -> list[str]:
    suffixes = line.sidecars if images is None else line.textured_sidecars
    return [name for suffix in suffixes for name in (images or [] if suffix == ".*" else [stem + suffix])]


def image_suffixes(form: str) -> tuple[str, ...] | None:
    """Return the suffixes of the textures that a format can hold, empty for any; None: it has no textures."""
    line = _writer(form)
    return line.images if line.has_textures else None


def require_textures(form: str, image_suffix: str | None = None) -> Format:
    """Return a format; UsageError if it cannot hold textures, or textures with this suffix."""
    line = _writer(form)
    if not line.has_textures:
        raise UsageError(f"a .{form} file has no textures; end the name of the output in .glb, .obj or .ply")
    if line.images and image_suffix is not None and image_suffix not in line.images:
        cause = f"a .{form} file takes PNG and JPEG textures, not {image_suffix}"
        raise UsageError(f"{cause}; choose --texture-format png or jpg")
    return line
