"""Textured surfaces: which texels they cover, which of them are near seams, and noise on them.

Triangles are rasterised and seams found in NumPy, so that results do not depend on the atlas of the package.
"""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Self

import numpy as np
from scipy.ndimage import distance_transform_edt, uniform_filter

from beltrami_cli.arrays import Array, Bools
from beltrami_cli.errors import BeltramiError
from beltrami_cli.formats.image.decoded_image import DecodedImage, new_image
from beltrami_cli.formats.image.reading import read_texture
from beltrami_cli.formats.image.sample_types import full_scale_one
from beltrami_cli.formats.image.writing import write_image
from beltrami_cli.formats.registry import open_document
from beltrami_cli.jobs.job import Job
from beltrami_cli.jobs.noise.file import noise_file
from beltrami_cli.jobs.settings import NoiseSettings
from beltrami_cli.surface.colour_values import linear_to_srgb
from harness import SAMPLES, SIGMA, extra_models
from pixels import PHOTOGRAPHS, on_sphere, photograph
from vertices import chequer

NEAR = 4  # maximum distance in texels of a texel near a seam
SMALLEST, LARGEST = 64, 1024  # texels per side; smaller images are palettes, larger ones are halved
FEWEST = 20_000  # minimum number of covered texels of a judged image
MATERIALS = ("brick", "grass", "gravel")  # photographs without a flat place, and grey
NAMES = ("head-tex", "torus-two", "mirrored", "tiled", "sphere-exr", "scan")
MODELS = {".obj", ".glb", ".gltf", ".ply"}
QUADS = 24  # per side of a chart of the sphere
SEAMS_COUNT = 3  # weight of texels near seams in the choice of a part of an image


@dataclass(frozen=True)
class TexturedScene:
    """A textured surface without noise; images are display values in [0, 1], v of coordinates is down."""

    name: str
    corners: Array  # positions of the triangles' corners, shape (F, 3, 3)
    uv: Array  # shape (F, 3, 2); they may leave [0, 1], where images repeat
    texture_of: Array  # index into `clean`, shape (F,)
    clean: list[Array]  # float32, shape (H, W, 3)
    visible: list[Bools]  # shape (H, W): where alpha is not 0

    @classmethod
    def of_charts(cls, name: str, corners: Sequence[Array], uv: Sequence[Array], clean: Array) -> Self:
        """Join charts that are on one image."""
        joined, visible = np.concatenate(corners), np.ones(clean.shape[:2], bool)
        return cls(name, joined, np.concatenate(uv), np.zeros(len(joined), np.int64), [clean], [visible])

    @cached_property
    def covered(self) -> list[Bools]:
        """Per image, the visible texels whose centre lies in a triangle."""
        found = []
        for number, image in enumerate(self.clean):
            mine = self.texture_of == number
            seen = rasterised(self.uv[mine] * image.shape[1::-1], image.shape[1::-1])
            found.append(seen & self.visible[number])
        return found

    @cached_property
    def near_seams(self) -> list[Bools]:
        """Per image, the covered texels within `NEAR` texels of a seam."""
        faces, ends = seams(self.corners, self.uv, self.texture_of)
        found = []
        for number, image in enumerate(self.clean):
            lines = ends[self.texture_of[faces] == number] * image.shape[1::-1]
            found.append(self.covered[number] & close_to(lines, image.shape[1::-1]))
        return found

    @cached_property
    def noisy(self) -> list[Array]:
        """Per image, 8-bit pixels with noise on all texels, covered or gutter.

        A filter on the flat image reaches far into the gutter, and must not find the truth there.
        """
        random = np.random.default_rng(11)
        noise = (SIGMA * random.standard_normal(image.shape) for image in self.clean)
        noisy = (image + added for image, added in zip(self.clean, noise, strict=True))
        return [np.rint(np.clip(image, 0, 1) * 255).astype(np.uint8) for image in noisy]


