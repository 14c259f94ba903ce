"""A plane cut in four charts whose texels line up, as an OBJ file with a PNG texture."""

from formats.image_files import encode
from properties.textured_planes import Board

# 32 x 32 texels in charts of 16 x 16, with 8 texels of background between them; none is turned.
BOARD = Board(
    cells=4,
    texels=8,
    block=2,
    slot=24,
    slots=2,
    places=[(0, 0, 0, False), (0, 1, 0, False), (1, 0, 0, False), (1, 1, 0, False)],
)
SIDE, CHART, FIRST, STRIDE = 32, 16, 4, 24


def write_board(path, image):
    """Write the board and its texture, (48, 48, 3)."""
    surface = BOARD.surface()
    lines = [f"mtllib {path.stem}.mtl", "usemtl board"]
    lines += [f"v {x} {y} {z}" for x, y, z in surface.positions]
    lines += [f"vt {u!r} {1 - v!r}" for u, v in surface.uv.reshape(-1, 2).tolist()]
    for number, face in enumerate(surface.faces + 1):
        lines.append("f " + " ".join(f"{v}/{3 * number + k + 1}" for k, v in enumerate(face)))
    path.write_text("\n".join(lines) + "\n")
    path.with_suffix(".mtl").write_text(f"newmtl board\nmap_Kd {path.stem}.png\n")
    path.with_suffix(".png").write_bytes(encode(image, "png"))
    return path


def cut(phantom):
    """Lay a phantom (32, 32, 3) out in the image (48, 48, 3); the rest is 0."""
    image = BOARD.image_of(phantom.astype(float)) * 0
    rows, columns = BOARD.texel_places()
    image[rows, columns] = phantom
    return image.astype(phantom.dtype)
