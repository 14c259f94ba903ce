"""Text files of points whose colours can be replaced, every other byte staying as it is."""

from __future__ import annotations

import dataclasses
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from beltrami_cli.arrays import Array, Int64s
from beltrami_cli.errors import InputError, NoColoursError
from beltrami_cli.formats.changes import Changes, Naming, Written
from beltrami_cli.formats.colours import display_colours, quantised
from beltrami_cli.formats.files.access import Access
from beltrami_cli.formats.files.edits import new_colours, renumbered, without_tokens
from beltrami_cli.formats.files.tokens import number_lines
from beltrami_cli.formats.fingerprint import Fingerprint
from beltrami_cli.formats.meshes.writing import not_converted
from beltrami_cli.formats.points.cloud import Layout, PointsDocument
from beltrami_cli.formats.points.columns import Columns, find_columns
from beltrami_cli.formats.points.text_table import TextTable, read_table
from beltrami_cli.formats.points.unnamed_columns import NORMAL, RGB
from beltrami_cli.surface.precision import shortest_type
from beltrami_cli.surface.records import MeshContents


class TextPointsDocument(PointsDocument[tuple[int, ...]]):
    """Lines of coordinates and colours, or intensities, under any of their suffixes."""

    def _open(self, folder: Path | None) -> None:
        suffix = Path(self.name).suffix.lower()
        self.format = suffix[1:] if suffix in (".pts", ".csv") else "xyz"

    @property
    def _type(self) -> str:
        return "text"

    def _patched(self, new: Changes, naming: Naming) -> Written:
        if new.colours is None:
            return Written([self.data])
        colours = new_colours(self.data, *self._colour_tokens(), self._colours, new.colours, self._scale)
        return Written(renumbered(self.data, [colours]))

    def _dropped(self) -> list[str]:
        others = self._columns.others
        return [f"columns {', '.join(others)}"] if others else []

    def fingerprint(self) -> Fingerprint:
        if not self._has_colours():
            return Fingerprint({"lines": self.data})
        starts, ends = (np.sort(places.ravel()) for places in self._colour_tokens())
        lines = without_tokens(self.data, starts, ends)
        return Fingerprint({"lines": lines}, {"point colours": self._colours})

    def facts(self) -> dict[str, object]:
        return {
            "format": self.format,
            "points": len(self._table.values),
            "columns": list(self._table.names or self._columns.names),
            "announced": list(self._table.counts),
        }

    def access_to_copies(self) -> Access:
        # The values of the new colours must not influence the choice of columns.
        known = self._columns.names if self._has_colours() else self.access.columns
        return dataclasses.replace(self.access, columns=known)

    def _has_colours(self) -> bool:
        """Whether there are colours that can be used; InputError if it is not clear which these are."""
        try:
            return bool(self._columns.colours) and self.has_vertex_colours()
        except NoColoursError:
            return False

    @cached_property
    def _table(self) -> TextTable:
        table = read_table(self.data, self.name, self.access.columns)
        if not len(table.values):
            raise InputError(self.name, "there are no points", "nothing in it can be smoothed")
        return table

    @cached_property
    def _columns(self) -> Columns:
        table = self._table
        return find_columns(table.names, table.values, self.name, is_pts=bool(table.counts))

    @property
    def notices(self) -> tuple[str, ...]:
        return (self._columns.notice,) if self._columns.notice else ()

    @cached_property
    def _layout(self) -> Layout[tuple[int, ...]]:
        columns = self._columns
        return Layout(
            positions=columns.position,
            colours=columns.colours,
            normals=columns.normal or None,
            others={name: (column,) for name, column in columns.others.items()},
            shape=(len(self._table.values),),
            channels=len(columns.colours),
            is_intensity=len(columns.colours) == 1,
        )

    def _rows(self, table: tuple[int, ...]) -> Array:
        return self._table.values[:, table]

    def _colour_tokens(self) -> tuple[Int64s, Int64s]:
        tokens = np.ix_(self._measured, np.array(self._columns.colours))
        return self._table.starts[tokens], self._table.ends[tokens]


def _written(mesh: MeshContents, stem: str, *, separator: str = " ", head: str = "") -> Written:
    """Write points as lines of x y z r g b, then normals; colours are whole numbers from 8 bit, else of 0 to 1."""
    colours, notices = display_colours(mesh)
    if mesh.alpha is not None:
        notices.append("Opacity is dropped: a line has red, green and blue only.")
    if len(mesh.sizes):
        notices.append("Faces are dropped: the file has points only.")
    whole = mesh.stored == "uint8" and mesh.encoding == "srgb"
    shades = quantised(colours, np.uint8 if whole else np.float32)
    tables: list[Array] = [shortest_type(mesh.positions), shades]
    names, style = ["x", "y", "z", *RGB], ["%s", "%s", "%s", *["%d" if whole else "%.6f"] * 3]
    if mesh.normals is not None:
        tables, names, style = [*tables, mesh.normals], [*names, *NORMAL], [*style, "%s", "%s", "%s"]
    first = head.format(count=len(mesh.positions), names=separator.join(names)).encode()
    pieces = [first, *number_lines(separator.join(style) + "\n", *tables)]
    return Written(pieces, notices=(*notices, *not_converted(mesh)))


write_xyz, write_pts = _written, partial(_written, head="{count}\n")
write_csv = partial(_written, separator=",", head="{names}\n")
