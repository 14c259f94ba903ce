"""Which vertex properties of a PLY file are colours, what their numbers mean, and what other properties there are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import InputError, UnpaintedError
from beltrami_cli.formats.colours import full_scale, intensity_scale
from beltrami_cli.surface.geometry import unit_vectors

if TYPE_CHECKING:
    from collections.abc import Mapping

    from beltrami_cli.arrays import Array, Float32s, Float64s
    from beltrami_cli.formats.ply.header import Element, Header
    from beltrami_cli.formats.ply.tables import Table

POSITION = ("x", "y", "z")
NORMAL = ("nx", "ny", "nz")
_COLOURS = (
    (("red", "green", "blue"), "alpha"),
    (("diffuse_red", "diffuse_green", "diffuse_blue"), "diffuse_alpha"),
    (("r", "g", "b"), "a"),
    (("gray",), "alpha"),
    (("grey",), "alpha"),
)
_INTENSITY = "intensity"  # a colour in scans, any scalar elsewhere
_INTENSITIES_OF_POINTS = (_INTENSITY, "Intensity", "scalar_intensity", "scalar_Intensity", "reflectance")


@dataclass(frozen=True)
class Paint:
    """The colour properties of the vertices."""

    names: tuple[str, ...]  # in the file: red, green and blue, or grey alone
    alpha: str  # the property of the opacity, or empty
    type: str  # NumPy code of the type that all colours have
    any_range: bool = False  # whether they are intensities, of which any number may be full scale

    @property
    def channels(self) -> tuple[str, ...]:
        if len(self.names) == 3:
            return ("red", "green", "blue")
        return ("intensity",) if self.any_range else ("grey",)


def find_paint(header: Header, vertices: Table, name: str) -> Paint:
    """Find the colour properties; InputError if there are none, or they are signed or of several types."""
    types = vertices.element.scalars
    for names, alpha in _COLOURS:
        if all(known in types for known in names):
            kinds = {types[known] for known in names}
            if len(kinds) > 1:
                raise InputError(name, f"{', '.join(names)} are of several types", "store them in one type")
            return Paint(names, alpha if alpha in types else "", _unsigned(kinds.pop(), names, name))
    if _INTENSITY in types and _is_grey(vertices, types[_INTENSITY]):
        return Paint((_INTENSITY,), "alpha" if "alpha" in types else "", types[_INTENSITY])
    if not any(element.count for element in header.elements if element.name in ("face", "tristrips")):
        for known in _INTENSITIES_OF_POINTS:
            if known in types:
                return Paint((known,), "alpha" if "alpha" in types else "", types[known], any_range=True)
    raise _unpainted(header, vertices.element, name)


def _unsigned(kind: str, names: tuple[str, ...], name: str) -> str:
    if kind[0] == "i":
        cause = f"{', '.join(names)} are signed ({np.dtype(kind)}), for which no full scale is agreed"
        raise InputError(name, cause, "store colours as uchar, ushort or float")
    return kind


def _is_grey(vertices: Table, kind: str) -> bool:
    if kind[0] != "f":
        return kind[0] == "u"
    values = vertices.scalars(_INTENSITY)
    return bool(((values >= 0) & (values <= 1)).all())


def _unpainted(header: Header, vertices: Element, name: str) -> UnpaintedError:
    known = ", ".join(known.name for known in vertices.properties)
    faces = header.element("face")
    on_faces = faces is not None and any(known.name == "red" for known in faces.properties)
    return UnpaintedError(
        name,
        f"no vertex colours among the vertex properties {known[:300]}"
        + (", only face colours" if on_faces else ""),
        "export the mesh with vertex colours, which are the properties red, green, blue",
    )


@dataclass(frozen=True)
class Colours:
    """Colours as read."""

    values: Float32s  # (V, C), full scale 1
    scale: float  # the stored number that is full scale
    notice: str  # about the scale, or empty


def read_colours(vertices: Table, paint: Paint, name: str) -> Colours:
    """Read the colours of all vertices, of which there is one at least."""
    values = np.empty((vertices.element.count, len(paint.names)), np.float32)
    if paint.type[0] == "u":
        columns = [vertices.scalars(known) for known in paint.names]
        scale, notice = _integer_scale(columns, paint.type)
    else:
        stored = finite_columns(vertices, paint.names, "colour", name)
        scale, notice = intensity_scale(stored) if paint.any_range else full_scale(stored, name)
        columns = list(stored.T)
    for channel, column in enumerate(columns):
        values[:, channel] = column / scale
    return Colours(values, scale, notice)


def _integer_scale(columns: list[Array], kind: str) -> tuple[float, str]:
    largest = max(int(column.max()) for column in columns)
    if kind == "u4" and largest <= 255:
        return 255.0, "Vertex colours are 32-bit integers up to 255 and are taken for numbers of 0..255."
    return float(np.iinfo(kind).max), ""


def store_colours(values: Float32s, scale: float, kind: str) -> Array:
    """Round colours of full scale 1 to their stored type, to the nearest; integers are clipped to their range."""
    wide = values.astype(np.float64)
    if kind[0] == "f":
        return (wide * scale).astype(kind)
    limits = np.iinfo(kind)
    return np.rint(np.clip(wide * scale, limits.min, min(limits.max, scale))).astype(kind)


def finite_columns(vertices: Table, names: tuple[str, ...], what: str, name: str) -> Float64s:
    """Read some scalars of all vertices, shape (V, len(names)); InputError if one is not finite."""
    values = np.empty((vertices.element.count, len(names)))
    with np.errstate(invalid="ignore"):  # Signalling NaNs warn when they are made wider.
        for column, known in enumerate(names):
            values[:, column] = vertices.scalars(known)
    finite = np.isfinite(values).all(axis=1)
    if not finite.all():
        raise InputError(
            name, f"the {what} of vertex {int(np.argmin(finite))} is not finite", "repair the file"
        )
    return values


def attribute_names(kinds: Mapping[str, str], colours: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of attributes: "normal" if there are three real components of one, and single properties."""
    others = tuple(name for name in kinds if name not in (*POSITION, *colours))
    real = all(kinds.get(name, "")[:1] == "f" for name in NORMAL)
    return (*(("normal",) if real else ()), *others)


def read_attribute(vertices: Table, name: str, file: str) -> Float64s:
    """Read an attribute of all vertices, shape (V, G); normals become unit vectors."""
    if name != "normal":
        return finite_columns(vertices, (name,), name, file)
    return unit_vectors(finite_columns(vertices, NORMAL, name, file))
