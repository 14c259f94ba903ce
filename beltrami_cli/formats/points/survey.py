"""Point clouds of scanners: LAS, LAZ, E57 and PCD, each read by its library in a process of its own.

The process returns the points as an archive of arrays: positions, colours or intensities, and whatever else the file
holds. Written back are the colours or intensities alone.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np

from beltrami_cli.formats.changes import Changes, Naming, Written
from beltrami_cli.formats.files.foreign_library import ForeignLibrary, serve_files
from beltrami_cli.formats.files.numpy_files import NpzArchive
from beltrami_cli.formats.points.e57 import E57
from beltrami_cli.formats.points.las import Las, has_index, is_laz
from beltrami_cli.formats.points.npz import NpzPointsDocument
from beltrami_cli.formats.points.pcd import Pcd
from beltrami_cli.formats.points.scan import Arrays, Scan

_SECONDS_PER_MEBIBYTE = 5  # LAZ: a million points of 3 MiB take a second
_REMEDY = "convert it to PLY, for example with PDAL or CloudCompare"
_LIBRARY = ForeignLibrary("beltrami_cli.formats.points.survey", "scans", _SECONDS_PER_MEBIBYTE, _REMEDY)
_SCANS: dict[str, type[Scan]] = {"las": Las, "laz": Las, "e57": E57, "pcd": Pcd}


class SurveyDocument(NpzPointsDocument):
    """A file that its library reads and writes; its points are taken as arrays, like an NPZ archive."""

    def _open(self, folder: Path | None) -> None:
        self._archive = NpzArchive(self._ask(None, {}), self.name)

    @property
    def format(self) -> str:  # type: ignore[override]
        return _format_of(self.data)

    @property
    def forms(self) -> tuple[str, ...]:  # type: ignore[override]
        return ("las", "laz") if _SCANS[self.format] is Las else (self.format,)

    def _patched(self, new: Changes, naming: Naming) -> Written:
        stored, form = self._recoloured(new.colours), new.form or self.format
        if stored is None and form == self.format:
            return Written([self.data])
        left_out = "The index of COPC is left out: the file becomes plain LAS or LAZ."
        notices = (left_out,) if has_index(self.data) else ()
        return Written([self._ask(form, {} if stored is None else {"new": stored})], notices=notices)

    def _ask(self, form: str | None, arrays: Arrays) -> bytes:
        """Return the file in a form with new colours, or, for None, the archive of its arrays."""
        question = form, {"data": np.frombuffer(self.data, np.uint8), **arrays}
        return _LIBRARY.ask(question, self.name, len(self.data), self.access.memory)[1]["made"].tobytes()


def _format_of(data: bytes) -> str:
    if data.startswith(b"LASF"):
        return "laz" if is_laz(data) else "las"
    return "e57" if data.startswith(b"ASTM") else "pcd"


def _answer(form: str | None, arrays: Arrays) -> tuple[None, Arrays]:
    data = arrays["data"].tobytes()
    scan = _SCANS[_format_of(data)](data)
    if form is not None:
        made = scan.written(arrays.get("new"), form)
    else:
        buffer = io.BytesIO()
        named: dict[str, Any] = {name.replace("/", " "): each for name, each in scan.arrays().items()}
        np.savez(buffer, **named)
        made = buffer.getvalue()
    return None, {"made": np.frombuffer(made, np.uint8)}


if __name__ == "__main__":
    serve_files(_answer, "LAS, LAZ, E57 and PCD", "laspy, lazrs, pye57 or pypcd4")
