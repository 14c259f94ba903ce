"""Point clouds of scanners: LAS, LAZ, E57 and PCD, each read by its library in a process of its own.

The process returns the tables of the points, and whatever else the file holds, as `process` describes. Written back
are the colours or intensities alone.
"""

from __future__ import annotations

import io
from functools import cached_property
from pathlib import Path

import numpy as np

from beltrami_cli.arrays import Array, Float32s
from beltrami_cli.errors import NoColoursError
from beltrami_cli.formats.changes import Changes, Naming, Written
from beltrami_cli.formats.files.foreign_library import ForeignLibrary
from beltrami_cli.formats.fingerprint import Fingerprint
from beltrami_cli.formats.points.cloud import Layout, PointsDocument
from beltrami_cli.formats.points.las import has_index
from beltrami_cli.formats.points.process import FIELD, format_of
from beltrami_cli.formats.points.scan import Arrays
from beltrami_cli.surface.worker_process import Message

_SECONDS_PER_MEBIBYTE = 5  # LAZ: a million points of 3 MiB take a second
_REMEDY = "convert it to PLY, for example with PDAL or CloudCompare"
_LIBRARY = ForeignLibrary("beltrami_cli.formats.points.process", "scans", _SECONDS_PER_MEBIBYTE, _REMEDY)


class SurveyDocument(PointsDocument[str]):
    """A file that its library reads and writes."""

    def _open(self, folder: Path | None) -> None:
        shape, self._tables = self._ask(None, {})
        self._shape = tuple(shape)
        self.format = format_of(self.data)
        self.forms = ("las", "laz") if self.format in ("las", "laz") else (self.format,)

    @cached_property
    def _layout(self) -> Layout[str]:
        fields = {key.removeprefix(FIELD): key for key in self._tables if key.startswith(FIELD)}
        if "colours" not in self._tables:
            cause = f"its points have no colours and no intensity, but {', '.join(fields)[:200] or 'nothing else'}"
            raise NoColoursError(self.name, cause, "export them with colours")
        channels = self._tables["colours"].shape[1]
        layout = Layout(
            positions="positions",
            colours="colours",
            normals="normals" if "normals" in self._tables else None,
            others=fields,
            shape=self._shape,
            channels=channels,
            is_intensity=channels == 1,
        )
        self._require_points(layout, self._tables["positions"].size + self._tables["colours"].size)
        return layout

    def _rows(self, table: str) -> Array:
        return self._tables[table].reshape(len(self._tables["positions"]), -1)

    def _dropped(self) -> list[str]:
        return [f"the {key}" for key in self._tables if key not in ("positions", "colours", "normals")]

    def _patched(self, new: Changes, naming: Naming) -> Written:
        stored, form = self._recoloured(new.colours), new.form or self.format
        if stored is None and form == self.format:
            return Written([self.data])
        left_out = "The index of COPC is left out: the file becomes plain LAS or LAZ."
        notices = (left_out,) if has_index(self.data) else ()
        made = self._ask(form, {} if stored is None else {"new": stored})[1]["made"]
        return Written([made.tobytes()], notices=notices)

    def fingerprint(self) -> Fingerprint:
        tables, colours = dict(self._tables), dict[str, Float32s]()
        if self.has_vertex_colours():
            tables["colours"] = self._stored_without_colours()
            colours["point colours"] = self._colours
        return Fingerprint({name: _as_npy(table) for name, table in tables.items()}, colours)

    def facts(self) -> dict[str, object]:
        return {
            "format": self.format,
            "points": self._layout.count,
            "organised": list(self._layout.shape),
            "fields": list(self._layout.others),
        }

    def _ask(self, form: str | None, arrays: Arrays) -> Message:
        """Ask for the file in a form, with new colours, or, for None, for its shape and tables."""
        question = form, {"data": np.frombuffer(self.data, np.uint8), **arrays}
        return _LIBRARY.ask(question, self.name, len(self.data), self.access.memory)


def _as_npy(table: Array) -> bytes:
    """Return a table with its type and shape, as NumPy stores it."""
    buffer = io.BytesIO()
    np.save(buffer, table)
    return buffer.getvalue()
