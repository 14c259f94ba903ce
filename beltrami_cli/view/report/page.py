"""Self-contained pages: templates from the package, filled in."""

from __future__ import annotations

import base64
import html
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
    """Fill in a template.

    Parameters
    ----------
    template : str
        Name of a file of `beltrami_cli.view.pages`.
    **parts : str
        What stands for each ``$name`` in it, as HTML or script.
    """
    text = asset(template)
    # Names of files may hold bytes that are no text.
    return Template(text).substitute(parts).encode(errors="replace")


def asset(name: str) -> str:
    """Return the text of a file of `beltrami_cli.view.pages`."""
    return (files("beltrami_cli.view.pages") / name).read_text(encoding="utf-8")


def picture_tag(picture: NDArray[np.uint8], alternative: str) -> str:
    """Return an image element with the picture in it, as PNG."""
    height, width = picture.shape[:2]
    text = html.escape(alternative, quote=True)
    return f'<img width="{width}" height="{height}" alt="{text}" src="{data_address(picture)}">'


def data_address(picture: NDArray[np.uint8]) -> str:
    """Return an address that is the picture itself, as PNG."""
    data = write_image(new_picture(picture, "a picture"), picture, suffix=".png").data
    return f"data:image/png;base64,{base64.b64encode(data).decode()}"


def table(rows: Iterable[Sequence[str]]) -> str:
    """Return a table; the first row is its head."""
    head, *others = [[html.escape(cell) for cell in row] for row in rows]
    lines = ["<tr>" + "".join(f"<th>{cell}</th>" for cell in head) + "</tr>"]
    lines += ["<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in others]
    return "<table>\n" + "\n".join(lines) + "\n</table>"
