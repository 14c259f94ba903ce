"""The registry of formats: files are recognised by content, and sidecar files of an output known by name beforehand."""

import subprocess
import sys
from functools import partial

import numpy as np
import pytest

from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.loading import document_class, mesh_writer
from beltrami_cli.formats.output_format import usual_sidecars
from beltrami_cli.formats.registry import FORMATS, OUTPUT_FORMATS, open_bytes, recognised
from beltrami_cli.jobs.job import Job
from beltrami_cli.jobs.noise.file import noise_file
from beltrami_cli.jobs.settings import NoiseSettings
from beltrami_cli.jobs.writing.output import Output
from beltrami_cli.layers.settings import SmoothSettings, TextureSettings
from beltrami_cli.surface.slots import SLOTS
from formats.gltf_comparison import with_better_image
from formats.gltf_compressed import GRID, draco_model, meshopt_model
from formats.gltf_files import coloured
from formats.gltf_showcase import showcase
from formats.image_files import encode, noise
from formats.tile_files import part, tiled_model
from formats.tile_files import phantom as tile_phantom
from formats.usd_files import BOUND, COLOURS, PICTURE, material_text, mesh_text, scene
from formats.usd_files import coloured as usd_colours
from formats.volume_files import npz
from hostile.folders import write
from hostile.textured_models import write_model
from small_models import ply


@pytest.mark.parametrize("line", FORMATS, ids=lambda line: line.name)
def test_what_a_line_names_can_be_loaded(line):
    assert line.reader is None or issubclass(document_class(line.reader), Document)
    assert line.writer is None or callable(mesh_writer(line.writer))


def test_formats_of_output_are_those_with_a_writer():
    assert set(OUTPUT_FORMATS.values()) == {line.name for line in FORMATS if line.writer}
    assert OUTPUT_FORMATS["xyzrgb"] == "xyz"


OBJ_WITH_BOTH = (
    b"mtllib m.mtl\nv 0 0 0 0 90 140\nv 1 0 0 0 90 140\nv 0 1 0 0 90 140\nvt 0 0\n"
    b"usemtl shown\nf 1/1 2/1 3/1\nusemtl lost\nf 1/1 2/1 3/1\n"
)


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("x.obj", OBJ_WITH_BOTH),
        ("x.off", b"OFF\n4 2 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 0 1 2 255 0 0\n3 0 2 3 0 255 0\n"),
        ("x.xyz", b"0 0 0 4000 0 0\n1 0 0 0 3000 0\n0 1 0 7 8 9\n"),
        ("x.ply", ply("float x y z, ushort red green blue", [[0, 0, 0, 4000, 1, 2], [1, 0, 0, 5, 6, 7]])),
    ],
)
def test_notices_on_vertex_colours_come_along_to_other_formats(name, data):
    document = open_bytes(data, name, None)
    assert document.coloured_vertices().notices
    assert {*document.coloured_vertices().notices} <= {*document.vertex_mesh().notices}


def test_notices_of_the_file_do_not_depend_on_which_parts_are_read(tmp_path):
    library = b"newmtl shown\nmap_Kd skin.png\nnewmtl lost\nmap_Kd lost.png\n"
    write(tmp_path, {"m.mtl": library, "skin.png": PICTURE})
    document = open_bytes(OBJ_WITH_BOTH, "x.obj", tmp_path)
    before = document.notices
    assert "0..255" in document.coloured_vertices().notices[0]
    assert "'lost.png' is missing" in document.textured("baseColor").notices[0]
    assert document.notices == before
    assert not any("0..255" in each for each in document.textured("baseColor").notices)


@pytest.mark.parametrize(
    ("data", "name", "format_name"),
    [
        (b"ply\nformat ascii 1.0\nend_header\n", "x.obj", "ply"),
        (b'{"asset":{"version":"2.0"}}', "x.ply", "gltf"),
        (coloured("dense", np.random.default_rng(1)).model.glb(), "x.gltf", "glb"),
        (b"v 0 0 0 1 1 1\n", "X.OBJ", "obj"), (b"OFF\n0 0 0\n", "x.xyz", "off"), (b"OFF\n", "x.obj", "obj"),
        (b"0 0 0 1 1 1\n", "x.xyzrgb", "xyz"), (b"0 0 0 1 1 1\n", "x.pts", "pts"),
        (npz(positions=np.zeros((1, 3)), rgb=np.zeros((1, 3))), "-", "npz"),
    ],
)  # fmt: skip
def test_content_counts_before_the_name(data, name, format_name):
    assert open_bytes(data, name, None).format == format_name
    assert recognised(data, name).kind == "model"


