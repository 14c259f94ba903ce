"""A waved sheet whose texture is in tiles, or in one image, with triangles that reach over the borders of tiles."""

import numpy as np

from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.formats.sidecars.tile_names import tile_name
from beltrami_cli.layers.settings import SmoothSettings
from formats.image_files import encode

GIVEN = SmoothSettings(KernelParameters(iterations=2, beta=20))
SIDE = 48  # texels of a tile
TILES = [(u, v) for v in range(2) for u in range(2)]


def sheet(size=2):
    """Return positions, texture coordinates (v up) from 0 to `size`, and quads, some across whole numbers."""
    steps = np.linspace(0, size, 3 * size + 2)
    place = np.stack(np.meshgrid(steps, steps), axis=2)
    place[1:-1, 1:-1] += (0.07, -0.06)
    uv = place.reshape(-1, 2)
    positions = np.column_stack([uv, 0.1 * np.sin(3 * uv[:, 0])])
    rows = np.arange(len(uv)).reshape(len(steps), -1)
    quads = np.stack([rows[:-1, :-1], rows[:-1, 1:], rows[1:, 1:], rows[1:, :-1]], axis=2)
    return positions, uv, quads.reshape(-1, 4)


def phantom(kind="uint8", size=2):
    """Return noisy stripes over all tiles."""
    y, x = np.mgrid[: size * SIDE, : size * SIDE] / SIDE
    stripes = np.stack([np.sin(4 * x + y), np.sign(np.sin(3 * y - x)), np.cos(3 * x)], axis=2)
    noisy = 0.5 + 0.25 * stripes + np.random.default_rng(3).normal(0, 0.05, stripes.shape)
    return (noisy.clip(0, 1) * np.iinfo(kind).max).astype(kind)


def part(image, tile):
    """Return the part of an image of all tiles that lies in one, rows from above."""
    top = len(image) - (tile[1] + 1) * SIDE
    return image[top : top + SIDE, tile[0] * SIDE : (tile[0] + 1) * SIDE]


def obj_text(uv, positions, quads):
    lines = ["mtllib model.mtl", "usemtl skin"]
    lines += ["v {:.9f} {:.9f} {:.9f}".format(*row) for row in positions]
    lines += ["vt {:.9f} {:.9f}".format(*row) for row in uv]
    lines += [" ".join(["f", *(f"{corner}/{corner}" for corner in row)]) for row in (quads + 1).tolist()]
    return "\n".join(lines) + "\n"


def tiled_model(folder, pattern="skin.<UDIM>.png", kind="uint8", size=2):
    """Write model.obj with its tiles, `size` along each side."""
    folder.mkdir(parents=True, exist_ok=True)
    positions, uv, quads = sheet(size)
    (folder / "model.obj").write_text(obj_text(uv, positions, quads))
    (folder / "model.mtl").write_text(f"newmtl skin\nmap_Kd {pattern}\n")
    image = phantom(kind, size)
    for tile in ((u, v) for v in range(size) for u in range(size)):
        (folder / tile_name(pattern, tile)).write_bytes(encode(part(image, tile), "png"))
    return folder / "model.obj"
