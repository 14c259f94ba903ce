"""Which coloured parts of two files are compared."""

from __future__ import annotations

import dataclasses

from beltrami_cli.errors import InputError
from beltrami_cli.fields import require_effect
from beltrami_cli.jobs.compare.same_model import Documents
from beltrami_cli.layers.selection import Selection, absent_slots, select
from beltrami_cli.layers.settings import DEFAULTS, SmoothSettings
from beltrami_cli.surface.slots import SLOTS, Slot


def choose_parts(documents: Documents, settings: SmoothSettings) -> tuple[Selection, list[str]]:
    """Choose the compared parts, by default all coloured ones; return notices on all others."""
    kinds = ["an image" if document.kind == "image" else "a model" for document in documents]
    if kinds[0] != kinds[1]:
        cause = f"it is {kinds[1]}, but {documents[0].name} is {kinds[0]}"
        raise InputError(documents[1].name, cause, "compare two files of one kind")
    if documents[0].kind == "image":
        selection = Selection(documents[0], settings, image=True)
        require_effect(documents[0].access.typed, selection.kinds, documents[0].name)
        return selection, []
    chosen, notices = (settings, []) if settings.textures.slots else _everything(documents, settings)
    selection = select(documents[0], chosen)
    notices += absent_slots(documents[0], chosen) if selection.slots else []
    uncompared = [f"{slot} textures" for slot in _slots_of(documents) if slot not in selection.slots]
    if not selection.vertices and any(document.has_vertex_colours() for document in documents):
        uncompared.insert(0, "vertex colours")
    if settings.textures.names or settings.textures.materials:
        uncompared.append("textures that --texture and --material leave out")
    if settings.channels is not None:
        uncompared.append("other channels")
    if uncompared:
        notices.append(f"not compared: {', '.join(uncompared)}")
    return selection, notices


def _slots_of(documents: Documents) -> tuple[Slot, ...]:
    known = {slot for document in documents for slot in document.slots()}
    return tuple(sorted(known, key=SLOTS.index))


def _everything(documents: Documents, settings: SmoothSettings) -> tuple[SmoothSettings, list[str]]:
    """Return settings that select all coloured parts of both models, and notices on textures that cannot be read.

    InputError if only one model has some part.
    """
    slots = () if settings.on == "vertices" else _slots_of(documents)
    for slot in slots:
        _require_both(documents, [slot in document.slots() for document in documents], f"{slot} textures")
    unreadable = {slot: cause for slot in slots if (cause := _why_unreadable(documents, slot))}
    notices = [f"not compared: {slot} textures, because {cause}" for slot, cause in unreadable.items()]
    slots = tuple(slot for slot in slots if slot not in unreadable)
    has_globs = bool(settings.textures.names or settings.textures.materials)
    vertices = settings.on != "texture" and not (settings.on == "auto" and has_globs and slots)
    if vertices and slots:
        coloured = [document.has_vertex_colours() for document in documents]
        _require_both(documents, coloured, "vertex colours")
        vertices = settings.on == "both" or all(coloured)
    textures = dataclasses.replace(settings.textures, slots=slots or DEFAULTS.textures.slots)
    on = settings.on
    if slots:
        on = "both" if vertices else "texture"
    return dataclasses.replace(settings, on=on, textures=textures), notices


def _require_both(documents: Documents, has: list[bool], what: str) -> None:
    if has[0] != has[1]:
        with_it, without_it = documents if has[0] else reversed(documents)
        cause = f"it has no {what}, but {with_it.name} has"
        raise InputError(without_it.name, cause, "choose what both have with --slots or --on")


def _why_unreadable(documents: Documents, slot: Slot) -> str:
    """Return why the textures of a slot can be read in neither model; raises the error if in one of them only."""
    errors = list[InputError]()
    for document in documents:
        try:
            document.textured(slot)
        except InputError as error:
            errors.append(error)
    if len(errors) == 1:
        raise errors[0]
    return errors[0].cause if errors else ""