def torus(size: int, charts: int = 4, cuts: int = 16) -> TexturedScene:
    """Return a torus in charts * charts square charts, shuffled and turned by right angles, on one image."""
    random = np.random.default_rng(5)
    cell = size // charts
    local = triangles_of_square(cuts)
    gutter = NEAR / cell
    corners, uv, clean = [], [], np.zeros((size, size, 3), np.float32)
    centre = (np.moveaxis(np.mgrid[:cell, :cell], 0, -1)[:, :, ::-1] + 0.5) / cell
    for number, place in enumerate(random.permutation(charts**2).tolist()):
        at, where = np.array(divmod(number, charts)), np.array(divmod(place, charts))
        turn = int(random.integers(4))
        corners.append(on_torus((local + at) / charts))
        inset = rotated(local, turn) * (1 - 2 * gutter) + gutter
        uv.append((inset + where) / charts)
        # The gutter continues the pattern, which is a function of place.
        back = rotated((centre - gutter) / (1 - 2 * gutter), -turn)
        # Shifted, so that no edge of the pattern coincides with a seam.
        shades = chequer(on_torus((back + at) / charts).reshape(-1, 3) * 1.6 + (0.13, 0.09, 0.06))
        x, y = where * cell
        clean[y : y + cell, x : x + cell] = shades.reshape(cell, cell, 3)
    return TexturedScene.of_charts("torus", corners, uv, clean)


def triangles_of_square(cuts: int) -> Array:
    """Return the corners of the triangles of the unit square, cut into cuts * cuts cells, shape (F, 3, 2)."""
    places = np.moveaxis(np.mgrid[: cuts + 1, : cuts + 1], 0, -1) / cuts
    a, b, c, d = (
        each.reshape(-1, 2) for each in (places[:-1, :-1], places[1:, :-1], places[1:, 1:], places[:-1, 1:])
    )
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def rotated(uv: Array, quarters: int) -> Array:
    """Return coordinates of the unit square turned by right angles about its centre."""
    for _ in range(quarters % 4):
        uv = np.stack([1 - uv[..., 1], uv[..., 0]], axis=-1)
    return uv


def on_torus(uv: Array) -> Array:
    """Return positions on a torus, rounded so that a position has the same coordinates in every chart."""
    u, v = 2 * np.pi * uv[..., 0], 2 * np.pi * uv[..., 1]
    reach = 0.7 + 0.3 * np.cos(v)
    return np.round(np.stack([reach * np.cos(u), reach * np.sin(u), 0.3 * np.sin(v)], axis=-1), 6) + 0.0


def rasterised(triangles: Array, size: Sequence[int]) -> Bools:
    """Return which texels have their centre in one of the triangles (in texels), shape (H, W)."""
    width, height = size
    seen = np.zeros((height, width), bool)
    # Triangles are moved to the first tile, so that distant tiles do not cost time.
    triangles = triangles - np.floor(triangles.min(axis=1, keepdims=True) / size) * size
    low = np.ceil(triangles.min(axis=1) - 0.5).astype(int)
    high = np.floor(triangles.max(axis=1) - 0.5).astype(int)
    for (a, b, c), (left, top), (right, bottom) in zip(triangles, low, high, strict=True):
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if right < left or bottom < top or abs(area) < 1e-12:
            continue
        x, y = np.arange(left, right + 1) + 0.5, np.arange(top, bottom + 1)[:, None] + 0.5
        inside = np.ones((len(y), len(x)), bool)
        for p, q in ((a, b), (b, c), (c, a)):
            inside &= ((q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0])) / area >= -1e-9
        rows, columns = np.nonzero(inside)
        seen[(rows + top) % height, (columns + left) % width] = True
    return seen


def seams(corners: Array, uv: Array, texture_of: Array) -> tuple[Array, Array]:
    """Return the faces at seams and the ends of the seam edges in their texture, shapes (S,) and (S, 2, 2)."""
    _, place = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    place = place.reshape(-1, 3)
    face, k = (part.ravel() for part in np.mgrid[: len(place), :3])
    ends = np.stack([place[face, k], place[face, (k + 1) % 3]], axis=1)
    sides = np.stack([uv[face, k], uv[face, (k + 1) % 3]], axis=1)
    turned = ends[:, 0] > ends[:, 1]
    ends[turned], sides[turned] = ends[turned, ::-1], sides[turned, ::-1]
    _, edge, count = np.unique(ends, axis=0, return_inverse=True, return_counts=True)
    edge = edge.reshape(-1)
    first = np.full(len(count), -1)
    first[edge[::-1]] = np.arange(len(edge))[::-1]
    other = first[edge]
    differ = (np.abs(sides - sides[other]) > 1e-6).any(axis=(1, 2))
    differ |= texture_of[face] != texture_of[face[other]]
    is_seam = np.zeros(len(count), bool)
    np.logical_or.at(is_seam, edge, differ)
    at_seam = is_seam[edge] & (ends[:, 0] != ends[:, 1])
    return face[at_seam], sides[at_seam]


