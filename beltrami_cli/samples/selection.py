"""What a job does with a document: which of its colours are smoothed, and in which format they are written."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from beltrami_cli.errors import InputError, UnpaintedError, UsageError
from beltrami_cli.formats.model_folder import LEFT_ALONE, remedy_for
from beltrami_cli.formats.registry import OUTPUT_FORMATS
from beltrami_cli.surface.validation import check_scale

if TYPE_CHECKING:
    from collections.abc import Sequence

    from beltrami_cli.formats.document import Document
    from beltrami_cli.samples.settings import SmoothSettings
    from beltrami_cli.surface.records import Slot


@dataclass(frozen=True)
class Work:
    """What is smoothed.

    Attributes
    ----------
    vertices : bool
        Whether the vertex colours are.
    slots : tuple of Slot
        The texture slots that are.
    notices : tuple of str
        What the user should know of the choice.
    """

    vertices: bool
    slots: tuple[Slot, ...]
    notices: tuple[str, ...] = ()


def choose_work(document: Document, settings: SmoothSettings) -> Work:
    """Choose what is smoothed, by the settings and by what is there.

    Raises
    ------
    InputError
        If there is nothing of what is asked for; the message says what there is.
    UsageError
        If something is asked for that only images have.
    """
    if settings.image.given:
        wrong = ", ".join(settings.image.given)
        raise UsageError(f"{wrong}: for images only, but {document.name} is none; leave it out")
    present = document.slots()
    slots = tuple(slot for slot in present if slot in settings.textures.slots)
    coloured = settings.on != "texture" and document.has_vertex_colours()
    if settings.on == "vertices" or (settings.on == "auto" and not slots and coloured):
        if not coloured:
            document.painted()  # raises, and says what there is instead
        return Work(vertices=True, slots=())
    if settings.on == "both" and not (coloured and slots):
        missing = "vertex colours" if slots else "textures in the chosen slots"
        raise InputError(document.name, f"it has no {missing}", "use --on auto")
    if not slots:
        raise _nothing_to_smooth(document, present, textures_only=settings.on == "texture")
    slots = _with_chosen_textures(document, slots, settings)
    absent = [f"it has no {slot} textures" for slot in settings.textures.slots if slot not in present]
    both = settings.on == "both"
    stay = coloured and not both
    notices = [
        *absent,
        *(["its vertex colours stay as they are; --on both smooths them too"] if stay else []),
    ]
    return Work(vertices=both, slots=slots, notices=tuple(notices))


def require_scale(document: Document, work: Work) -> None:
    """Refuse a document if distances on what is worked on cannot be computed with.

    Raises
    ------
    InputError
        As `check_scale`, and `Document.painted` and `Document.textured`.
    """
    if work.vertices:
        painted = document.painted()
        check_scale(painted.positions, painted.faces, document.name)
    for slot in work.slots:
        surface = document.textured(slot)
        check_scale(surface.positions, surface.faces[surface.texture_of >= 0], document.name)


def _nothing_to_smooth(document: Document, present: Sequence[Slot], *, textures_only: bool) -> InputError:
    """Return the error that there are no colours of the kind that is asked for, or that they are damaged."""
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
        remedy = f"add --slots {present[0]}"
        return UnpaintedError(
            document.name, f"{cause}, but textures in the slots {', '.join(present)}", remedy
        )
    reason = document.notices[0] if document.notices else why
    reason = reason.removesuffix(LEFT_ALONE).rstrip(".")
    return UnpaintedError(document.name, cause + (f" ({reason})" if reason else ""), remedy_for(reason))


def _with_chosen_textures(
    document: Document, slots: tuple[Slot, ...], settings: SmoothSettings
) -> tuple[Slot, ...]:
    """Leave out the slots in which the globs choose nothing."""
    wanted = settings.textures
    if not (wanted.names or wanted.materials):
        return slots
    from beltrami_cli.samples.textures.choosing import choose_textures

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


def choose_format(document: Document, target: str, chosen: str | None) -> str:
    """Choose the format to write, by option, by the output's name, or as the source.

    Raises
    ------
    UsageError
        If the name's extension is of no known format.
    """
    told = chosen or Path(target).suffix.lower().lstrip(".")
    if told in OUTPUT_FORMATS:
        return OUTPUT_FORMATS[told]
    if target == "-" or not told:
        return OUTPUT_FORMATS.get(document.format, "ply")
    raise UsageError(
        f"{target}: no format is known for .{told}; end the name in {', '.join('.' + f for f in OUTPUT_FORMATS)}, "
        "or say --format"
    )
