"""The colours of a PLY file: which properties they are, and their values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from beltrami_cli.arrays import Float32s
from beltrami_cli.errors import InputError, NoColoursError
from beltrami_cli.formats.full_scale import full_scale, integer_scale, intensity_scale
from beltrami_cli.formats.ply.header import POSITION, Header
from beltrami_cli.formats.ply.polygons import POLYGONS
from beltrami_cli.formats.ply.tables import COLOUR_PROPERTIES, Table, plain
from beltrami_cli.surface.precision import require_single

# Names of colours and opacity, as `plain` returns them; "colour 0" is a channel of a list or of a packed number.
_COLOURS = (
    (("red", "green", "blue"), "alpha"),
    (("diffuse_red", "diffuse_green", "diffuse_blue"), "diffuse_alpha"),
    (("r", "g", "b"), "a"),
    *((tuple(f"{each} {n}" for n in range(3)), f"{each} 3") for each in COLOUR_PROPERTIES),
    (("gray",), "alpha"),
    (("grey",), "alpha"),
)
_INTENSITY = "intensity"  # a colour in scans, any scalar elsewhere
_INTENSITIES = (_INTENSITY, "reflectance")
# Gaussian splats as trained, and as PlayCanvas packs them.
_SPLATS = ({"f_dc_0", "rot_0"}, {"packed_rotation", "packed_scale"})


@dataclass(frozen=True)
class ColourProperties:
    """The colour properties of the vertices, or of the faces."""

    names: tuple[str, ...]  # in the table: red, green and blue, or grey alone
    alpha: str  # the property of the opacity, or empty
    type: str  # NumPy code of the type that all colours have
    element: str = "vertex"
    # Whether they are a scalar, such as an intensity, whose full scale may be any number.
    any_range: bool = False

    @property
    def channels(self) -> tuple[str, ...]:
        if len(self.names) == 3:
            return ("red", "green", "blue")
        is_named = self.any_range and plain(self.names[0]) not in _INTENSITIES
        return (self.names[0].lower() if is_named else "intensity",) if self.any_range else ("grey",)


def find_colours(
    header: Header, vertices: Table, faces: Table | None, wanted: Sequence[str] = ()
) -> ColourProperties:
    """Find the colour properties; InputError if there are none, or they are of type char or of several types.

    `wanted`: channels that are asked for; one that is not a colour may be any scalar.
    """
    types, name = vertices.element.scalars, vertices.body.name
    if (found := _scalar(types, wanted) or _by_name(vertices)) is not None:
        return found
    has_faces = any(element.count for element in header.elements if element.name in POLYGONS)
    if _INTENSITY in types and _is_grey(vertices, types[_INTENSITY], "iu" if has_faces else "u"):
        return ColourProperties((_INTENSITY,), "alpha" if "alpha" in types else "", types[_INTENSITY])
    if faces is not None and faces.element.count and (found := _by_name(faces)) is not None:
        return found
    for label in types:
        if plain(label) in _INTENSITIES:
            return ColourProperties(
                (label,), "alpha" if "alpha" in types else "", types[label], any_range=True
            )
    among = ", ".join(prop.name for prop in vertices.element.properties)[:300]
    cause = f"no vertex colours among the vertex properties {among}"
    remedy = "export the mesh with vertex colours, which are red, green, blue, or name a scalar by --channels"
    raise NoColoursError(name, cause, remedy)


def _scalar(types: Mapping[str, str], wanted: Sequence[str]) -> ColourProperties | None:
    """Return the only wanted channel if a property has its name, which is none of positions and colours."""
    taken = {*POSITION, *_INTENSITIES, *(word for words, _ in _COLOURS for word in words)}
    named = {label.lower(): label for label in types if plain(label) not in taken}
    label = named.get(wanted[0].lower()) if len(wanted) == 1 else None
    return None if label is None else ColourProperties((label,), "", types[label], any_range=True)


def _by_name(table: Table) -> ColourProperties | None:
    types, name = table.element.scalars, table.body.name
    actual = {plain(label): label for label in reversed(types)}
    for words, alpha in _COLOURS:
        if not actual.keys() >= {*words}:
            continue
        names = tuple(actual[word] for word in words)
        kinds = {types[label] for label in names}
        if len(kinds) > 1:
            raise InputError(name, f"{', '.join(names)} are of several types", "store them in one type")
        kind = kinds.pop()
        if kind == "i1":
            cause = f"{', '.join(names)} are of type char, which holds no more than 127"
            raise InputError(name, cause, "store colours as uchar, ushort or float")
        return ColourProperties(names, actual.get(alpha, ""), kind, table.element.name)
    return None


def require_no_splats(header: Header, name: str) -> None:
    """Raise InputError for Gaussian splats: their colours are coefficients of light by direction."""
    vertices = header.vertex
    if vertices is not None and any(vertices.scalars.keys() >= names for names in _SPLATS):
        cause = "it holds Gaussian splats, which are not points or triangles of a surface"
        raise InputError(name, cause, "smooth the photographs, or a mesh that is extracted from the splats")


def _is_grey(vertices: Table, kind: str, integers: str) -> bool:
    if kind[0] != "f":
        return kind[0] in integers and kind != "i1"
    values = vertices.scalars(_INTENSITY)
    return bool(((values >= 0) & (values <= 1)).all())


class Colours(NamedTuple):
    """Colours as read."""

    values: Float32s  # (V, C), full scale 1
    scale: float  # the stored number that is full scale
    notice: str  # about the scale, or empty


def read_colours(vertices: Table, properties: ColourProperties) -> Colours:
    """Read the colours of all vertices, at least one."""
    values = np.empty((vertices.element.count, len(properties.names)), np.float32)
    if properties.any_range or properties.type[0] == "f":
        stored = vertices.columns(properties.names, "colour")
        require_single(stored, vertices.body.name, f"the colour of {vertices.element.name}")
        scale, notice = (
            intensity_scale(stored) if properties.any_range else full_scale(stored, vertices.body.name)
        )
        columns = list(stored.T)
    else:
        columns = [vertices.scalars(name) for name in properties.names]
        # Opacity of the same type has the same full scale, which it mostly reaches.
        has_same_type = vertices.element.scalars.get(properties.alpha) == properties.type
        with_alpha = [*columns, *([vertices.scalars(properties.alpha)] if has_same_type else [])]
        largest = max(max(int(column.max()), -int(column.min())) for column in with_alpha)
        is_intensity = properties.names == (_INTENSITY,)
        scale, notice = integer_scale(largest, properties.type, is_intensity=is_intensity)
    for channel, column in enumerate(columns):
        values[:, channel] = column / scale
    return Colours(values, scale, notice)
