"""Which parts of a document are painted, as which layers, and in which format the document is written."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.arrays import Float64s, Int32s
from beltrami_cli.errors import InputError, UnpaintedError, UsageError
from beltrami_cli.fields import given_options
from beltrami_cli.formats.access import Access
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.image.picture import WRITABLE, format_of, format_of_suffix, label_of
from beltrami_cli.formats.image.reading import measure_image
from beltrami_cli.formats.model_folder import LEFT_ALONE, remedy_for
from beltrami_cli.formats.registry import KEPT_FORMATS, OUTPUT_FORMATS, is_only_read
from beltrami_cli.layers.layer import Layer
from beltrami_cli.layers.settings import SLOTS, SmoothSettings, TextureSettings
from beltrami_cli.layers.texel_colours import choose_textures
from beltrami_cli.layers.texture_groups import separate_surfaces
from beltrami_cli.layers.texture_layer import TextureLayer
from beltrami_cli.surface.geometry import coarse_rounding
from beltrami_cli.surface.records import Slot, check_scale

if TYPE_CHECKING:
    from beltrami_cli.layers.vertex_layer import PaintedLayer


@dataclass(frozen=True)
class Selection:
    """The painted parts of a document: its vertex colours, the textures of slots, or the image itself."""

    vertices: bool = False
    slots: tuple[Slot, ...] = ()
    image: bool = False
    notices: tuple[str, ...] = ()


NOTHING = Selection()
_TEXELS_OF_A_VERTEX = 6  # texels that take as long as a vertex


@dataclass(frozen=True)
class OutputFormat:
    """A format to write."""

    name: str
    is_patched: (
        bool  # the output keeps all that the document holds besides colours; otherwise it is converted
    )
    suffix: str | None = None  # of another image format, with its dot


def select(document: Document, settings: SmoothSettings) -> Selection:
    """Choose the painted parts by the settings and the document; errors if there are none, or for unfit options."""
    if document.kind == "image":
        from beltrami_cli.layers.image_surface import refuse_options_of_meshes

        refuse_options_of_meshes(settings, document.name)
        return Selection(image=True)
    if wrong := given_options(settings.image):
        raise UsageError(f"{', '.join(wrong)}: for images only, but {document.name} is none; leave it out")
    present = document.slots()
    slots = tuple(slot for slot in present if slot in settings.textures.slots)
    wanted = settings.textures.slots
    if not slots and settings.on != "vertices" and wanted and "baseColor" not in wanted:
        raise _no_such_textures(document, present, wanted)
    coloured = settings.on != "texture" and document.has_vertex_colours()
    if settings.on == "auto":
        slots = document.readable(slots)
    if settings.on == "vertices" or (settings.on == "auto" and not slots and coloured):
        if not coloured:
            document.painted()  # raises an error with what there is instead
        return Selection(vertices=True)
    if settings.on == "both" and not (coloured and slots):
        missing = "vertex colours" if slots else "textures in the chosen slots"
        raise InputError(document.name, f"it has no {missing}", "use --on auto")
    if not slots:
        raise _nothing_to_smooth(document, present, textures_only=settings.on == "texture")
    slots = _with_chosen_textures(document, slots, settings)
    absent = (
        [] if wanted == SLOTS else [f"it has no {slot} textures" for slot in wanted if slot not in present]
    )
    both = settings.on == "both"
    if coloured and not both:
        absent.append("its vertex colours stay as they are; --on both smooths them too")
    return Selection(vertices=both, slots=slots, notices=tuple(absent))


def layers_of(
    document: Document,
    selection: Selection,
    settings: SmoothSettings,
    access: Access,
    suffix: str | None = None,
    *,
    colours_only: bool = False,
    in_groups: bool = False,
) -> Iterator[Layer]:
    """Give the selected layers; `in_groups`: textures that do not touch separately."""
    # For the other parameters see `ImageLayer`.
    if document.kind == "image":
        if selection.image:
            from beltrami_cli.layers.image_layer import ImageLayer

            yield ImageLayer.read(document, settings, access, suffix=suffix, colours_only=colours_only)
        return
    if selection.vertices:
        yield vertex_layer(document, settings, access)
    chosen = [choose_textures(document.textured(slot), settings.textures) for slot in selection.slots]
    counts = Counter(texture.key for surface in chosen for texture in surface.textures)
    shared = frozenset(key for key, count in counts.items() if count > 1)
    for slot, surface in zip(selection.slots, chosen, strict=True):
        parts = separate_surfaces(surface, settings.kernel) if in_groups else [surface]
        for number, part in enumerate(parts, 1):
            whole, name = (document, access), f"part {number} of {len(parts)}" if len(parts) > 1 else ""
            yield TextureLayer.read(part, slot, settings, guided=whole, shared=shared, part=name)


def count_samples(document: Document, selection: Selection, wanted: TextureSettings) -> list[int]:
    """Estimate how many texels take as long as each selected layer, without decoding an image."""
    counts = []
    if selection.image:
        size = measure_image(document.data, document.name)
        counts.append(0 if size is None else size.texels)
    if selection.vertices:
        counts.append(_TEXELS_OF_A_VERTEX * len(document.painted().colours))
    for slot in selection.slots:
        surface = choose_textures(document.textured(slot), wanted)
        sizes = [measure_image(texture.data, texture.name) for texture in surface.textures]
        texels = np.array([0 if size is None else size.texels for size in sizes] + [0], np.float64)
        (a, b), (c, d) = np.moveaxis(np.diff(surface.uv, axis=1), 0, 2)
        areas = np.nan_to_num(np.abs(a * d - b * c) / 2)
        areas = np.bincount(surface.texture_of % len(texels), areas, len(texels))
        counts.append(int((texels * np.minimum(areas, 1)).sum()))
    return counts


def vertex_layer(document: Document, settings: SmoothSettings, access: Access) -> PaintedLayer:
    """Take the coloured vertices of a model: on a mesh, on their own, on a grid, or on a level set."""
    from beltrami_cli.layers.guides import noise_of_vertices, vertex_guides
    from beltrami_cli.layers.image_surface import options_of_meshes
    from beltrami_cli.layers.vertex_layer import GridLayer, VertexLayer

    painted, grid = document.painted(), document.grid()
    guides = vertex_guides(document, settings, access)
    noise = noise_of_vertices(settings.kernel, document, access)
    if grid is None:
        in_triangles = document.kind == "volume"
        return VertexLayer(
            painted=painted, settings=settings, guides=guides, noise=noise, in_triangles=in_triangles
        )
    if wrong := options_of_meshes(settings):
        cause = f"{', '.join(wrong)}: not on range images, whose vertices lie on a grid; leave it out"
        raise UsageError(cause)
    return GridLayer(painted=painted, grid=grid, settings=settings, guides=guides, noise=noise)


def require_geometry(
    document: Document, selection: Selection, settings: SmoothSettings, target: OutputFormat
) -> None:
    """Raise errors if positions are to be smoothed, but there are none, or the format cannot store them."""
    if not settings.embedding.smooth_geometry:
        return
    if not selection.vertices:
        raise UsageError(
            f"{document.name}: --smooth-geometry moves vertices along with their colours, but only textures are "
            "smoothed; choose --on vertices or --on both"
        )
    if document.grid() is not None or not len(document.painted().faces):
        raise InputError(document.name, "it has no triangles, so there is no geometry to smooth")
    if target.is_patched:
        document.require_movable()


def require_scale(document: Document, selection: Selection) -> None:
    """Raise InputError if distances on the selected samples cannot be computed; say if positions are too coarse."""
    meshes = list[tuple[Float64s, Int32s]]()
    if selection.vertices:
        painted = document.painted()
        meshes.append((painted.positions, painted.faces))
    for slot in selection.slots:
        surface = document.textured(slot)
        meshes.append((surface.positions, surface.faces[surface.texture_of >= 0]))
    for mesh in meshes:
        check_scale(*mesh, document.name)
        document.notices += [each for each in coarse_rounding(*mesh) if each not in document.notices]


def _no_such_textures(document: Document, present: Sequence[Slot], wanted: Sequence[str]) -> InputError:
    kinds = f"{', '.join(present)} textures" if present else "no textures at all"
    cause = f"it has no {' or '.join(wanted)} textures, but {kinds}"
    remedy = f"give --slots {present[0]}" if present else "leave out --slots"
    return UnpaintedError(document.name, cause, remedy)


def _nothing_to_smooth(document: Document, present: Sequence[Slot], *, textures_only: bool) -> InputError:
    """Return the error that there are no colours of the requested kind, or that they are damaged."""
    why = ""
    if textures_only and not present and document.has_vertex_colours():
        return UnpaintedError(document.name, "it has no textures, only vertex colours", "use --on vertices")
    try:
        document.painted()
    except UnpaintedError as error:
        why = error.cause
    except InputError as error:
        return error
    kinds = "no textures" if textures_only else "neither vertex colours nor textures"
    cause = f"it has {kinds} to smooth"
    if present:
        cause = f"{cause}, but textures in the slots {', '.join(present)}"
        return UnpaintedError(document.name, cause, f"give --slots {present[0]}")
    reason = document.notices[0] if document.notices else why
    reason = reason.removesuffix(LEFT_ALONE).rstrip(".")
    return UnpaintedError(document.name, cause + (f" ({reason})" if reason else ""), remedy_for(reason))


def _with_chosen_textures(
    document: Document, slots: tuple[Slot, ...], settings: SmoothSettings
) -> tuple[Slot, ...]:
    wanted = settings.textures
    if not (wanted.names or wanted.materials):
        return slots
    kept = tuple(slot for slot in slots if choose_textures(document.textured(slot), wanted).textures)
    if not kept:
        textures = [texture for slot in slots for texture in document.textured(slot).textures]
        names = ", ".join(sorted({texture.name for texture in textures}))
        materials = ", ".join(sorted({name for texture in textures for name in texture.materials}))
        raise UsageError(
            f"{document.name}: no texture fits the globs; there are {names}"
            + (f", in the materials {materials}" if wanted.materials else "")
        )
    return kept


def choose_format(document: Document, target: str, chosen: str | None) -> OutputFormat:
    """Choose the format to write, by option, by the output's name, or as the source; UsageError if it is unknown."""
    if document.kind == "image":
        return _image_format(document, target, chosen)
    wanted = chosen or Path(target).suffix.lower().lstrip(".")
    if wanted in OUTPUT_FORMATS:
        name = OUTPUT_FORMATS[wanted]
    elif wanted in document.forms:
        name = wanted
    elif target == "-" or not wanted:
        name = OUTPUT_FORMATS.get(document.format, document.format if document.forms else "ply")
    elif format_of_suffix(f".{wanted}") is not None:
        cause = f".{wanted} is an image format, but {document.name} is a model"
        drawn = f"beltrami render {document.name} {target} draws it"
        raise UsageError(f"{target}: {cause}; {drawn}, or end the name in .{document.format}")
    else:
        known = ", ".join("." + f for f in OUTPUT_FORMATS)
        cause = f"no format is known for .{wanted}"
        if is_only_read(wanted):
            why = ": the STL format has no colours" if wanted == "stl" else ""
            cause = f".{wanted} files are read, but not written{why}"
        elif wanted in KEPT_FORMATS:
            cause = f"a .{document.format} file is not converted to .{wanted}"
        raise UsageError(f"{target}: {cause}; end the name in {known}, or say --format")
    return OutputFormat(name, is_patched=name in (document.format, *document.forms))


def _image_format(document: Document, target: str, chosen: str | None) -> OutputFormat:
    suffix = f".{chosen}" if chosen else "" if target == "-" else Path(target).suffix
    known = format_of_suffix(suffix) if suffix else None
    if suffix and known is None:
        raise UsageError(
            f"{target}: no image format is known for {suffix}; end the name in {', '.join(WRITABLE)}, or say --format"
        )
    own = format_of(document.data, document.name)
    if not suffix or known == own:
        own_suffix = Path(document.name).suffix or f".{label_of(own or '')}"
        return OutputFormat(own_suffix.lower()[1:], is_patched=True)
    return OutputFormat(suffix.lower()[1:], is_patched=True, suffix=suffix)
