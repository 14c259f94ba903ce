"""What patches are judged on: textured models, photographs around a sphere, coloured vertices; and noise on them.

Noise is what ``beltrami noise`` adds: the same on both sides of seams, rounded to 8 bit and cut off at 0 and 255.
"""

import os
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import texture_files
import texture_scene
from bench_textures import SAMPLES, extra_models
from peers import PeerError, reason
from scene import ROOT, Scene, icosphere, write_ply
from scipy.ndimage import map_coordinates, uniform_filter, zoom
from texture_scene import NEAR, TexturedScene

from beltrami_cli.errors import BeltramiError
from beltrami_cli.formats.registry import open_document
from beltrami_cli.jobs.job import Job
from beltrami_cli.jobs.noise import noise_file
from beltrami_cli.jobs.settings import NoiseSettings

PHOTOGRAPHS = ("astronaut", "coffee", "chelsea", "immunohistochemistry")
MATERIALS = ("brick", "grass", "gravel")  # without a flat place, and grey
LARGEST = 1024  # texels a side; larger images are halved
FEWEST = 20_000  # covered texels of an image that is judged
QUADS = 24  # a side of a chart of the sphere
BAKED_FACES = 60_000  # at least, of a mesh whose vertices show a texture
SUBDIVISIONS = 6  # of the icosphere: 40,962 vertices
SEAMS_COUNT = 3  # times as much as other texels, where a part of an image is looked for


def textured_names():
    """Return the names of textured scenes: photographs, and paths."""
    samples = [min((ROOT / "sample_data").glob(f"{name}-clean.[gop][lb]*")) for name in SAMPLES]
    return [*PHOTOGRAPHS, *MATERIALS, *map(str, samples), *map(str, extra_models())]


def textured(name):
    """Return a textured scene; None if it has no texture that can be judged."""
    if name in PHOTOGRAPHS + MATERIALS:
        return photograph_in_charts(name)
    try:
        scene = texture_scene.from_file(Path(name))
    except (BeltramiError, ValueError):
        return None
    scene = halved(scene)
    return scene if judged_images(scene) else None


def judged_images(scene):
    """Return the numbers of the images of which enough is covered."""
    return [k for k, covered in enumerate(scene.covered) if covered.sum() >= FEWEST]


def halved(scene):
    """Return the scene with images of at most `LARGEST` texels a side, by means of squares of texels."""
    clean, visible = [], []
    for image, seen in zip(scene.clean, scene.visible, strict=True):
        step = 1
        while max(image.shape[:2]) // step > LARGEST and not any(
            side % (2 * step) for side in image.shape[:2]
        ):
            step *= 2
        height, width = image.shape[0] // step, image.shape[1] // step
        blocks = image.reshape(height, step, width, step, 3).mean(axis=(1, 3))
        clean.append((np.rint(blocks * 255) / 255).astype(np.float32))
        visible.append(seen.reshape(height, step, width, step).all(axis=(1, 3)))
    return replace(scene, clean=clean, visible=visible)


