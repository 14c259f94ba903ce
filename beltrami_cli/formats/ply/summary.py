"""A PLY file seen from its header: facts about it, and what a conversion leaves out."""

from __future__ import annotations

from typing import TYPE_CHECKING

from beltrami_cli.formats.ply.polygons import VERTEX_LISTS

if TYPE_CHECKING:
    from collections.abc import Collection

    from beltrami_cli.formats.ply.header import Header


def facts_of(header: Header) -> dict[str, object]:
    """Return what a header says, in JSON types."""
    return {
        "format": "ply",
        "encoding": header.encoding,
        "elements": {element.name: element.count for element in header.elements},
        "properties": {
            element.name: [known.name for known in element.properties] for element in header.elements
        },
        "comments": header.comments,
    }


def left_out(header: Header, used: Collection[str]) -> tuple[str, ...]:
    """Return what is in a file but some properties of the vertices, and the vertices of faces."""
    dropped = []
    for element in header.elements:
        known = used if element.name == "vertex" else VERTEX_LISTS.get(element.name, ())
        others = [other.name for other in element.properties if other.name not in known]
        if element.name != "vertex" and element.name not in VERTEX_LISTS:
            dropped.append(f"element {element.name}")
        elif others:
            dropped.append(f"{element.name} properties {', '.join(others)}")
    return (*dropped, *(["comments"] if header.comments else []))
