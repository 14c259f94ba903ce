"""New colours and image names for a PLY file, and its division into replaceable and fixed parts for comparison."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float32s
from beltrami_cli.formats import tokens
from beltrami_cli.formats.document import Bytes, Fingerprint, Naming, NewImages, Written
from beltrami_cli.formats.model_folder import ModelFolder, NewFiles, is_outside, new_reference
from beltrami_cli.formats.ply.elements import NORMAL, POSITION, Paint, attribute_names
from beltrami_cli.formats.ply.header import Header
from beltrami_cli.formats.ply.tables import Places, Table, indices, values_in_bytes
from beltrami_cli.formats.ply.texturing import TextureComment
from beltrami_cli.surface.records import MovedVertices, Texture


@dataclass(frozen=True)
class Change:
    """New values of one property."""

    places: Places  # of the property, a scalar, in all rows
    rows: Bools  # which rows change
    values: Array  # their new values, in the property's type


def patch_body(data: bytes, header: Header, changes: Sequence[Change]) -> list[Bytes]:
    """Exchange values in the body, at least one, each property once; every other byte stays. Return it in pieces."""
    if not header.order:
        text = data[header.end :]
        starts, ends = tokens.find_tokens(text)
        places = [indices(change.places)[change.rows] for change in changes]
        both = zip(places, changes, strict=True)
        new = [tokens.NewNumbers(starts[at], ends[at], change.values) for at, change in both]
        return [*tokens.renumbered(text, new)]
    patched = bytearray(data)
    for change in changes:
        everywhere = values_in_bytes(patched, header.order + change.values.dtype.str[1:])
        where = change.places
        if isinstance(where, slice):
            everywhere[where][change.rows] = change.values
        else:
            everywhere[where[change.rows]] = change.values
    return [memoryview(patched)[header.end :]]


def moved_changes(vertices: Table, kinds: Mapping[str, str], places: MovedVertices) -> list[Change]:
    """Return what changes when vertices move, for `patch_body`."""
    columns = dict(zip(POSITION, places.positions.T, strict=True))
    if places.normals is not None and "normal" in attribute_names(kinds, ()):
        columns |= zip(NORMAL, places.normals.T, strict=True)
    changes = []
    for name, column in columns.items():
        rows = (column != vertices.scalars(name)) & ~np.isnan(column)
        changes.append(Change(vertices.places(name), rows, column[rows].astype(kinds[name])))
    return changes


def renamed_images(
    comments: Sequence[TextureComment], images: NewImages, source: str, naming: Naming
) -> tuple[Written, tokens.Spans]:
    """Return the sidecar files of a PLY file, and new names by their place in the header."""
    present = [comment.path for comment in comments if comment.path is not None]
    missing = [comment.name for comment in comments if comment.path is None]
    names = NewFiles(naming, source, present, missing)
    new_of: dict[str, str] = {}
    for (_, path), image in images.items():
        new_of[path] = names.image(path, image.suffix)
        names.sidecars[new_of[path]] = image.data
    for comment in comments if names.copies else ():
        if comment.path is None or comment.path in new_of:
            continue
        if is_outside(comment.path):
            names.leave(comment.name)
        else:
            new_of[comment.path] = names.image(comment.path)
            names.copied[new_of[comment.path]] = comment.path
    spans: tokens.Spans = {}
    for comment in comments:
        if comment.path is not None and comment.path in new_of and new_of[comment.path] != comment.path:
            new = new_reference(comment.name, comment.path, new_of[comment.path])
            spans[comment.start, comment.end] = new
    return names.written(), spans


def take_apart(
    data: bytes,
    header: Header,
    tables: Mapping[str, Table],
    painted: tuple[Paint, Float32s] | None,
    images: Sequence[TextureComment],
    folder: ModelFolder,
) -> Fingerprint:
    """Take a PLY file apart: header, elements, and what stands behind them."""
    spans = {(image.start, image.end): tokens.PLACEHOLDER for image in images if image.path is not None}
    parts = {"header": tokens.exchange_spans(data[: header.end], spans)}
    names, size = (painted[0].names, np.dtype(painted[0].type).itemsize) if painted else ((), 0)
    places = [indices(tables[painted[0].element].places(name)) for name in names] if painted else []
    hidden = np.concatenate([np.empty(0, np.int64), *places])
    starts = [table.start for table in tables.values()]
    stop = [*tables.values()][-1].stop if tables else 0
    if header.order:
        body = tokens.zeroed(data, hidden, size)
        bounds, end = [*starts, stop], len(data)
    else:
        text, order = data[header.end :], np.sort(hidden)
        starts_of, ends_of = tokens.find_tokens(text)
        body = tokens.without_tokens(text, starts_of[order], ends_of[order])
        shorter = np.zeros(len(starts_of) + 1, np.int64)
        shorter[order + 1] = ends_of[order] - starts_of[order] - len(tokens.PLACEHOLDER)
        edges = np.append(starts_of - np.cumsum(shorter)[:-1], len(body))
        bounds, end = edges[np.minimum([*starts, stop], len(edges) - 1)].tolist(), len(body)
    for name, (first, last) in zip(tables, pairwise(bounds), strict=True):
        parts[f"element {name}"] = body[first:last]
    parts["what follows the last element"] = body[bounds[-1] : end] if tables else data[header.end :]
    colours = {f"{painted[0].element} colours": painted[1]} if painted else {}
    paintings = {
        f"texture {number}": Texture(image.path, image.name, partial(folder.content, image.path))
        for number, image in enumerate(images)
        if image.path is not None
    }
    return Fingerprint(parts, colours, paintings)
