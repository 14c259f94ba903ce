"""The glTF validator of Khronos, an npm package that `make test` installs, and its asset auditor, by `make audit`.

The environment variables BELTRAMI_GLTF_VALIDATOR and BELTRAMI_GLTF_AUDITOR may name folders where they are elsewhere.
"""

from __future__ import annotations

import base64
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pytest

from formats.gltf_files import Textured, opened

_INSTALLED = Path(sys.prefix) / "gltf-validator" / "node_modules" / "gltf-validator"
_PACKAGE = Path(os.environ.get("BELTRAMI_GLTF_VALIDATOR", _INSTALLED))
_SCRIPT = Path(__file__).with_suffix(".cjs")
_NODE = shutil.which("node", path=os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]))

needs_validator = pytest.mark.skipif(
    _NODE is None or not _PACKAGE.is_dir(),
    reason="the glTF validator is not installed: run the tests by `make test`",
)

_AUDITOR = Path(os.environ.get("BELTRAMI_GLTF_AUDITOR", Path(sys.prefix) / "gltf-auditor"))
needs_auditor = pytest.mark.skipif(
    _NODE is None or not _AUDITOR.is_dir(),
    reason="the glTF asset auditor is not installed: run make audit",
)


def unfit(before, after, folder):
    """Return for both files which of the auditor's checks they fail.

    It reads neither compressed meshes nor those without texture coordinates, and is slow with coordinates far from 0
    to 1: there it judges the materials and images alone, on squares. Meshes stay what they are, as `check` finds.
    """
    found = _audited(before, after)
    if None in found:
        found = _audited(
            *(on_squares(path, folder / f"{path.stem}-{i}.glb") for i, path in enumerate((before, after)))
        )
    assert None not in found, "the auditor reads no squares either"
    return [set(each) for each in found]


def _audited(*files):
    script = _SCRIPT.with_name("gltf_auditor.mjs")
    try:
        done = subprocess.run(
            [_NODE, script, _AUDITOR, *files], capture_output=True, text=True, timeout=100, check=False
        )
    except subprocess.TimeoutExpired:
        return [None]
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


_SQUARE = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], "<f4")
_KEPT = ("textures", "samplers", "materials", "extensionsUsed", "extensionsRequired")
_OF_MESHES = ("KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_mesh_quantization")


def on_squares(path, target):
    """Write the materials and images of a file as another, in which all primitives are squares; return its path."""
    tree, buffers, files = opened(path)
    model = Textured()
    uv = model.packed(_SQUARE)
    attributes = {
        "POSITION": model.packed(
            np.column_stack([_SQUARE * [1, -1], np.zeros(4)]).astype("<f4"), bounds=True
        ),
        **dict.fromkeys(("TEXCOORD_0", "TEXCOORD_1"), uv),
    }
    square = {"attributes": attributes, "indices": model.indices(np.array([0, 2, 1, 0, 3, 2], "<u2"))}
    for mesh in tree["meshes"]:
        model.mesh(*(square | {k: p[k] for k in p.keys() & {"material"}} for p in mesh["primitives"]))
    for image in tree.get("images", ()):  # behind the rest: the auditor overlooks one in the first view
        view = tree["bufferViews"][image["bufferView"]] if "bufferView" in image else None
        if view is not None:
            data = buffers[view["buffer"]][view.get("byteOffset", 0) :][: view["byteLength"]]
        elif image["uri"].startswith("data:"):
            data = base64.b64decode(image["uri"].split(",")[1])
        else:
            data = files[unquote(image["uri"])]
        model.image(data, image.get("name", ""), image.get("mimeType", "image/png"))
    model.tree |= {key: tree[key] for key in _KEPT if key in tree}
    for key in _KEPT[-2:]:
        model.tree[key] = [name for name in tree.get(key, ()) if name not in _OF_MESHES]
    model.tree = {key: value for key, value in model.tree.items() if value != []}
    target.write_bytes(model.glb())
    return target


def issues(*files):
    """Return for each file what the validator finds: (severity, code, place, message), in order."""
    done = subprocess.run(
        [_NODE, _SCRIPT, _PACKAGE, *files], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    return [
        sorted((m["severity"], m["code"], m.get("pointer", ""), m["message"]) for m in found)
        for found in json.loads(done.stdout)
    ]
