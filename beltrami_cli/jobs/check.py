"""The differences between a file and the result of smoothing it; only colours and images may differ."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, partial
from typing import TypeVar

import numpy as np

from beltrami_cli.arrays import Array, Bools
from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.files.access import Access
from beltrami_cli.formats.image.decoded_image import DecodedImage
from beltrami_cli.formats.image.reading import read_image
from beltrami_cli.formats.image.sample_types import full_scale_one
from beltrami_cli.formats.image.sizes import measure_image
from beltrami_cli.formats.registry import open_document
from beltrami_cli.jobs.job import PLAIN_JOB, Job
from beltrami_cli.layers.image_memory import require_memory
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import build_atlas
from beltrami_cli.surface.records import Texture

Value = TypeVar("Value")


@dataclass(frozen=True)
class Difference:
    """A difference, and its place in the file."""

    what: str
    detail: str
    of_colour: bool = False  # whether only colours differ, which may


@dataclass(frozen=True)
class CheckReport:
    """The outcome of a comparison; `dataclasses.asdict` gives JSON types.

    Attributes
    ----------
    before, after, format : str
        Paths of the files, and their format.
    differences : list of Difference
        "what" differs, how ("detail"), and whether it is "of_colour" and so allowed.
    faithful : bool
        Whether nothing but colours and images differs.
    """

    before: str
    after: str
    format: str
    differences: list[Difference]

    @property
    def faithful(self) -> bool:
        return all(difference.of_colour for difference in self.differences)


def check_files(
    before: str | os.PathLike[str], after: str | os.PathLike[str], job: Job = PLAIN_JOB
) -> CheckReport:
    """Compare a file with what was made of it, in the same format."""
    original = open_document(os.fspath(before), job.access)
    documents = [original, open_document(os.fspath(after), original.access_to_copies())]
    formats = [document.format for document in documents]
    if formats[0] != formats[1]:
        kinds = [f"{document.name} is {document.format}" for document in documents]
        raise UsageError(f"{' and '.join(kinds)}; give two of one format")
    old, new = (document.fingerprint() for document in documents)
    differences = _differences(old.colours, new.colours, _difference_of_colours)
    visible = cache(partial(_visible_texels, original))
    differ = partial(_difference_of_images, visible=visible, access=job.access)
    differences += _differences(old.images, new.images, differ)
    differences += _differences(old.parts, new.parts, _difference_of_bytes)
    faults = [fault for fault in new.faults if fault not in old.faults]
    differences += [Difference("package", fault) for fault in faults]
    return CheckReport(documents[0].name, documents[1].name, formats[0], differences)


def _visible_texels(document: Document) -> dict[bytes, Bools]:
    """Find the texels of each texture, by its content, that lie on the surface; shapes (H, W)."""
    visible: dict[bytes, Bools] = {}
    for slot in document.slots():
        try:
            surface = document.textured(slot)
        except InputError:
            continue
        sizes = [measure_image(texture.data, texture.name) for texture in surface.textures]
        known = [(size.width, size.height) for size in sizes if size is not None]
        if len(known) < len(sizes):  # Such a texture can be compared, but not be laid out.
            continue
        atlas = build_atlas(surface, known, margin=1)
        for index, _, texels in atlas.by_texture(atlas.owned_texels):
            empty = np.zeros(known[index][::-1], bool)
            visible.setdefault(surface.textures[index].data, empty).flat[texels] = True
    return visible


def _differences(
    old: Mapping[str, Value],
    new: Mapping[str, Value],
    differ: Callable[[str, Value, Value], Difference | None],
) -> list[Difference]:
    """Compare the contents of two files by their names; `differ` compares two of one name."""
    differences = []
    for what in {**old, **new}:
        if what in old and what in new:
            difference = differ(what, old[what], new[what])
        else:
            difference = Difference(what, "is new" if what in new else "is missing")
        if difference is not None:
            differences.append(difference)
    return differences


def _difference_of_colours(what: str, before: Array, after: Array) -> Difference | None:
    if before.shape != after.shape:
        return Difference(what, f"{before.shape} became {after.shape}")
    return None if np.array_equal(before, after) else Difference(what, _amount(before, after), of_colour=True)


def _amount(before: Array, after: Array) -> str:
    """Say how many rows of colours differ, and by how much; integers are shares of the largest of their type."""
    if np.array_equal(before, after):
        return f"none of {len(before)} differ"
    rows, total, largest = 0, 0.0, 0.0
    for block in large_arrays.blocks(len(before)):
        change = np.abs(full_scale_one(after[block]).astype(np.float64) - full_scale_one(before[block]))
        rows += int(np.count_nonzero(change.any(axis=1)))
        total, largest = total + float(change.sum()), max(largest, float(change.max()))
    mean = 255 * total / before.size
    return f"{rows} of {len(before)} differ, by {mean:.2f}/255 on average and {255 * largest:.1f}/255 at most"


def _difference_of_images(
    what: str, old: Texture, new: Texture, visible: Callable[[], Mapping[bytes, Bools]], access: Access
) -> Difference | None:
    if old.data == new.data:
        return None
    require_memory([(old.name, old.data), (new.name, new.data)], access)
    try:
        before, after = read_image(old.data, old.name), read_image(new.data, new.name)
    except InputError as error:
        return Difference(what, f"{old.name} and {new.name} differ, and {error}")
    names = old.name if old.name == new.name else f"{old.name}, now {new.name}"
    sizes = [f"{len(p.pixels[0])} x {len(p.pixels)} pixels" for p in (before, after)]
    if sizes[0] != sizes[1]:
        return Difference(what, f"{names}: {sizes[0]} became {sizes[1]}")
    if cleared := _cleared(before, after):
        return Difference(
            what, f"{names}: {cleared} pixels under an alpha of 0 lost their colours, which became 0"
        )
    kinds = [f"{p.stored} {'/'.join(p.channels)} in {p.format}" for p in (before, after)]
    if kinds[0] != kinds[1]:
        return Difference(what, f"{names}: {kinds[0]} became {kinds[1]}", of_colour=True)
    mask = visible().get(old.data)
    if mask is None:
        amount = _amount(*(p.pixels.reshape(-1, len(p.channels)) for p in (before, after)))
        return Difference(what, f"{names}: pixels, {amount}", of_colour=True)
    on, off = (_amount(before.pixels[part], after.pixels[part]) for part in (mask, ~mask))
    return Difference(what, f"{names}: on the surface {on}; in the gutter {off}", of_colour=True)


def _cleared(before: DecodedImage, after: DecodedImage) -> int:
    """Count the pixels under an alpha of 0 whose colours are gone, as encoders clear them: without exception."""
    if before.alpha is None or after.alpha is None:
        return 0
    hidden = (before.pixels[..., before.alpha] == 0) & (after.pixels[..., after.alpha] == 0)
    old, new = (image.pixels[hidden][:, list(image.colour)] for image in (before, after))
    return 0 if new.any() else int(np.count_nonzero(old.any(axis=1)))


def _difference_of_bytes(what: str, old: bytes, new: bytes) -> Difference | None:
    """Say where two parts begin to differ: by the line in text, otherwise by the byte."""
    if old == new:
        return None
    length = min(len(old), len(new))
    differing = np.flatnonzero(np.frombuffer(old, np.uint8, length) != np.frombuffer(new, np.uint8, length))
    at = int(differing[0]) if differing.size else length
    if b"\n" in old and old[: at + 80].isascii():
        return Difference(what, f"differs from its line {old.count(10, 0, at) + 1} on")
    return Difference(what, f"differs from its byte {at} on, {len(old)} bytes against {len(new)}")
