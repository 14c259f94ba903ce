"""The sidecar files of an output are known by name before anything is computed."""

from __future__ import annotations

import numpy as np
import pytest

from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.formats.registry import OUTPUT_FORMATS
from beltrami_cli.jobs.job import Job, NoiseSettings
from beltrami_cli.jobs.noise import noise_file
from beltrami_cli.jobs.output import Output
from beltrami_cli.layers.settings import SmoothSettings, TextureSettings
from formats.gltf_comparison import with_better_image
from formats.gltf_files import Textured
from formats.gltf_showcase import showcase
from formats.image_files import encode
from formats.tile_files import painting as painted_tiles
from formats.tile_files import part, tiled_model
from formats.usd_files import BOUND, COLOURS, PICTURE, coloured, material_text, mesh_text, scene
from formats.usd_files import write as write_files
from hostile.textured_models import write_model

SLOTS = ("baseColor", "normal", "emissive", "occlusion")
MAPS = "newmtl skin\nmap_Kd c.png\nmap_Ka c.png\nnorm n.png\nmap_Ke c.png\nmap_Ks shine.png\n"


def square(kind):
    def write(folder):
        (folder / "skin.png").write_bytes(PICTURE)
        return write_model(folder, kind, "skin.png")

    return write


def several_maps(folder):
    path = tiled_model(folder)
    (folder / "model.mtl").write_text(MAPS)
    for number, name in enumerate(("c.png", "n.png", "shine.png")):
        (folder / name).write_bytes(encode(np.roll(part(painted_tiles(), (0, 0)), number, 0), "png"))
    return path


def vertices(form):
    def write(folder):
        model = Textured()
        colours = np.random.default_rng(1).integers(0, 256, (3, 4), np.uint8)
        colours[:, 3] = 255
        places = np.eye(3, dtype="<f4")
        model.triangles(places, {"COLOR_0": model.packed(colours, normalized=True)}, corners=[[0], [1], [2]])
        return model.written_to(folder, form)

    return write


def compressed(kind):
    """The colours are decoded from a buffer, which changes, or from one that stays and is added to."""

    def write(folder):
        files = pytest.importorskip("formats.gltf_compressed")
        levels = np.random.default_rng(1).integers(0, 256, (len(files.GRID), 4), np.uint8)
        levels[:, 3] = 255
        return getattr(files, f"{kind}_model")(levels).written_to(folder, "gltf")

    return write


def in_two_buffers(folder):
    """The second buffer holds the colours, the first nothing that changes."""
    path = vertices("gltf")(folder)
    text = path.read_text().replace('"buffers": [', '"buffers": [{"byteLength": 4, "uri": "other.bin"},')
    path.write_text(text.replace('"buffer": 0', '"buffer": 1'))
    (folder / "other.bin").write_bytes(bytes(4))
    return path


def with_fallback(folder):
    photo, other = (encode(painted_tiles()[:16, :16], kind) for kind in ("webp", "png"))
    model = with_better_image("webp", photo, other)
    for image, (name, data) in zip(
        model.tree["images"], {"b.webp": photo, "a.png": other}.items(), strict=True
    ):
        image.pop("bufferView")
        image["uri"] = name
        model.files[name] = data
    return model.written_to(folder, "gltf")


def usd(folder):
    write_files(
        folder, {"scan.usda": scene(mesh_text(BOUND), material_text("skin.png")), "skin.png": PICTURE}
    )
    return folder / "scan.usda"


def usd_colours(folder):
    write_files(folder, {"scan.usda": scene(mesh_text(coloured(COLOURS)))})
    return folder / "scan.usda"


MODELS = {
    "obj": square("obj"),
    "ply": square("ply"),
    "gltf": square("gltf"),
    "obj maps": several_maps,
    "obj tiles": tiled_model,
    "gltf everything": lambda folder: showcase("file").written_to(folder, "gltf"),
    "glb everything": lambda folder: showcase("view").written_to(folder, "glb"),
    "gltf vertices": vertices("gltf"),
    "gltf two buffers": in_two_buffers,
    "gltf draco": compressed("draco"),
    "gltf meshopt": compressed("meshopt"),
    "gltf fallback": with_fallback,
    "usda": usd,
    "usda vertices": usd_colours,
}
FORMATS = sorted({*OUTPUT_FORMATS.values()} - {"usd", "usdc"})


@pytest.fixture
def announced(monkeypatch):
    """The names of the sidecar files, as they are checked before the computation and before writing."""
    found = []
    check = Output.check_sidecars

    def noted(output, names):
        found.append({*names})
        check(output, names)

    monkeypatch.setattr(Output, "check_sidecars", noted)
    return found


def add_noise(source, target, image_suffix=None):
    """Change the image of each slot in another way."""
    textures = TextureSettings(slots=SLOTS, image_suffix=image_suffix)
    noise_file(
        source, target, NoiseSettings(sigma=0.1), SmoothSettings(textures=textures), Job(overwrite=True)
    )


@pytest.mark.parametrize(("target", "suffix"), [("here", ".jpg"), ("there", None), ("in place", ".jpg")])
@pytest.mark.parametrize("model", MODELS)
def test_the_names_planned_are_those_written(model, target, suffix, announced, tmp_path, usd_core_here):
    if model.startswith("usd"):
        pytest.importorskip("pxr")
    (tmp_path / "out").mkdir()
    source = MODELS[model](tmp_path)
    targets = {"here": "new", "there": "out/new", "in place": source.stem}
    add_noise(source, tmp_path / f"{targets[target]}{source.suffix}", suffix)
    planned, written = announced
    assert planned == written
    assert planned or "glb" in model or model == "usda vertices"


# Each model in a third of the formats, each format with a third of the models.
@pytest.mark.parametrize(
    ("model", "form"),
    [(m, f) for i, m in enumerate(MODELS) for j, f in enumerate(FORMATS) if (i + j) % 3 == 0],
)
def test_the_names_planned_for_another_format_are_those_written(
    model, form, announced, tmp_path, usd_core_here
):
    if model.startswith("usd") or form.startswith("usd"):
        pytest.importorskip("pxr")
    (tmp_path / "out").mkdir()
    try:
        add_noise(MODELS[model](tmp_path), tmp_path / "out" / f"new.{form}")
    except (UsageError, InputError):
        assert len(announced) <= 1  # before anything was computed
        return
    planned, written = announced
    assert planned == written
