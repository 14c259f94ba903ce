"""The registry of formats: what its lines name exists, and files are recognised by content before their names."""

import subprocess
import sys

import numpy as np
import pytest

from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.registry import (
    FORMATS,
    OUTPUT_FORMATS,
    open_bytes,
    recognised,
    sidecar_names,
    write_textured,
)
from formats.image_files import encode, noise
from formats.volume_files import npz


@pytest.mark.parametrize("line", FORMATS, ids=lambda line: line.name)
def test_what_a_line_names_exists(line):
    reader = line.load(line.reader)
    assert issubclass(reader, Document) if line.kind == "model" else callable(reader)
    assert all(callable(line.load(name)) for name in (line.writer, line.textured_writer) if name)


def test_formats_of_output_are_those_with_a_writer():
    assert set(OUTPUT_FORMATS.values()) == {line.name for line in FORMATS if line.writer}
    assert OUTPUT_FORMATS["xyzrgb"] == "xyz"


@pytest.mark.parametrize(
    ("data", "name", "format_name"),
    [
        (b"ply\nformat ascii 1.0\nend_header\n", "x.obj", "ply"),
        (b'{"asset":{"version":"2.0"}}', "x.ply", "gltf"),
        (b"v 0 0 0 1 1 1\n", "X.OBJ", "obj"),
        (b"OFF\n0 0 0\n", "x.xyz", "foreign"),
        (b"OFF\n", "x.obj", "obj"),
        (b"0 0 0 1 1 1\n", "x.xyzrgb", "xyz"),
        (b"0 0 0 1 1 1\n", "x.pts", "pts"),
        (npz(positions=np.zeros((1, 3)), rgb=np.zeros((1, 3))), "-", "npz"),
    ],
)
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
        (b"PK\x03\x04....", "x.obj", "ZIP archive"),
        (b"\x1f\x8b....", "x.xyz", "gzip archive"),
        (b"\xff\xfev\0", "x.obj", "UTF-16"),
        (b"", "x.pts", "the file is empty"),
        (b"something", "<stdin>", "no mark of a known format"),
        (b"something", "x.dat", "of no known format"),
        (b"LASF\0\0", "x.laz", "damaged|package laspy"),
        (b"# .PCD v0.7 - Point Cloud Data\n", "x.xyz", "damaged|package laspy"),
        (b"<GeometryModel3D></GeometryModel3D>", "x.xaml", "no known format"),
        (b"Kaydara FBX Binary  \0", "x.fbx", "FBX file, which is not read; open it in Blender"),
        (b"BLENDER-v400", "x", "Blender file"),
        (
            b"# vtk DataFile Version 3.0\n",
            "x.vtk",
            "VTK file, which is not read; convert it to PLY with ParaView",
        ),
        (b'<?xml version="1.0"?>\n<VTKFile type="PolyData">', "x.bin", "VTK file"),
        (b"b3dm\1\0\0\0", "x.b3dm", "3D Tiles file, which is not read; extract the model with: npx"),
    ],
)
def test_other_files_are_refused_with_the_cause(data, name, cause):
    with pytest.raises(InputError, match=cause):
        open_bytes(data, name, None)


def test_sidecars_follow_from_the_format():
    assert sidecar_names("obj", "a", ".png") == ["a.mtl", "a.png"]
    assert sidecar_names("gltf", "a", ".png") == ["a.bin", "a.png"]
    assert sidecar_names("gltf", "a", None) == ["a.bin"]
    assert sidecar_names("glb", "a", ".png") == sidecar_names("ply", "a", None) == []
    with pytest.raises(UsageError, match="no textures"):
        sidecar_names("xyz", "a", ".png")


def test_points_have_no_texture():
    with pytest.raises(UsageError, match="no textures"):
        write_textured(None, "pts", "a")


def test_the_registry_loads_no_format():
    code = "import beltrami_cli.formats.registry, sys; print('numpy' in sys.modules, len(sys.modules) > 500)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False False"