def close_to(lines: Array, size: Sequence[int]) -> Bools:
    """Return the texels whose centre is within `NEAR` texels of one of the lines, shape (L, 2, 2), in texels."""
    width, height = size
    if not len(lines):
        return np.zeros((height, width), bool)
    steps = int(np.ceil(np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1).max() * 2)) + 1
    drawn = np.zeros((height, width), bool)
    for part in np.linspace(0, 1, min(steps, 4096)):
        x, y = np.floor((1 - part) * lines[:, 0] + part * lines[:, 1]).astype(int).T
        drawn[y % height, x % width] = True
    return distance_transform_edt(~drawn) <= NEAR


def from_file(path: Path) -> TexturedScene:
    """Return the textured surface of a file; small images, such as palettes, are left out."""
    surface = open_document(str(path)).textured("baseColor")
    decoded = [read_texture(texture) for texture in surface.textures]
    large = [min(image.pixels.shape[:2]) >= SMALLEST for image in decoded]
    index = np.append(np.where(large, np.cumsum(large) - 1, -1), -1)
    texture_of = index[surface.texture_of]
    kept = texture_of >= 0
    clean = [displayed(image) for image, keep in zip(decoded, large, strict=True) if keep]
    visible = [seen(image) for image, keep in zip(decoded, large, strict=True) if keep]
    corners = surface.positions[surface.faces[kept]]
    return TexturedScene(path.name, corners, surface.uv[kept], texture_of[kept], clean, visible)


def displayed(image: DecodedImage) -> Array:
    colour = image.colour if len(image.colour) == 3 else image.colour * 3
    values = full_scale_one(image.pixels)[..., colour]
    shown = linear_to_srgb(values) if image.encoding == "linear" else values
    return np.clip(shown, 0, 1).astype(np.float32)


def seen(image: DecodedImage) -> Bools:
    if image.alpha is None:
        return np.ones(image.pixels.shape[:2], bool)
    return image.pixels[..., image.alpha] > 0


def write_obj(path: Path, scene: TexturedScene, pixels: Sequence[Array]) -> None:
    """Write the scene with other images, 8-bit PNG next to it."""
    places, corner = np.unique(scene.corners.reshape(-1, 3), axis=0, return_inverse=True)
    lines = [f"mtllib {path.stem}.mtl", *(f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in places)]
    lines += [f"vt {u:.9g} {1 - v:.9g}" for u, v in scene.uv.reshape(-1, 2)]
    materials, corner = [], corner.reshape(-1, 3) + 1
    for number, image in enumerate(pixels):
        name = f"{path.stem}-{number}.png"
        materials.append(f"newmtl m{number}\nmap_Kd {name}\n")
        values = np.ascontiguousarray(image, np.uint8)
        path.with_name(name).write_bytes(write_image(new_image(values, name), values).data)
        lines.append(f"usemtl m{number}")
        for face in np.flatnonzero(scene.texture_of == number):
            a, b, c = corner[face]
            lines.append(f"f {a}/{3 * face + 1} {b}/{3 * face + 2} {c}/{3 * face + 3}")
    path.write_text("\n".join(lines) + "\n")
    path.with_suffix(".mtl").write_text("".join(materials))


def read_images(path: Path) -> list[Array]:
    """Return the images of a model that `write_obj` wrote, as display values."""
    surface = open_document(str(path)).textured("baseColor")
    firsts = [int(np.argmax(surface.texture_of == k)) for k in range(len(surface.textures))]
    return [displayed(read_texture(surface.textures[k])) for k in np.argsort(firsts)]


def scene_names() -> list[str]:
    samples = [min(SAMPLES.glob(f"{name}-clean.[gop][lb]*")) for name in NAMES]
    return [*PHOTOGRAPHS, *MATERIALS, *map(str, samples), *map(str, extra_models(MODELS))]


def scene_of(name: str) -> TexturedScene | None:
    """Return a textured scene; None if it has no texture that can be judged."""
    if name in PHOTOGRAPHS + MATERIALS:
        return photograph_in_charts(name)
    try:
        scene = halved(from_file(Path(name)))
    except (BeltramiError, ValueError):
        return None
    return scene if judged_images(scene) else None


