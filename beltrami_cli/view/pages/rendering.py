"""Self-contained pages for browsers: the templates and scripts of this folder, rendered by Jinja."""

from __future__ import annotations

import base64
import hashlib
import zlib
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
from jinja2 import Environment, FunctionLoader, StrictUndefined
from markupsafe import Markup

from beltrami_cli.arrays import Array, Uint8s
from beltrami_cli.formats.image.decoded_image import new_image
from beltrami_cli.formats.image.writing import write_image

PAGES = (".html", ".htm")
"""Extensions of pages."""

_LIBRARY = "three.js"  # that viewers draw with
_VIEWER_SCRIPTS = ("unpacking.js", "shapes.js", "updating.js", "operating.js", "viewer.js")


def rendered(template: str, **values: object) -> Markup:
    """Render a template of this folder; values that are not `Markup` are escaped."""
    return Markup(_templates().get_template(template).render(values))


@cache
def _templates() -> Environment:
    made = Environment(
        loader=FunctionLoader(asset), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )  # fmt: skip
    made.filters["data_address"] = data_address
    return made


def page_from(
    template: str, scripts: Sequence[str], data: Mapping[str, object], *, library: str = "", connect: str = "",
    **values: Any,
) -> bytes:  # fmt: skip
    """Render a page with its scripts, `data` as JSON for them, and permission to run `library` and to `connect`."""
    texts = [asset(script) for script in scripts]
    allowing = [*texts, library] if library else texts
    hashes = [base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in allowing]
    allowed = " ".join(f"'sha256-{each}'" for each in hashes) or "'none'"
    sources = f"img-src data: blob:; connect-src blob: {connect}; style-src 'unsafe-inline'"
    policy = f"default-src 'none'; {sources}; script-src {allowed}"
    page = rendered(
        template, style=Markup(asset("style.css")), policy=policy, data=data, scripts=map(Markup, texts), **values
    )  # fmt: skip
    # Names of files may hold bytes that are not text.
    return page.encode(errors="replace")


def page_with_models(
    template: str, script: str, data: Mapping[str, object], *, connect: str = "", **values: Any
) -> bytes:
    """Render a page with the viewer, whose library is packed, since it is most of a small page."""
    library = asset(_LIBRARY)
    packed = base64.b64encode(zlib.compress(library.encode(), 9)).decode()
    values |= {"library": library, "connect": connect, "licence": asset("three.LICENSE")}
    return page_from(template, [*_VIEWER_SCRIPTS, script], {"three": packed, **data}, **values)


def asset(name: str) -> str:
    return (files("beltrami_cli.view.pages") / name).read_text(encoding="utf-8")


def data_address(picture: Uint8s) -> str:
    """Return a data URL of the picture, as PNG."""
    return f"data:image/png;base64,{base64.b64encode(png_of(picture)).decode()}"


def png_of(picture: Uint8s) -> bytes:
    return write_image(new_image(picture, "a picture"), picture, suffix=".png").data


def packed_array(values: Array, level: int) -> str:
    """Return the bytes of an array for a page, compressed."""
    data = np.ascontiguousarray(values.astype(values.dtype.newbyteorder("<"))).tobytes()
    return base64.b64encode(zlib.compress(data, level)).decode()
