"""OFF, STL and 3MF files of the tests' own."""

from __future__ import annotations

import io
import struct
import zipfile

import numpy as np

from beltrami_cli.formats.files.access import Access
from beltrami_cli.formats.read_only.document import ReadOnlyDocument
from beltrami_cli.formats.registry import open_bytes

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
LEVELS = np.array([[255, 0, 0], [0, 128, 0], [0, 0, 64], [10, 20, 30]], np.uint8)
FACES = [[0, 1, 2], [0, 2, 3]]


def opened(data: bytes, name: str, memory: int | None = None) -> ReadOnlyDocument:
    document = open_bytes(data, name, None, Access(memory=memory))
    assert isinstance(document, ReadOnlyDocument)
    return document


def coff(style: str, prefix: str = "C", extra: str = "") -> bytes:
    rows = []
    for place, level in zip(SQUARE.tolist(), LEVELS.tolist(), strict=True):
        numbers = (
            [repr(value / 255) for value in level] if style == "float" else [str(value) for value in level]
        )
        rows.append(
            " ".join([*map(str, place), *extra.split(), *numbers, *(["1"] if style == "float" else ["255"])])
        )
    return f"{prefix}OFF\n# a comment\n4 2 0\n{chr(10).join(rows)}\n3 0 1 2\n3 0 2 3\n".encode()


def stl(colours: list[int], header: bytes = b"") -> bytes:
    body = b""
    for face, colour in zip(FACES, colours, strict=True):
        body += struct.pack("<12fH", 0, 0, 1, *SQUARE[face].ravel(), colour)
    return header.ljust(80, b"\0") + struct.pack("<I", len(FACES)) + body


CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
MATERIAL = "http://schemas.microsoft.com/3dmanufacturing/material/2015/02"
PRODUCTION = "http://schemas.microsoft.com/3dmanufacturing/production/2015/06"
VERTICES = "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in SQUARE.tolist())
PALETTE = "".join(f'<m:color color="#{bytes(level).hex().upper()}"/>' for level in LEVELS)
OBJECT = (
    f'<m:colorgroup id="9">{PALETTE}</m:colorgroup><object id="1" pid="9" pindex="3"><mesh>'
    f"<vertices>{VERTICES}</vertices>"
    '<triangles><triangle v1="0" v2="1" v3="2" p1="0" p2="1" p3="2"/>'
    '<triangle v1="0" v2="2" v3="3" pid="9" p1="0" p2="2" p3="3"/></triangles></mesh></object>'
)


def model(resources: str, build: str = '<item objectid="1"/>') -> str:
    return (
        f'<?xml version="1.0"?><model xmlns="{CORE}" xmlns:m="{MATERIAL}" xmlns:p="{PRODUCTION}">'
        f"<resources>{resources}</resources><build>{build}</build></model>"
    )


def threemf(text: str, **others: str) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        kind = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
        relation = f'<Relationship Type="{kind}" Target="/3D/3dmodel.model"/>'
        archive.writestr("_rels/.rels", f"<Relationships>{relation}</Relationships>")
        archive.writestr("3D/3dmodel.model", text)
        for name, content in others.items():
            archive.writestr(f"3D/{name}.model", content)
    return packed.getvalue()