def judged_images(scene: TexturedScene) -> list[int]:
    return [k for k, covered in enumerate(scene.covered) if covered.sum() >= FEWEST]


def halved(scene: TexturedScene) -> TexturedScene:
    """Return the scene with images of at most `LARGEST` texels a side, by means of squares of texels."""
    clean, visible = [], []
    for image, seen in zip(scene.clean, scene.visible, strict=True):
        step = 1
        while max(image.shape) // step > LARGEST and not any(side % (2 * step) for side in image.shape[:2]):
            step *= 2
        height, width = image.shape[0] // step, image.shape[1] // step
        blocks = image.reshape(height, step, width, step, 3).mean(axis=(1, 3))
        clean.append((np.rint(blocks * 255) / 255).astype(np.float32))
        visible.append(np.asarray(seen.reshape(height, step, width, step).all(axis=(1, 3))))
    return replace(scene, clean=clean, visible=visible)


def part(scene: TexturedScene, number: int, side: int) -> tuple[slice, slice]:
    """Return the slices of the part of an image, `side` texels a side, that has most covered texels and seams."""
    height, width = scene.covered[number].shape
    counted = scene.covered[number] + float(SEAMS_COUNT) * scene.near_seams[number]
    rows, columns = min(side, height), min(side, width)
    means = uniform_filter(counted, (rows, columns), mode="constant")
    inner = means[rows // 2 : height - (rows - 1) // 2, columns // 2 : width - (columns - 1) // 2]
    top, left = np.unravel_index(inner.argmax(), inner.shape)
    return slice(int(top), int(top) + rows), slice(int(left), int(left) + columns)


def noisy_images(scene: TexturedScene, sigma: float) -> list[Array]:
    """Return 8-bit images with noise as ``beltrami noise`` adds it: the same on both sides of seams.

    Texels that the surface does not cover get noise, too: a filter on the flat image reaches far into the gutter, and
    must not find the truth there.
    """
    random, images = np.random.default_rng(11), [np.rint(image * 255) for image in scene.clean]
    with tempfile.TemporaryDirectory() as folder:
        clean, noisy = Path(folder) / "clean.obj", Path(folder) / "noisy.obj"
        write_obj(clean, scene, images)
        noise_file(clean, noisy, NoiseSettings(sigma=sigma), job=Job(overwrite=True))
        shades = [np.rint(image * 255) for image in read_images(noisy)]
    found = []
    for image, surface, covered in zip(images, shades, scene.covered, strict=True):
        flat = image + 255 * sigma * random.standard_normal(image.shape)
        on_surface = covered | (surface != image).any(axis=2)
        found.append(np.where(on_surface[..., None], surface, np.rint(flat).clip(0, 255)).astype(np.uint8))
    return found


def photograph_in_charts(name: str) -> TexturedScene:
    """Return a sphere in six charts, on one image, that shows a photograph with about one texel a pixel."""
    image = photograph(name)
    inner = round(np.sqrt(np.pi / 3) * min(image.shape[:2]) / 2)
    cell = inner + 2 * NEAR
    local = triangles_of_square(QUADS)
    centre = (np.moveaxis(np.mgrid[:cell, :cell], 0, -1)[:, :, ::-1] + 0.5 - NEAR) / inner
    size, corners, uv = np.array([3 * cell, 2 * cell]), [], []
    clean = np.zeros((2 * cell, 3 * cell, 3), np.float32)
    for side, place in enumerate(np.random.default_rng(5).permutation(6).tolist()):
        where = np.array([place % 3, place // 3]) * cell
        corners.append(on_cube(local, side))
        uv.append((local * inner + NEAR + where) / size)
        # The gutter continues the pattern.
        shades = np.rint(255 * on_sphere(image, on_cube(centre, side))) / 255
        clean[where[1] : where[1] + cell, where[0] : where[0] + cell] = shades
    return TexturedScene.of_charts(name, corners, uv, clean)


def on_cube(uv: Array, side: int) -> Array:
    """Return places on the unit sphere by coordinates on a side of a cube, rounded so that edges of sides coincide."""
    axis, sign = side // 2, 1 - 2 * (side % 2)
    flat = np.tan((2 * uv - 1) * np.pi / 4)
    places = np.insert(flat, axis, sign, axis=-1)
    return np.round(places / np.linalg.norm(places, axis=-1, keepdims=True), 6) + 0.0
