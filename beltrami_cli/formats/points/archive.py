"""NumPy archives of points whose colours can be replaced, the other arrays staying as they are."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from beltrami_cli.errors import InputError
from beltrami_cli.formats.access import EVERYTHING_INSIDE, Access
from beltrami_cli.formats.colours import intensity_scale, point_colour_scale
from beltrami_cli.formats.document import NO_IMAGES, Document, Fingerprint, Written
from beltrami_cli.formats.npz import NpzArchive
from beltrami_cli.formats.points.arrays import find_arrays, read_all, read_faces, require_room
from beltrami_cli.formats.points.repacking import exchanged, members, repacked
from beltrami_cli.surface.records import MeshContents, MovedVertices, PaintedVertices

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from beltrami_cli.formats.points.arrays import CloudArrays
    from beltrami_cli.surface.records import ImageFile, Slot


class NpzPointsDocument(Document):
    """An archive of positions and colours; see `beltrami_cli.formats.points.arrays` for the names.

    Parameters
    ----------
    data : bytes
        The file.
    name : str
        Its name for messages.
    access : Access
        How much memory there is.

    Raises
    ------
    InputError
        If it is no archive of arrays.
    """

    format: ClassVar[str] = "npz"

    def __init__(
        self, data: bytes, name: str, folder: Path | None = None, access: Access = EVERYTHING_INSIDE
    ) -> None:
        super().__init__(name)
        self._data, self._access = data, access
        self._archive = NpzArchive(data, name)

    def painted(self) -> PaintedVertices:
        """Return the points that have a place, with their colours; see `Document.painted`."""
        return self._painted

    @cached_property
    def _painted(self) -> PaintedVertices:
        grey = "intensity" if self._arrays.is_intensity else "grey"
        return PaintedVertices(
            positions=self._positions[self._measured],
            faces=self._faces,
            colours=self._colours,
            channels=("red", "green", "blue") if self._arrays.channels == 3 else (grey,),
            encoding="srgb",
            stored=str(self._stored.dtype),
        )

    def grid(self) -> NDArray[np.int64] | None:
        """Return how the points of an array of two dimensions lie; see `Document.grid`."""
        if len(self._arrays.shape) != 2 or min(self._arrays.shape) < 2 or self._arrays.faces:
            return None
        places = np.full(self._arrays.count, -1, np.int64)
        places[self._measured] = np.arange(len(self._measured))
        return places.reshape(self._arrays.shape)

    def attributes(self) -> tuple[str, ...]:
        """Return the names of the other arrays that have something for each point; see `Document.attributes`."""
        return (*(["normal"] if self._arrays.normals else []), *self._arrays.rest)

    def attribute(self, name: str) -> NDArray[np.float64]:
        """Return what an array has for each point; see `Document.attribute`."""
        fits = [known for known in self.attributes() if known.lower() == name.lower()]
        if not fits:
            return super().attribute(name)
        key = self._arrays.normals if fits[0] == "normal" and self._arrays.normals else fits[0]
        values = self._table(key)[self._measured]
        return np.ascontiguousarray(values, np.float64)

    def patch(
        self,
        colours: NDArray[np.float32] | None,
        stem: str,
        *,
        moved: bool,
        images: Mapping[tuple[Slot, str], ImageFile] = NO_IMAGES,
        places: MovedVertices | None = None,
    ) -> Written:
        """Return the archive with other colours; see `Document.patch`."""
        if colours is None or not (changed := colours != self._colours).any():
            return Written([self._data])
        values = colours[changed].astype(np.float64) * self._scale
        if self._stored.dtype.kind != "f":
            limits = np.iinfo(self._stored.dtype)
            values = np.clip(np.rint(values), limits.min, limits.max)
        rows, channels = np.nonzero(changed)
        stored = self._stored.copy()
        stored[self._measured[rows], channels] = values.astype(stored.dtype)
        key = self._arrays.colours
        header = self._archive.header(key)
        return Written([repacked(self._data, key, header, stored.reshape(header.shape), self.name)])

    def references(self) -> Sequence[str]:
        """Return nothing: there are no files beside."""
        return ()

    def contents(self) -> MeshContents:
        """Return the points and their triangles; see `Document.contents`."""
        painted, arrays = self.painted(), self._arrays
        used = {arrays.positions, arrays.colours, arrays.normals, arrays.faces}
        dropped = [f"the array {name}" for name in self._archive.names if name not in used]
        if len(self._measured) < arrays.count:
            dropped.append("points without a place")
        return MeshContents(
            positions=painted.positions,
            corners=painted.faces.ravel(),
            offsets=3 * np.arange(len(painted.faces) + 1),
            colours=painted.colours,
            encoding="srgb",
            stored=painted.stored,
            alpha=self._alpha(),
            normals=self.attribute("normal").astype(np.float32) if arrays.normals else None,
            left_out=tuple(dropped),
        )

    def fingerprint(self) -> Fingerprint:
        """Take the archive apart; see `Document.fingerprint`."""
        parts = {f"member {name}": content for name, content in members(self._data, self.name).items()}
        if not self.has_vertex_colours():
            return Fingerprint(parts)
        rest = self._stored.copy()
        rest[self._measured, : self._arrays.channels] = 0
        key = self._arrays.colours
        header = self._archive.header(key)
        parts[f"member {key}.npy"] = exchanged(parts[f"member {key}.npy"], header, rest.reshape(header.shape))
        return Fingerprint(parts, {"point colours": self._colours})

    def facts(self) -> dict[str, object]:
        """Return what the archive has."""
        return {
            "format": self.format,
            "points": self._arrays.count,
            "organised": list(self._arrays.shape),
            "arrays": list(self._archive.names),
        }

    @cached_property
    def _arrays(self) -> CloudArrays:
        arrays = find_arrays(self._archive, self.name)
        if not arrays.count:
            raise InputError(self.name, "there are no points", "nothing in it can be smoothed")
        keys = (arrays.positions, arrays.colours, *([arrays.faces] if arrays.faces else []))
        require_room(self._archive, keys, self._access, self.name)
        return arrays

    @cached_property
    def _positions(self) -> NDArray[np.float64]:
        return np.ascontiguousarray(self._table(self._arrays.positions), np.float64)

    @cached_property
    def _measured(self) -> NDArray[np.intp]:
        """Rows of the points that have a place."""
        finite = np.asarray(np.isfinite(self._positions).all(axis=1))
        if finite.all():
            return np.arange(len(finite))
        count = int(np.count_nonzero(~finite))
        if not finite.any() or self._arrays.faces:
            raise InputError(
                self.name, f"{count} of {len(finite)} positions are not finite", "repair the file"
            )
        self.notices.append(f"{count} of {len(finite)} points have no place, and take no part.")
        return np.flatnonzero(finite)

    @cached_property
    def _faces(self) -> NDArray[np.int32]:
        if self._arrays.faces is None:
            return np.empty((0, 3), np.int32)
        return read_faces(self._archive, self._arrays.faces, self._arrays.count, self.name)

    @cached_property
    def _stored(self) -> NDArray[Any]:
        """Colours as stored, with opacity, shape (points, C) or (points, C + 1)."""
        return self._table(self._arrays.colours)

    @cached_property
    def _numbers(self) -> NDArray[np.float64]:
        numbers = self._stored[self._measured, : self._arrays.channels].astype(np.float64)
        finite = np.isfinite(numbers).all(axis=1)
        if not finite.all():
            row = int(self._measured[int(np.argmin(finite))])
            raise InputError(self.name, f"the colour of point {row} is not finite", "repair the file")
        return numbers

    @cached_property
    def _scale(self) -> float:
        if self._stored.dtype in (np.uint8, np.uint16):
            return float(np.iinfo(self._stored.dtype).max)
        intensities = self._arrays.is_intensity
        scale, notice = (
            intensity_scale(self._numbers) if intensities else point_colour_scale(self._numbers, self.name)
        )
        self.notices += [notice] if notice else []
        return scale

    @cached_property
    def _colours(self) -> NDArray[np.float32]:
        return (self._numbers / self._scale).astype(np.float32)

    def _alpha(self) -> NDArray[np.float32] | None:
        if not self._arrays.has_alpha:
            return None
        alpha = self._stored[self._measured, -1].astype(np.float64)
        scale = self._scale if alpha.max(initial=0) > 1 else 1.0
        return np.asarray(np.clip(np.nan_to_num(alpha) / scale, 0, 1), np.float32)

    def _table(self, key: str) -> NDArray[Any]:
        """Read an array as a table with a row for each point."""
        return read_all(self._archive, key).reshape(self._arrays.count, -1)
