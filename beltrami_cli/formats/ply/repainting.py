"""New images for a PLY file, and their names in its comments."""

from __future__ import annotations

from typing import TYPE_CHECKING

from beltrami_cli.formats.model_folder import new_reference, path_inside, renamed, unused, with_suffix

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from beltrami_cli.formats.document import Bytes
    from beltrami_cli.formats.ply.texturing import TextureComment
    from beltrami_cli.formats.tokens import Spans
    from beltrami_cli.surface.records import ImageFile, Slot


def renamed_images(
    comments: Sequence[TextureComment],
    images: Mapping[tuple[Slot, str], ImageFile],
    source: str,
    stem: str,
    *,
    moved: bool,
) -> tuple[dict[str, Bytes], Spans, frozenset[str]]:
    """Return the new image files, the new names by where the old ones stand, and which old ones are named no more.

    Parameters
    ----------
    comments : sequence of TextureComment
        Of the source.
    images : mapping of (Slot, str) to ImageFile
        New images by slot and path.
    source : str
        Stem of the source's name.
    stem, moved
        As for `Document.patch`.
    """
    taken = {comment.path.casefold() for comment in comments if comment.path is not None}
    sidecars: dict[str, Bytes] = {}
    spans: Spans = {}
    superseded: set[str] = set()
    for (_, path), image in images.items():
        inside = path_inside(path)
        new = with_suffix(inside if moved else renamed(inside, source, stem), image.suffix)
        new = new if moved and new == path else unused(new, taken)
        taken.add(new.casefold())
        sidecars[new] = image.data
        if new != path:
            superseded.add(path)
        for comment in comments:
            if comment.path == path and new != path:
                spans[comment.start, comment.end] = new_reference(comment.name, path, new)
    return sidecars, spans, frozenset(superseded)
