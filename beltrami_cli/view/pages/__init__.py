"""Self-contained pages for browsers: the templates and scripts of this folder, filled in."""

from __future__ import annotations

import base64
import html
import json
from importlib.resources import files
from string import Template
from typing import TYPE_CHECKING

from beltrami_cli.formats.image import write_image
from beltrami_cli.formats.image.picture import new_picture

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    import numpy as np
    from numpy.typing import NDArray

PAGES = (".html", ".htm")
"""Extensions of pages."""


def page_from(template: str, **parts: str) -> bytes:
    """Fill in a template of this folder: each ``$name`` in it becomes HTML or script."""
    # Names of files may hold bytes that are not text.
    return Template(asset(template)).substitute(parts).encode(errors="replace")


def asset(name: str) -> str:
    """Return the text of a file of this folder."""
    return (files(__name__) / name).read_text(encoding="utf-8")


def picture_tag(picture: NDArray[np.uint8], alternative: str) -> str:
    """Return an image element with the picture in it, as PNG."""
    height, width = picture.shape[:2]
    text = html.escape(alternative, quote=True)
    return f'<img width="{width}" height="{height}" alt="{text}" src="{data_address(picture)}">'


def data_address(picture: NDArray[np.uint8]) -> str:
    """Return a data URL of the picture, as PNG."""
    data = write_image(new_picture(picture, "a picture"), picture, suffix=".png").data
    return f"data:image/png;base64,{base64.b64encode(data).decode()}"


def table(rows: Iterable[Sequence[str]]) -> str:
    """Return a table; the first row is its head."""
    head, *others = [[html.escape(cell) for cell in row] for row in rows]
    lines = ["<tr>" + "".join(f"<th>{cell}</th>" for cell in head) + "</tr>"]
    lines += ["<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in others]
    return "<table>\n" + "\n".join(lines) + "\n</table>"


def script_json(value: object) -> str:
    """Return a value as JSON that can stand in a script element."""
    return json.dumps(value).replace("<", "\\u003c")