def test_images_and_volumes_are_no_models():
    image, volume = encode(noise("uint8", 3), "png"), npz(values=np.ones((2, 2, 2)))
    assert (recognised(image, "x.png").kind, recognised(volume, "v.npz").kind) == ("image", "volume")
    with pytest.raises(InputError, match="it is an image"):
        open_bytes(image, "x.png", None)


@pytest.mark.parametrize(
    ("data", "name", "cause"),
    [
        (b"PK\x03\x04....", "x.obj", "ZIP archive"), (b"\x1f\x8b....", "x.xyz", "gzip archive"),
        (b"\xff\xfev\0", "x.obj", "UTF-16"), (b"", "x.pts", "the file is empty"),
        (b"something", "<stdin>", "no mark of a known format"), (b"something", "x.dat", "of no known format"),
        (b"LASF\0\0", "x.laz", "damaged|package laspy"),
        (b"# .PCD v0.7 - Point Cloud Data\n", "x.xyz", "damaged|package laspy"),
        (b"<GeometryModel3D></GeometryModel3D>", "x.xaml", "no known format"),
        (b"Kaydara FBX Binary  \0", "x.fbx", "FBX file, which is not read; open it in Blender"),
        (b"BLENDER-v400", "x", "Blender file"),
        (b"# vtk DataFile Version 3.0\n", "x.vtk", "VTK file, which is not read; convert it to PLY"),
        (b'<?xml version="1.0"?>\n<VTKFile type="PolyData">', "x.bin", "VTK file"),
        (b"", "x.mtl", "material library, which is not read; give the .obj file"),
        (b"# made by\n\n# a program\nnewmtl skin\n", "x.txt", "material library"),
        (b"b3dm\1\0\0\0", "x.b3dm", "3D Tiles file, which is not read; extract the model with: npx"),
    ],
)  # fmt: skip
def test_other_files_are_refused_with_the_cause(data, name, cause):
    with pytest.raises(InputError, match=cause):
        open_bytes(data, name, None)


@pytest.mark.parametrize(
    "suffix", [".ply", ".obj", ".glb", ".usda", ".xyz", ".csv", ".npz", ".stl", ".las", ".dat"]
)
def test_an_image_is_called_one_whatever_its_name(suffix):
    image = encode(noise("uint8", 3), "png")
    assert recognised(image, f"x{suffix}").kind == "image"
    with pytest.raises(InputError, match="it is an image"):
        open_bytes(image, f"x{suffix}", None)


def test_sidecars_follow_from_the_format():
    assert usual_sidecars("obj", "a", ".png") == ["a.mtl", "a.png"]
    assert usual_sidecars("gltf", "a", ".png") == ["a.bin", "a.png"]
    assert usual_sidecars("gltf", "a", None) == ["a.bin"]
    assert usual_sidecars("glb", "a", ".png") == usual_sidecars("ply", "a", None) == []
    with pytest.raises(UsageError, match="no textures"):
        usual_sidecars("xyz", "a", ".png")


def test_the_registry_loads_no_format():
    code = "import beltrami_cli.formats.registry, sys; print('numpy' in sys.modules, len(sys.modules) > 500)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False False"


MAPS = "newmtl skin\nmap_Kd c.png\nmap_Ka c.png\nnorm n.png\nmap_Ke c.png\nmap_Ks shine.png\n"


def with_vertex_colours():
    return coloured("dense", np.random.default_rng(1)).model


def several_maps(folder):
    path = tiled_model(folder)
    (folder / "model.mtl").write_text(MAPS)
    for number, name in enumerate(("c.png", "n.png", "shine.png")):
        (folder / name).write_bytes(encode(np.roll(part(tile_phantom(), (0, 0)), number, 0), "png"))
    return path