def part(scene, number, side):
    """Return the slices of the part of an image, `side` texels a side, that has most covered texels and seams."""
    height, width = scene.covered[number].shape
    counted = scene.covered[number] + float(SEAMS_COUNT) * scene.near_seams[number]
    rows, columns = min(side, height), min(side, width)
    means = uniform_filter(counted, (rows, columns), mode="constant")
    inner = means[rows // 2 : height - (rows - 1) // 2, columns // 2 : width - (columns - 1) // 2]
    top, left = np.unravel_index(inner.argmax(), inner.shape)
    return slice(int(top), int(top) + rows), slice(int(left), int(left) + columns)


def with_noise(scene, sigma):
    """Return 8-bit images with noise, on all texels that the surface does not cover, too.

    A filter on the flat image reaches far into the gutter, and must not find the truth there.
    """
    random, images = np.random.default_rng(11), [np.rint(image * 255) for image in scene.clean]
    with tempfile.TemporaryDirectory() as folder:
        clean, noisy = Path(folder) / "clean.glb", Path(folder) / "noisy.glb"
        texture_files.write_glb(clean, scene, images)
        noise_file(clean, noisy, NoiseSettings(sigma=sigma), job=Job(overwrite=True))
        painted = [np.rint(image * 255) for image in texture_files.read_images(noisy)]
    found = []
    for image, surface, covered in zip(images, painted, scene.covered, strict=True):
        flat = image + 255 * sigma * random.standard_normal(image.shape)
        on_surface = covered | (surface != image).any(axis=2)
        found.append(np.where(on_surface[..., None], surface, np.rint(flat).clip(0, 255)).astype(np.uint8))
    return found


def photograph(name):
    """Return a photograph that comes with scikit-image, in [0, 1]."""
    try:
        from skimage import data
    except ImportError as error:
        raise PeerError(reason(error)) from error
    image = getattr(data, name)() / 255.0
    return np.repeat(image[..., None], 3, axis=2) if image.ndim == 2 else image[..., :3]


def on_sphere(image, directions):
    """Return the colours of directions: each hemisphere shows the disc in the middle of the image, by equal areas."""
    shape = np.array(image.shape[:2])
    flat = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    # Lambert's projection; the sine is 0 at the poles only, where the direction does not matter.
    radius = np.sqrt(1 - np.abs(flat[..., 2])) / np.maximum(np.hypot(flat[..., 0], flat[..., 1]), 1e-12)
    places = [
        (c - 1) / 2 + radius * flat[..., k] * (shape.min() - 3) / 2 for k, c in ((1, shape[0]), (0, shape[1]))
    ]
    seen = [map_coordinates(image[..., k], places, order=3, mode="nearest") for k in range(3)]
    return np.clip(np.stack(seen, axis=-1), 0, 1)


def photograph_in_charts(name):
    """Return a sphere in six charts, on one image, that shows a photograph with about one texel a pixel."""
    image = photograph(name)
    inner = round(np.sqrt(np.pi / 3) * min(image.shape[:2]) / 2)
    cell = inner + 2 * NEAR
    corner = np.stack(np.mgrid[: QUADS + 1, : QUADS + 1], axis=-1) / QUADS
    a, b, c, d = (corner[i, j].reshape(-1, 2) for i, j in texture_scene.cells())
    local = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    centre = (np.stack(np.mgrid[:cell, :cell], axis=-1)[:, :, ::-1] + 0.5 - NEAR) / inner
    size, corners, uv = np.array([3 * cell, 2 * cell]), [], []
    clean = np.zeros((2 * cell, 3 * cell, 3), np.float32)
    for side, place in enumerate(np.random.default_rng(5).permutation(6).tolist()):
        where = np.array([place % 3, place // 3]) * cell
        corners.append(on_cube(local, side))
        uv.append((local * inner + NEAR + where) / size)
        # The gutter continues the painting.
        painted = np.rint(255 * on_sphere(image, on_cube(centre, side))) / 255
        clean[where[1] : where[1] + cell, where[0] : where[0] + cell] = painted
    corners, uv = np.concatenate(corners), np.concatenate(uv)
    everywhere = [np.ones(clean.shape[:2], bool)]
    return TexturedScene(name, corners, uv, np.zeros(len(uv), np.int64), [clean], everywhere)


def on_cube(uv, side):
    """Return places on the unit sphere by coordinates on a side of a cube, rounded so that edges of sides coincide."""
    axis, sign = side // 2, 1 - 2 * (side % 2)
    flat = np.tan((2 * uv - 1) * np.pi / 4)
    places = np.insert(flat, axis, sign, axis=-1)
    return np.round(places / np.linalg.norm(places, axis=-1, keepdims=True), 6) + 0.0


def write_vertices(folder):
    """Yield PLY files with coloured vertices: photographs on an icosphere, samples, and those of the extra folder.

    Textures of the extra folder are shown by vertices, too, of finer triangles.
    """
    for name in PHOTOGRAPHS:
        image = photograph(name)
        sphere = icosphere(SUBDIVISIONS)
        wanted = 2 * np.sqrt(len(sphere.positions) / 2 / np.pi)  # pixels across a hemisphere
        factor = wanted / min(image.shape[:2])
        # Means over what a vertex stands for, so that nothing aliases.
        blurred = uniform_filter(image, (round(1 / factor), round(1 / factor), 1))
        colours = on_sphere(np.clip(zoom(blurred, (factor, factor, 1), order=1), 0, 1), sphere.positions)
        path = Path(folder) / f"{name}.ply"
        write_ply(path, Scene(sphere.positions, sphere.faces, colours, colours))
        yield path
    for name in map(str, extra_models()):
        scene = textured(name)
        for number in [] if scene is None else judged_images(scene):
            path = Path(folder) / f"{Path(name).stem}-{number}.ply"
            write_ply(path, baked(scene, number))
            yield path
    extra = os.environ.get("BELTRAMI_EXTRA_MESHES")
    more = sorted(Path(extra).rglob("*.ply")) if extra else []
    for path in [*sorted((ROOT / "sample_data").glob("*-clean.ply")), *more]:
        document = open_document(str(path))
        if document.has_vertex_colours() and not document.slots():
            yield path


def baked(scene, number):
    """Return the faces that show an image of a textured scene, split until their vertices can show it, too."""
    own, image = scene.texture_of == number, scene.clean[number]
    corners, uv = scene.corners[own], scene.uv[own]
    while len(corners) < BAKED_FACES:
        corners, uv = split(corners), split(uv)
    extent = np.ptp(corners.reshape(-1, 3), axis=0).max()
    _, first, vertex = np.unique(
        np.round(corners.reshape(-1, 3) / extent * 1e5), axis=0, return_index=True, return_inverse=True
    )
    faces = vertex.reshape(-1, 3)
    whole = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    # Means over what a vertex stands for, so that nothing aliases.
    side = max(1, round(np.sqrt(scene.covered[number].sum() / len(first))))
    blurred = uniform_filter(image.astype(np.float64), (side, side, 1))
    places = (uv.reshape(-1, 2)[first] % 1 * np.array(image.shape[1::-1]) - 0.5).T[::-1]
    seen = [map_coordinates(blurred[..., k], places, order=1, mode="nearest") for k in range(3)]
    colours = np.clip(np.stack(seen, axis=-1), 0, 1)
    return Scene(corners.reshape(-1, 3)[first], faces[whole], colours, colours)


def split(corners):
    """Return four triangles for each, shape (4 F, 3, K)."""
    a, b, c = corners.swapaxes(0, 1)
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.concatenate([np.stack(part, axis=1) for part in parts])
