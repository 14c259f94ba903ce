"""Draw painted meshes side by side: ``python sample_data/picture.py BEFORE.glb AFTER.glb OUT.png``.

Every triangle is cut into points finer than a pixel, and the nearest point wins. Colours are shown as they
are, without light, because it is the colours that are to be judged; ``--shade`` adds light to show the shape.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from beltrami_cli.mesh.textured import Texture, TexturedSurface

    # Colours of points, shape (K, 3), by their triangles and barycentric weights.
    Paint = Callable[[NDArray[np.int64], NDArray[np.float64]], NDArray[np.float64]]

SUPERSAMPLING = 2
BACKGROUND = 0.96


def main(arguments: list[str] | None = None) -> int:
    """Read the files, draw them, and write the picture."""
    parser = argparse.ArgumentParser(description="Draw painted meshes side by side.")
    parser.add_argument("meshes", nargs="+", type=Path, metavar="MESH")
    parser.add_argument("picture", type=Path, metavar="OUT.png")
    parser.add_argument("--size", type=int, default=640, help="pixels along a side of each view")
    parser.add_argument("--turn", type=float, default=0.0, help="degrees to the right about the vertical")
    parser.add_argument("--tilt", type=float, default=0.0, help="degrees towards a view from above")
    parser.add_argument("--shade", action="store_true", help="light the shape")
    options = parser.parse_args(arguments)
    angles = options.turn, options.tilt
    views = [draw(*read(path), options.size, angles, shade=options.shade) for path in options.meshes]
    write(np.hstack(views), options.picture)
    return 0


def read(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int32], Paint]:
    """Return positions, triangles and the painting of a file: its textures, or else its vertex colours."""
    from beltrami_cli.formats.source import open_document

    document = open_document(str(path))
    if "baseColor" in document.slots():
        surface = document.textured("baseColor")
        return surface.positions, surface.faces, textured(surface)
    painted = document.painted()
    channels = (0, 1, 2) if painted.colours.shape[1] >= 3 else (0, 0, 0)
    colours = np.clip(painted.colours[:, channels], 0, 1)
    if document.format in ("glb", "gltf"):
        from images import displayed

        colours = displayed(colours)
    return painted.positions, painted.faces, at_vertices(painted.faces, colours)


def at_vertices(faces: NDArray[np.int32], colours: NDArray[np.floating]) -> Paint:
    """Return the painting of a surface with vertex colours, shape (V, 3)."""
    return lambda face, weights: mixed(weights, colours[faces[face]])


def textured(surface: TexturedSurface) -> Paint:
    """Return the painting of a surface with textures; what has none is grey."""
    sheets = [pixels_of(texture) for texture in surface.textures]

    def paint(face: NDArray[np.int64], weights: NDArray[np.float64]) -> NDArray[np.float64]:
        colours, uv = np.full((len(face), 3), 0.6), mixed(weights, surface.uv[face])
        for number, texture in enumerate(surface.textures):
            mine = surface.texture_of[face] == number
            colours[mine] = looked_up(sheets[number], uv[mine], texture.wrap)
        return colours

    return paint


def mixed(weights: NDArray[np.float64], corners: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return values at points of triangles, shape (K, C), from those at the corners, shape (K, 3, C)."""
    return np.einsum("kc,kcx->kx", weights, corners)


def pixels_of(texture: Texture) -> NDArray[np.float64]:
    """Return an image as display values, shape (H, W, 3)."""
    from images import decode, displayed

    kinds = {b"\x89PNG": ".png", b"\xff\xd8": ".jpg", b"v/1\x01": ".exr", b"RIFF": ".webp"}
    suffix = next(
        (s for mark, s in kinds.items() if texture.data.startswith(mark)), Path(texture.name).suffix
    )
    stored = decode(texture.data, suffix)
    is_integer = stored.dtype.kind == "u"
    values = stored / np.iinfo(stored.dtype).max if is_integer else displayed(stored.astype(np.float64))
    return np.clip(values[:, :, (0, 1, 2) if values.shape[2] >= 3 else (0, 0, 0)], 0, 1)


def looked_up(
    sheet: NDArray[np.float64], uv: NDArray[np.float64], wrap: tuple[str, str]
) -> NDArray[np.float64]:
    """Return bilinear lookups in an image, shape (K, 3); v points down."""
    size = np.array(sheet.shape[1::-1])
    at = uv * size - 0.5
    low = np.floor(at).astype(int)
    part = at - low
    colours = np.zeros((len(uv), 3))
    for right, down in ((0, 0), (1, 0), (0, 1), (1, 1)):
        cell = [wrapped(low[:, k] + step, size[k], wrap[k]) for k, step in enumerate((right, down))]
        weight = np.abs(1 - right - part[:, 0]) * np.abs(1 - down - part[:, 1])
        colours += weight[:, None] * sheet[cell[1], cell[0]]
    return colours


