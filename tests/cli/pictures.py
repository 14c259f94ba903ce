"""Small files to draw, and the pixels that are drawn of them."""

import numpy as np

from beltrami_cli.formats.gltf.writer import write_glb
from beltrami_cli.formats.image.reading import read_image
from beltrami_cli.formats.ply.writer import write_ply
from beltrami_cli.surface.records import MeshContents
from formats.image_files import encode
from small_models import textured_squares

CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])


def pixels(path):
    return read_image(path.read_bytes(), path.name).pixels


def coloured_square(path, colour):
    """Write a square of one colour, 0 to 1, as PLY in sRGB or as GLB in linear light."""
    corners, offsets = np.array([0, 1, 2, 0, 2, 3], np.int32), np.array([0, 3, 6])
    write, encoding = (write_glb, "linear") if path.suffix == ".glb" else (write_ply, "srgb")
    colours = np.tile(np.float32(colour), (4, 1))
    written = write(MeshContents(CORNERS, corners, offsets, colours, encoding, "float32"), path.stem)
    path.write_bytes(b"".join(bytes(piece) for piece in written.main))
    return path


def textured_square(path, texture):
    """Write a square as OBJ, with a texture whose texels, (H, W, 3), are enlarged by 16."""
    path.with_suffix(".png").write_bytes(encode(np.uint8(texture).repeat(16, 0).repeat(16, 1), "png"))
    return textured_squares(path, (f"{path.stem}.png", 0, (0, 1)))


def plain_image(path, colour, size=40):
    """Write an image of one 8-bit colour."""
    path.write_bytes(encode(np.tile(np.uint8(colour), (size, size, 1)), "png"))
    return path


def coloured_file(path, positions, faces, colours, alpha=None, stored="uint8"):
    offsets, colours = np.arange(0, 3 * len(faces) + 1, 3), colours.astype(np.float32)
    contents = MeshContents(positions, faces.ravel(), offsets, colours, "srgb", stored, alpha)
    path.write_bytes(b"".join(bytes(piece) for piece in write_ply(contents, path.stem).main))
    return path
