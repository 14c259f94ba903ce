"""Arrays and keywords that users give, checked and as the records that smoothing takes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, get_args

import numpy as np
from numpy.typing import ArrayLike

from beltrami_cli.arrays import Array, Float32s, Float64s, Int32s
from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.fields import override
from beltrami_cli.flow.manifolds.guides import Guide, centred
from beltrami_cli.formats.colours import quantised
from beltrami_cli.formats.image.decoded_image import DecodedImage, array_image
from beltrami_cli.layers.image_surface import ImageSurface
from beltrami_cli.layers.settings import SmoothSettings
from beltrami_cli.surface.precision import check_scale, require_finite, require_single
from beltrami_cli.surface.records import ColouredVertices, Encoding, Texture, TexturedSurface

_ARRAYS = "the arrays"  # as messages call them
# Positions, triangles and colours of a TriangleMesh and a PointCloud of Open3D, and where tensor-based ones have them.
_OPEN3D = (("vertices", "triangles", "vertex_colors"), ("points", "", "colors"))
_OPEN3D_TENSORS = (("vertex", "triangle"), ("point", ""))


class MeshArrays(NamedTuple):
    """A mesh, or a cloud of points, as arrays.

    Attributes
    ----------
    positions : array_like, shape (V, 3)
    faces : array_like of int, shape (F, 3), or None
        Triangles as vertex indices; None: points.
    colours : array_like, shape (V, 3) or (V, 4), or None
        Colours of vertices; the fourth channel is opacity.
    uv : array_like, shape (V, 2) or (F, 3, 2), or None
        Texture coordinates of vertices, or of the corners of faces.
    image : array_like, shape (H, W) or (H, W, C), or None
        The texture, row 0 the upper one.
    """

    positions: ArrayLike
    faces: ArrayLike | None = None
    colours: ArrayLike | None = None
    uv: ArrayLike | None = None
    image: ArrayLike | None = None


def _of_trimesh(mesh: Any) -> MeshArrays:
    """Return the arrays of a Trimesh or PointCloud: colours of vertices, or texture coordinates and the base colour."""
    visual, faces = getattr(mesh, "visual", None), getattr(mesh, "faces", None)
    if visual is None:
        kind = type(mesh).__name__
        raise UsageError(
            f"{kind} is neither a Trimesh nor a PointCloud; give the meshes of a scene one by one"
        )
    if visual.kind == "face":
        raise UsageError("the mesh has colours of faces; set mesh.visual.vertex_colors")
    arrays = MeshArrays(np.asarray(mesh.vertices), None if faces is None else np.asarray(faces))
    if visual.kind != "texture":
        is_coloured = visual.kind == "vertex" and len(visual.vertex_colors)
        return arrays._replace(colours=np.asarray(visual.vertex_colors) if is_coloured else None)
    if hasattr(visual.material, "materials"):
        raise UsageError("the mesh has several materials; give smooth_textured images and texture_of")
    image = getattr(visual.material, "baseColorTexture", getattr(visual.material, "image", None))
    return arrays._replace(uv=visual.uv, image=None if image is None else image_array(image, "image"))


def mesh_arrays(mesh: Any) -> MeshArrays | None:
    """Return the arrays of a mesh of trimesh, PyVista or Open3D, by its attributes; None if it is none of these."""
    if isinstance(mesh, MeshArrays):
        return mesh
    if hasattr(mesh, "visual") or hasattr(mesh, "geometry"):
        return _of_trimesh(mesh)
    if hasattr(mesh, "point_data"):
        padded = np.asarray(getattr(mesh, "faces", [0]))  # each face: its number of corners, and these
        if len(padded) % 4 or (padded[::4] != 3).any() or mesh.n_strips:
            raise UsageError("the mesh is not a PolyData of triangles; call extract_surface().triangulate()")
        active_first = sorted(mesh.point_data.keys(), key=lambda name: name != mesh.active_scalars_name)
        tables = (np.asarray(mesh.point_data[name]) for name in active_first)
        shades = (table for table in tables if table.dtype == np.uint8 and table.shape[1:] in ((3,), (4,)))
        faces = padded.reshape(-1, 4)[:, 1:] if len(padded) else None
        return MeshArrays(np.asarray(mesh.points), faces, next(shades, None))
    for names in _OPEN3D:
        if hasattr(mesh, names[0]) and hasattr(mesh, names[2]):
            places, faces, colours = (np.asarray(getattr(mesh, name, [])) for name in names)
            return MeshArrays(places, faces if len(faces) else None, colours if len(colours) else None)
    for of_vertices, of_faces in _OPEN3D_TENSORS:
        vertices, triangles = getattr(mesh, of_vertices, {}), getattr(mesh, of_faces, {})
        if "positions" in vertices:
            own, uv = _from_tensor(vertices, "colors"), _from_tensor(triangles, "texture_uvs")
            return MeshArrays(
                vertices["positions"].cpu().numpy(), _from_tensor(triangles, "indices"), own, uv
            )
    return None


def _from_tensor(table: Any, key: str) -> Array | None:
    """Return a tensor of Open3D, which may be on a graphics card, as an array; None if it is not there."""
    return table[key].cpu().numpy() if key in table else None


def unpacked(
    mesh: Any, faces: ArrayLike | None, colours: ArrayLike | None
) -> tuple[ArrayLike, ArrayLike | None, ArrayLike, Array | None]:
    """Return positions, faces and colours, given as arrays or as a mesh, and the opacity of a mesh, shape (V, 1)."""
    arrays, opacity = mesh_arrays(mesh), None
    if arrays is None:
        arrays = MeshArrays(mesh, faces)
    elif faces is not None:
        raise UsageError("a mesh has faces; give either a mesh or positions and faces")
    elif colours is None and arrays.colours is not None:
        colours = array_of(arrays.colours, "colours")
        if colours.ndim == 2 and colours.shape[1] == 4:
            colours, opacity = colours[:, :3], colours[:, 3:]
    if colours is None:
        raise UsageError("there are no colours of vertices; give them, or a texture to smooth_textured")
    return arrays.positions, arrays.faces, colours, opacity


def settings_for(
    settings: SmoothSettings, guide: ArrayLike | None, channels: Sequence[str], shape: tuple[int, ...],
    overrides: dict[str, Any],
) -> tuple[SmoothSettings, list[Guide], Float32s | None]:  # fmt: skip
    """Return the settings with overrides, guides, and deviations of noise: a row for each vertex or pixel."""
    noise = _deviations_in(overrides, shape)
    wanted = overrides.get("metric_channels")
    if wanted is not None:
        overrides["metric_channels"] = tuple(_channel(each, channels) for each in wanted)
    if guide is not None:
        overrides["guides"] = ("guide",)
    settings = override(settings, **overrides)
    if settings.space == "oklab" and len(channels) != 3:
        raise UsageError("the space oklab needs three channels")
    if guide is None:
        return settings, [], noise
    (_, beta), *_ = settings.embedding.weighted_guides
    return settings, [Guide("guide", centred(guide_table(guide, shape)), beta)], noise


def _deviations_in(overrides: dict[str, Any], shape: tuple[int, ...]) -> Float32s | None:
    """Take the noise out of overrides if it is an array of standard deviations."""
    if overrides.get("noise") is None or isinstance(overrides["noise"], str):
        return None
    table = guide_table(overrides.pop("noise"), shape, "noise")
    if table.min(initial=0) < 0 or table.max(initial=0) > 1:
        raise UsageError("the noise must be standard deviations from 0 to a full scale of 1")
    return table.astype(np.float32)


def _channel(channel: object, names: Sequence[str]) -> str:
    if isinstance(channel, str) and channel in names:
        return channel
    if not isinstance(channel, (int, np.integer)) or not 0 <= channel < len(names):
        raise UsageError(f"metric_channels names {channel!r}, but the {len(names)} channels count from 0")
    return names[int(channel)]


def require_choice(name: str, value: str, choices: Sequence[str] = get_args(Encoding)) -> None:
    """Raise UsageError if an argument is none of its choices; by default it is an encoding."""
    if value not in choices:
        raise UsageError(f"{name} is {value}, but must be {' or '.join(choices)}")


def vertices_of_arrays(
    positions: ArrayLike, faces: ArrayLike | None, colours: ArrayLike, encoding: Encoding
) -> ColouredVertices:
    """Check the arrays of a mesh, or of points; channels have names, or else their numbers."""
    require_choice("encoding", encoding)
    places, shades = position_table(positions), colour_table(colours)
    names = ("red", "green", "blue") if shades.shape[1] == 3 else tuple(map(str, range(shades.shape[1])))
    stored = str(np.asarray(colours).dtype)
    triangles = face_table([] if faces is None else faces, len(places))
    if len(places) != len(shades):
        raise InputError(_ARRAYS, f"there are {len(places)} positions but {len(shades)} colours")
    require_finite(places, _ARRAYS, "the position of vertex")
    check_scale(places, triangles, _ARRAYS)
    return ColouredVertices(places, triangles, shades, names, encoding, stored)


def checked_surface(surface: ImageSurface | None, table: Float32s, shape: tuple[int, int]) -> ImageSurface:
    """Check where pixels lie; where a colour, height or position is not finite is a hole, too."""
    valid = np.asarray(np.isfinite(table.reshape(*shape, -1)).all(axis=2))
    if surface is None:
        return ImageSurface(valid=valid)
    if surface.positions is not None and surface.heights is not None:
        raise UsageError("positions and heights are two surfaces for one image; give one of them")
    positions, heights = surface.positions, surface.heights
    if positions is not None:
        positions = _numbers(positions, "positions", (*shape, "M")).astype(np.float64)
        valid &= np.isfinite(positions).all(axis=2)
    if heights is not None:
        heights = _numbers(heights, "heights", shape).astype(np.float64)
        valid &= np.isfinite(heights)
    if surface.valid is not None:
        valid &= _numbers(surface.valid, "valid", shape, "bui").astype(bool)
    return ImageSurface(heights, positions, valid)


def pixel_colours(colours: ArrayLike) -> tuple[Float32s, tuple[int, int]]:
    """Return the colours of all pixels, shape (H * W, C), and the shape (H, W)."""
    image = array_of(colours, "colours")
    if image.ndim not in (2, 3) or image.size == 0:
        raise UsageError(f"colours must be of shape (H, W) or (H, W, C), not {image.shape}")
    rows, columns = image.shape[:2]
    return colour_table(image.reshape(rows * columns, -1)), (rows, columns)


def position_table(positions: ArrayLike) -> Float64s:
    """Take positions of any numeric type, shape (V, M); an empty list has M = 3."""
    table = array_of(positions, "positions")
    table = _numbers(table.reshape(0, 3) if table.shape == (0,) else table, "positions", ("V", "M"))
    with np.errstate(over="ignore"):  # too large numbers become infinite, which is refused
        return np.ascontiguousarray(table, np.float64)


def face_table(faces: ArrayLike, count: int) -> Int32s:
    """Take triangles of any integer type, shape (F, 3), indices in [0, count); nothing wraps or is cut off."""
    table = array_of(faces, "faces")
    if table.shape in ((0,), (0, 3)):
        return np.empty((0, 3), np.int32)
    if _numbers(table, "faces", ("F", 3), "buifO").dtype.kind not in "ui":
        raise UsageError(f"faces must be whole numbers, not {table.dtype}")
    wrong = ((table < 0) | (table >= count)).any(axis=1)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise UsageError(f"face {row} is {table[row].tolist()}, but there are {count} vertices, from 0 on")
    return np.ascontiguousarray(table, np.int32)


def colour_table(colours: ArrayLike) -> Float32s:
    """Take colours, shape (V, C) or (V,): floats as they are, unsigned integers by their full scale."""
    table = array_of(colours, "colours")
    if table.ndim == 1:
        table = table[:, None] if len(table) else table.reshape(0, 3)
    if _numbers(table, "colours", ("V", "C")).dtype.kind == "f":
        require_single(table, _ARRAYS, "the colour of sample", holes=True)
        return np.ascontiguousarray(table, np.float32)
    # The full scale of other integers is unknown: a list of 0 to 255 becomes int64.
    if table.dtype not in (np.uint8, np.uint16, np.uint32):
        remedy = "give uint8, as 0 to 255, or floats, as 0 to 1"
        raise UsageError(f"colours of type {table.dtype} have no full scale; {remedy}")
    return np.ascontiguousarray(table / np.iinfo(table.dtype).max, np.float32)


def in_type_of(given: Array, before: Array, after: Array) -> Array:
    """Return new colours in the type of the given ones, rounded as in files; what did not change keeps its bits.

    `before` and `after`: floats of full scale 1, or of the type of the given ones already.
    """
    if after.dtype == given.dtype:
        return after
    result = given.reshape(after.shape).copy()
    is_new = (after != before) & ~np.isnan(before)
    result[is_new] = quantised(after[is_new], given.dtype)
    return result


def image_array(image: Any, name: str) -> Array:
    """Make an array of an image; one of Pillow whose numbers are not grey, red, green and blue is converted."""
    mode = getattr(image, "mode", None)
    if mode is not None and mode not in ("L", "LA", "RGB", "RGBA", "I;16", "F"):
        has_alpha = mode == "PA" or "transparency" in image.info
        image = image.convert("RGBA" if has_alpha else "RGB")
    return array_of(image, name)


def textured_surface(
    mesh: MeshArrays, names: Sequence[str], texture_of: ArrayLike | None, origin: str
) -> TexturedSurface:
    """Check positions, faces and texture coordinates, with v from an edge, for images of some names."""
    if mesh.uv is None or mesh.faces is None:
        raise UsageError("the mesh has no texture coordinates; give MeshArrays(positions, faces, uv=uv)")
    require_choice("origin", origin, ("lower", "upper"))
    positions = _numbers(position_table(mesh.positions), "positions", ("V", 3))
    require_finite(positions, _ARRAYS, "the position of vertex")
    faces, uv = face_table(mesh.faces, len(positions)), array_of(mesh.uv, "uv")
    if uv.ndim == 2:
        uv = _numbers(uv, "uv", (len(positions), 2))[faces]
    uv = _numbers(uv, "uv", (len(faces), 3, 2)).astype(np.float64)
    image_of = np.zeros(len(faces), np.int32) if texture_of is None else texture_of
    image_of = _numbers(image_of, "texture_of", (len(faces),), "ui")
    is_clear = len(names) == 1 or (names and texture_of is not None)
    if not is_clear or not np.isin(image_of, range(-1, len(names))).all():
        raise UsageError(f"there are {len(names)} images; texture_of must give each face one of them, or -1")
    shown = np.flatnonzero(image_of >= 0)
    require_finite(uv[shown].reshape(-1, 6), _ARRAYS, "uv of face", shown)
    check_scale(positions, faces[shown], _ARRAYS)
    if origin == "lower":
        uv[..., 1] = 1 - uv[..., 1]
    textures = tuple(Texture(name, name, b"") for name in names)
    return TexturedSurface(positions, faces, uv, image_of.astype(np.int32), textures)


def guide_table(values: ArrayLike, shape: tuple[int, ...], name: str = "guide") -> Float64s:
    """Take a guide: any finite numbers of `shape`, or with channels behind it; a row a vertex or pixel."""
    table = array_of(values, name)
    table = _numbers(
        table[..., None] if table.shape == shape else table, f"the {name}", (*shape, "G"), "buif"
    )
    rows = table.reshape(-1, table.shape[-1]).astype(np.float64)
    require_single(rows, _ARRAYS, f"the {name} of sample")
    return rows


def array_of(values: ArrayLike, name: str) -> Array:
    """Make an array of anything like one; UsageError, with the name, if its rows are of several lengths."""
    try:
        return np.asarray(values)
    except (TypeError, ValueError, OverflowError) as error:
        raise UsageError(f"{name} must be a table whose rows have the same length") from error


def _numbers(values: ArrayLike, name: str, shape: tuple[int | str, ...], kinds: str = "uif") -> Array:
    """Take numbers of a shape, in which a letter is any length; only the first axis may be empty."""
    array = array_of(values, name)
    fits = array.ndim == len(shape) and 0 not in array.shape[1:]
    fits = fits and all(isinstance(b, str) or a == b for a, b in zip(array.shape, shape, strict=True))
    if not fits or array.dtype.kind not in kinds:
        wanted = ", ".join(map(str, shape))
        raise UsageError(
            f"{name} must be numbers of shape ({wanted}), not {array.dtype} of shape {array.shape}"
        )
    return array


def textures_of(images: Sequence[Array], encoding: Encoding) -> list[DecodedImage]:
    """Take textures: numbers as for `colour_table`, grey or RGB, with opacity or without."""
    require_choice("encoding", encoding)
    pictures = []
    for number, image in enumerate(images):
        name = f"image {number}"
        if image.ndim not in (2, 3) or image.size == 0 or image.shape[2:] > (4,):
            wanted = "(H, W), or (H, W, C) with C from 1 to 4"
            raise UsageError(f"{name} must be of shape {wanted}, not {image.shape}")
        pixels, kind = image.reshape(*image.shape[:2], -1), image.dtype
        if kind not in (np.uint8, np.uint16):
            pixels = colour_table(pixels.reshape(-1, pixels.shape[2])).reshape(pixels.shape)
            if not np.isfinite(pixels).all():
                raise InputError(name, "some of its values are not finite", "repair it")
        stored = "float16" if kind == np.float16 else str(pixels.dtype)
        pictures.append(array_image(pixels, name, encoding, stored))
    return pictures