def wrapped(index: NDArray[np.int64], count: int, mode: str) -> NDArray[np.int64]:
    """Return the texel that a lookup beyond the image's border finds."""
    if mode == "repeat":
        return index % count
    if mode == "mirror":
        index = index % (2 * count)
        return np.minimum(index, 2 * count - 1 - index)
    return np.clip(index, 0, count - 1)


def draw(
    positions: NDArray[np.float64],
    faces: NDArray[np.int32],
    paint: Paint,
    size: int,
    angles: tuple[float, float] = (0.0, 0.0),
    *,
    shade: bool = False,
) -> NDArray[np.float32]:
    """Return an orthographic view, shape (size, size, 3): x to the right, y up, z towards the eye."""
    width = size * SUPERSAMPLING
    seen = positions @ rotation(*angles).T
    low, high = seen.min(axis=0), seen.max(axis=0)
    scale = 0.92 * width / (high - low)[:2].max()
    pixels = (seen - (low + high) / 2) * scale * (1, -1, 1) + (width / 2, width / 2, 0)
    light = lighting(seen[faces]) if shade else np.ones(len(faces))
    points = pixels[faces]
    canvas = np.full((width * width, 3), BACKGROUND, np.float32)
    depth = np.full(width * width, -np.inf)
    longest = np.linalg.norm(points[:, :, :2] - np.roll(points, 1, axis=1)[:, :, :2], axis=2).max(axis=1)
    cuts = 2 ** np.ceil(np.log2(np.maximum(1.5 * longest, 1))).astype(int)
    for cut in np.unique(cuts):
        chosen = np.flatnonzero(cuts == cut)
        weights = barycentric(cut)
        block = max(1, 2_000_000 // len(weights))
        for start in range(0, len(chosen), block):
            part = chosen[start : start + block]
            nearest, pixel = splat(depth, np.einsum("kc,fcd->fkd", weights, points[part]), width)
            face, number = part[nearest // len(weights)], nearest % len(weights)
            canvas[pixel] = paint(face, weights[number]) * light[face, None]
    image = canvas.reshape(size, SUPERSAMPLING, size, SUPERSAMPLING, 3).mean(axis=(1, 3))
    return image.astype(np.float32)


def rotation(turn: float, tilt: float) -> NDArray[np.float64]:
    """Return the rotation that brings a view from the right and from above to the front."""
    (c, s), (d, e) = ((np.cos(a), np.sin(a)) for a in np.radians((turn, tilt)))
    about_y = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    about_x = np.array([[1, 0, 0], [0, d, -e], [0, e, d]])
    return np.asarray(about_x @ about_y)


def lighting(triangles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how bright each triangle is under a lamp at the upper left, the same from both sides."""
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    normals *= np.where(normals[:, 2:] < 0, -1.0, 1.0)
    lamp = np.array([-0.4, 0.5, 0.77])
    return 0.45 + 0.55 * np.clip(normals @ lamp, 0, 1)


def barycentric(cut: int) -> NDArray[np.float64]:
    """Return the weights of the points of a triangle whose edges are cut in `cut` parts, shape (K, 3)."""
    i, j = (index.ravel() for index in np.mgrid[: cut + 1, : cut + 1])
    inside = i + j <= cut
    return np.column_stack([cut - i - j, i, j])[inside] / cut


def splat(
    depth: NDArray[np.float64], points: NDArray[np.float64], width: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return which of the points (F, K, 3) are nearer than what is there, and their pixels; `depth` is updated."""
    at = points[:, :, :2].astype(int)
    pixel = (at[:, :, 1] * width + at[:, :, 0]).ravel()
    z = points[:, :, 2].ravel()
    np.maximum.at(depth, pixel, z)
    nearest = np.flatnonzero(z == depth[pixel])
    return nearest, pixel[nearest]


def write(image: NDArray[np.float32], path: Path) -> None:
    """Write an image of display values in [0, 1] as 8-bit PNG."""
    import OpenImageIO

    spec = OpenImageIO.ImageSpec(image.shape[1], image.shape[0], 3, "uint8")
    output = OpenImageIO.ImageOutput.create(str(path))
    if output is None or not output.open(str(path), spec):
        raise SystemExit(f"{path}: cannot be written: {OpenImageIO.geterror()}")
    written = output.write_image(np.ascontiguousarray(np.rint(image * 255).astype(np.uint8)))
    if not (output.close() and written):
        raise SystemExit(f"{path}: cannot be written: {output.geterror()}")


if __name__ == "__main__":
    sys.exit(main())