def in_two_buffers(folder):
    """The second buffer holds the colours, the first nothing that changes."""
    path = with_vertex_colours().written_to(folder, "gltf")
    text = path.read_text().replace('"buffers": [', '"buffers": [{"byteLength": 4, "uri": "other.bin"},')
    path.write_text(text.replace('"buffer": 0', '"buffer": 1'))
    (folder / "other.bin").write_bytes(bytes(4))
    return path


def with_fallback(folder):
    files = {f"b.{kind}": encode(tile_phantom()[:16, :16], kind) for kind in ("png", "webp")}
    model = with_better_image("webp", files["b.webp"], files["b.png"])
    for image, name in zip(model.tree["images"], files, strict=True):
        image.pop("bufferView")
        image["uri"] = name
    model.files = files
    return model.written_to(folder, "gltf")


LEVELS = np.random.default_rng(1).integers(0, 256, (len(GRID), 3), np.uint8)
USD = {
    "usda": scene(mesh_text(BOUND), material_text("skin.png")),
    "usda vertices": scene(mesh_text(usd_colours(COLOURS))),
}
# The colours of compressed models are decoded from a buffer, which changes, or from one that stays and is added to.
MODELS = {
    **{kind: partial(write_model, kind=kind, image="skin.png") for kind in ("obj", "ply", "gltf")},
    "obj maps": several_maps,
    "obj tiles": tiled_model,
    "gltf everything": lambda folder: showcase("file").written_to(folder, "gltf"),
    "glb everything": lambda folder: showcase("view").written_to(folder, "glb"),
    "gltf vertices": lambda folder: with_vertex_colours().written_to(folder, "gltf"),
    "gltf two buffers": in_two_buffers,
    "gltf draco": lambda folder: draco_model(LEVELS).written_to(folder, "gltf"),
    "gltf meshopt": lambda folder: meshopt_model(LEVELS).written_to(folder, "gltf"),
    "gltf fallback": with_fallback,
    **{
        name: lambda folder, text=text: write(folder, {"scan.usda": text}) / "scan.usda"
        for name, text in USD.items()
    },
}
TARGETS = sorted({*OUTPUT_FORMATS.values()} - {"usd", "usdc"})


@pytest.fixture
def announced(monkeypatch):
    """The names of the sidecar files, as they are checked before the computation and before writing."""
    found = []
    check = Output.reserve_sidecars

    def noted(output, names):
        found.append({*names})
        check(output, names)

    monkeypatch.setattr(Output, "reserve_sidecars", noted)
    return found


def add_noise(source, target, image_suffix=None):
    """Change the image of each slot in another way."""
    slots = tuple(
        slot for slot in SLOTS if slot != "metallicRoughness"
    )  # which shares the image of occlusion
    settings = SmoothSettings(textures=TextureSettings(slots=slots, image_suffix=image_suffix))
    noise_file(source, target, NoiseSettings(sigma=0.1), settings, Job(overwrite=True))


@pytest.mark.parametrize(("target", "suffix"), [("here", ".jpg"), ("there", None), ("in place", ".jpg")])
@pytest.mark.parametrize("model", MODELS)
def test_the_names_planned_are_those_written(model, target, suffix, announced, tmp_path, usd_core_here):
    if model.startswith("usd"):
        pytest.importorskip("pxr")
    write(tmp_path, {"skin.png": PICTURE})
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
    [(m, f) for i, m in enumerate(MODELS) for j, f in enumerate(TARGETS) if (i + j) % 3 == 0],
)
def test_the_names_planned_for_another_format_are_those_written(
    model, form, announced, tmp_path, usd_core_here
):
    if model.startswith("usd") or form.startswith("usd"):
        pytest.importorskip("pxr")
    write(tmp_path, {"skin.png": PICTURE})
    (tmp_path / "out").mkdir()
    try:
        add_noise(MODELS[model](tmp_path), tmp_path / "out" / f"new.{form}")
    except (UsageError, InputError):
        assert len(announced) <= 1  # before anything was computed
        return
    planned, written = announced
    assert planned == written
