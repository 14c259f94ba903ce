"""The process with the libraries of scanners: it reads a file, or writes it with new colours.

A file becomes its shape and tables: positions, colours and normals, if there are any, each further field of the points
under its name behind `FIELD`, and what else the file holds.
"""

from __future__ import annotations

import numpy as np

from beltrami_cli.formats.files.foreign_library import serve_files
from beltrami_cli.formats.points.e57 import E57
from beltrami_cli.formats.points.las import Las, is_laz
from beltrami_cli.formats.points.pcd import Pcd
from beltrami_cli.formats.points.scan import Arrays, Scan, ScanContents
from beltrami_cli.surface.worker_process import Message

FIELD = "field "  # so that names of fields differ from those of other tables
_SCANS: dict[str, type[Scan]] = {"las": Las, "laz": Las, "e57": E57, "pcd": Pcd}


def format_of(data: bytes) -> str:
    if data.startswith(b"LASF"):
        return "laz" if is_laz(data) else "las"
    return "e57" if data.startswith(b"ASTM") else "pcd"


def _answer(form: str | None, arrays: Arrays) -> Message:
    """Return the file in a form, with new colours, or, for None, its shape and tables."""
    data = arrays["data"].tobytes()
    scan = _SCANS[format_of(data)](data)
    if form is not None:
        return None, {"made": np.frombuffer(scan.written(arrays.get("new"), form), np.uint8)}
    contents = scan.contents()
    return contents.shape or contents.positions.shape[:1], _tables(contents)


def _tables(contents: ScanContents) -> Arrays:
    tables = {"positions": contents.positions, "colours": contents.colours, "normals": contents.normals}
    present = {name: table for name, table in tables.items() if table is not None}
    return present | {FIELD + name: table for name, table in contents.fields.items()} | dict(contents.rest)


if __name__ == "__main__":
    serve_files(_answer, "LAS, LAZ, E57 and PCD", "laspy, lazrs, pye57 or pypcd4")
