"""Self-contained pages for browsers: the templates and scripts of this folder, filled in."""

from __future__ import annotations

import base64
import hashlib
import html
import json
import zlib
from collections.abc import Iterable, Mapping, Sequence
from importlib.resources import files
from string import Template

from beltrami_cli.arrays import Uint8s
from beltrami_cli.formats.image import write_image
from beltrami_cli.formats.image.picture import new_picture

PAGES = (".html", ".htm")
"""Extensions of pages."""

LIBRARY = "three.js"
VIEWER_SCRIPTS = ("unpacking.js", "shapes.js", "painting.js", "operating.js", "viewer.js")
"""The library that viewers draw with, and their scripts."""


def page_from(
    template: str, scripts: Sequence[str], data: Mapping[str, object], library: str = "", **parts: str
) -> bytes:
    """Fill in a template: ``$name`` by HTML, `data` as JSON elements for the scripts, which may add the `library`."""
    texts = [asset(script) for script in scripts]
    allowing = [*texts, asset(library)] if library else texts
    hashes = [base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in allowing]
    allowed = " ".join(f"'sha256-{each}'" for each in hashes) or "'none'"
    policy = f"default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; script-src {allowed}"
    blocks = []
    for name, value in data.items():
        json_text = json.dumps(value).replace("<", "\\u003c")  # which can stand in a script element
        blocks.append(f'<script type="application/json" id="{name}">{json_text}</script>')
    blocks += [f"<script>{text}</script>" for text in texts]
    filled = Template(asset(template)).substitute(
        parts, style=asset("style.css"), policy=policy, scripts="\n".join(blocks)
    )
    # Names of files may hold bytes that are not text.
    return filled.encode(errors="replace")


def packed_text(name: str) -> str:
    """Return a file of this folder, compressed."""
    return base64.b64encode(zlib.compress(asset(name).encode(), 9)).decode()


def asset(name: str) -> str:
    """Return the text of a file of this folder."""
    return (files(__name__) / name).read_text(encoding="utf-8")


def picture_tag(picture: Uint8s, alternative: str) -> str:
    """Return an image element with the picture in it, as PNG."""
    height, width = picture.shape[:2]
    text = html.escape(alternative, quote=True)
    return f'<img width="{width}" height="{height}" alt="{text}" src="{data_address(picture)}">'


def data_address(picture: Uint8s) -> str:
    """Return a data URL of the picture, as PNG."""
    data = write_image(new_picture(picture, "a picture"), picture, suffix=".png").data
    return f"data:image/png;base64,{base64.b64encode(data).decode()}"


def table(rows: Iterable[Sequence[str]], name: str) -> str:
    """Return a table, which scrolls where it is too wide; the first row is its head."""
    head, *others = [[html.escape(cell) for cell in row] for row in rows]
    lines = ["<tr>" + "".join(f'<th scope="col">{cell}</th>' for cell in head) + "</tr>"]
    lines += ["<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in others]
    body = "\n".join(lines)
    frame = f'<div class="wide" role="region" tabindex="0" aria-label="{html.escape(name, quote=True)}">'
    return f"{frame}<table>\n{body}\n</table></div>"
