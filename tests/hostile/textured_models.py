"""One textured square in each format with sidecar files, with the names to be chosen."""

from pathlib import Path

import numpy as np

from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.layers.settings import SmoothSettings
from formats.gltf_files import Textured
from formats.image_files import encode
from small_models import ply

# Given, so that nothing is chosen from the data, which takes longer.
ONCE = SmoothSettings(KernelParameters(iterations=1, beta=1))
PICTURE = encode(np.random.default_rng(1).integers(0, 256, (20, 20, 3), np.uint8), "png")
OTHER = encode(np.random.default_rng(2).integers(0, 256, (20, 20, 3), np.uint8), "png")

_SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nusemtl m\nf 1/1 2/2 3/3 4/4\n"
_CORNERS = [[0, 0, 0, 0, 0], [1, 0, 0, 1, 0], [1, 1, 0, 1, 1], [0, 1, 0, 0, 1]]


KINDS = ("obj", "ply", "gltf")
"""The kinds of models that `write_model` writes: each format refers to images in another way."""


def write_model(folder, kind, image, library="m.mtl"):
    """Write model.KIND, and for OBJ its library, so that the texture has some name; return the model."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"model.{kind}"
    if kind == "obj":
        path.write_text(f"mtllib {library}\n{_SQUARE}")
        sidecar = Path(library.replace("\\", "/"))
        if not sidecar.is_absolute() and ".." not in sidecar.parts and ":" not in library:
            (folder / sidecar).parent.mkdir(parents=True, exist_ok=True)
            (folder / sidecar).write_text(f"newmtl m\nmap_Kd {image}\n")
    elif kind == "ply":
        path.write_bytes(ply("float x y z s t", _CORNERS, [range(4)], comments=[f"TextureFile {image}"]))
    else:
        path.write_bytes(_gltf(image))
    return path


def _gltf(image):
    model, corners = Textured(), np.array(_CORNERS)
    model.tree["images"] = [{"uri": image}]
    material = model.material(baseColor=model.texture(0))
    model.triangles(corners[:, :3], corners[:, 3:], material, corners=[[0, 1, 2], [0, 2, 3]])
    return model.data_text()
