"""`beltrami bake` and `beltrami smooth --unwrap`: colours go over to a new file, or nothing happens at all."""

from __future__ import annotations

import json
import signal
import subprocess
import time

import numpy as np
import pytest
from scipy.spatial import cKDTree

from beltrami_cli.formats.image import read_image, write_image
from beltrami_cli.formats.image.picture import new_picture
from beltrami_cli.formats.registry import open_document
from cli.commands import COMMAND, SAMPLES, beltrami, interrupted, refused
from cli.pictures import painted_file
from oracles import surfaces

FORMATS = ("ply", "obj", "glb", "gltf")


def smooth_colours(positions):
    return np.rint(255 * (0.5 + 0.4 * np.sin(2 * positions))) / 255


@pytest.fixture
def sphere(tmp_path):
    positions, faces = surfaces.icosphere(3)
    return painted_file(tmp_path / "sphere.ply", positions, faces, smooth_colours(positions))


def vertices(path):
    """Colours by place, for comparison whatever the order of vertices."""
    painted = open_document(str(path)).painted()
    order = np.lexsort(np.rint(1e5 * painted.positions).T)
    return painted.positions[order], painted.colours[order], painted


@pytest.mark.parametrize("extension", ["ply", "gltf"])
def test_smooth_colours_go_to_a_texture_and_come_back(extension, sphere, tmp_path):
    textured, back = tmp_path / f"textured.{extension}", tmp_path / "back.ply"
    beltrami("bake", sphere, textured, "--to", "texture")
    beltrami("bake", textured, back, "--to", "vertices")
    places, colours, painted = vertices(back)
    old_places, old_colours, old = vertices(sphere)
    assert painted.stored == "uint8"
    assert len(painted.faces) == len(old.faces)
    assert np.abs(places - old_places).max() < 1e-6
    # The bound of tests/surface/test_bake.py, and three roundings to 8 bits.
    edge = surfaces.mean_edge_length(old.positions, old.faces)
    assert np.abs(colours - old_colours).max() < 1.6 * edge**2 / 2 + 1.5 / 255


@pytest.mark.slow
@pytest.mark.parametrize("extension", FORMATS)
def test_one_colour_stays_exactly_that_colour(extension, tmp_path):
    positions, faces = surfaces.icosphere(1)
    colour, alpha = np.array([13, 130, 251]) / 255, np.float32(128 / 255)
    source = painted_file(
        tmp_path / "plain.ply", positions, faces, np.tile(colour, (len(positions), 1)),
        np.full(len(positions), alpha),
    )  # fmt: skip
    textured, back = tmp_path / f"textured.{extension}", tmp_path / "back.ply"
    beltrami("bake", source, textured, "--to", "texture", "--size", 64)
    texture = open_document(str(textured)).textured("baseColor").textures[0]
    pixels = read_image(texture.data, texture.name).pixels
    assert pixels.shape == (64, 64, 4)
    assert (pixels == [13, 130, 251, 128]).all()
    beltrami("bake", textured, back, "--to", "vertices")
    contents = open_document(str(back)).contents()
    assert (contents.colours == colour.astype(np.float32)).all()
    assert (contents.alpha == alpha).all()


@pytest.mark.slow
def test_linear_colours_of_gltf_make_the_texture_that_those_of_ply_make(sphere, tmp_path):
    glb = tmp_path / "sphere.glb"
    beltrami("smooth", sphere, glb, "-n", 0)
    assert open_document(str(glb)).painted().encoding == "linear"
    seen = []
    for source in (sphere, glb):
        textured, back = (
            tmp_path / f"from-{source.suffix[1:]}.obj",
            tmp_path / f"back-{source.suffix[1:]}.ply",
        )
        beltrami("bake", source, textured, "--to", "texture")
        pixels = read_image(textured.with_suffix(".png").read_bytes(), "a.png").pixels
        assert pixels.dtype == np.uint8  # linear light has 16 bits in the file, but came from 8
        beltrami("bake", textured, back, "--to", "vertices")
        seen.append(vertices(back)[1])
    # The atlases differ, and between vertices interpolation in linear light and in sRGB; not so at them.
    assert np.abs(seen[0] - seen[1]).max() < 6 / 255


def test_sixteen_bits_stay_sixteen(tmp_path):
    positions, faces = surfaces.icosphere(1)
    source = painted_file(
        tmp_path / "deep.ply", positions, faces, np.full((len(positions), 3), 12345 / 65535), stored="uint16"
    )
    beltrami("bake", source, tmp_path / "out.obj", "--to", "texture", "--size", 64)
    pixels = read_image((tmp_path / "out.png").read_bytes(), "out.png").pixels
    assert pixels.dtype == np.uint16
    assert (pixels == 12345).all()


def test_vertices_stay_split_only_where_a_seam_is_a_real_edge(tmp_path):
    # A square in two charts, left and right, at the ends of one image.
    obj = ["mtllib a.mtl", "v 0 0 0", "v 1 0 0", "v 1 1 0", "v 0 1 0", "v 2 0 0", "v 2 1 0"]
    obj += ["vt 0.1 0.1", "vt 0.3 0.1", "vt 0.3 0.9", "vt 0.1 0.9"]
    obj += ["vt 0.7 0.1", "vt 0.9 0.1", "vt 0.9 0.9", "vt 0.7 0.9"]
    obj += ["usemtl m", "f 1/1 2/2 3/3", "f 1/1 3/3 4/4", "f 2/5 5/6 6/7", "f 2/5 6/7 3/8"]
    source = tmp_path / "a.obj"
    source.write_text("\n".join(obj) + "\n")
    (tmp_path / "a.mtl").write_text("newmtl m\nmap_Kd a.png\n")
    for right, count, expected in ((105, 6, [102.5] * 2), (200, 8, [100, 100, 200, 200])):
        pixels = np.full((20, 40, 3), 100, np.uint8)
        pixels[:, 20:] = right
        (tmp_path / "a.png").write_bytes(write_image(new_picture(pixels, "a"), pixels).data)
        result = tmp_path / f"{right}.ply"
        beltrami("bake", source, result, "--to", "vertices")
        painted = open_document(str(result)).painted()
        assert len(painted.positions) == count
        middle = 255 * painted.colours[painted.positions[:, 0] == 1]
        assert np.allclose(np.sort(middle[:, 0]), expected, atol=0.51)


def test_texture_coordinates_can_be_kept_if_every_texel_has_one_place(tmp_path):
    both = tmp_path / "both.obj"
    lines = (SAMPLES / "head-tex-clean.obj").read_text().splitlines()
    both.write_text(
        "\n".join(f"{line} 0.2 0.4 0.6" if line.startswith("v ") else line for line in lines) + "\n"
    )
    for name in ("head-tex-clean.mtl", "head-tex-clean.png"):
        (tmp_path / name).write_bytes((SAMPLES / name).read_bytes())
    beltrami("bake", both, tmp_path / "kept.obj", "--to", "texture", "--keep-uv")
    one = open_document(str(both)).textured("baseColor")
    other = open_document(str(tmp_path / "kept.obj")).textured("baseColor")
    assert np.allclose(one.uv, other.uv, atol=1e-6)
    pixels = read_image(other.textures[0].data, "a.png").pixels
    assert (pixels == [51, 102, 153]).all()


@pytest.mark.slow
def test_unwrap_smooths_a_mesh_without_texture_coordinates(tmp_path):
    positions, faces = surfaces.icosphere(3)
    clean = smooth_colours(positions)
    noisy = np.clip(clean + np.random.default_rng(5).normal(0, 0.06, clean.shape), 0, 1)
    source = painted_file(tmp_path / "noisy.ply", positions, faces, noisy)
    result, back = tmp_path / "out.glb", tmp_path / "back.ply"
    beltrami("smooth", source, result, "--unwrap")
    assert open_document(str(result)).slots() == ("baseColor",)
    beltrami("bake", result, back, "--to", "vertices")
    places, colours, _ = vertices(back)
    truth = smooth_colours(places)
    assert np.mean((colours - truth) ** 2) < 0.5 * np.mean((noisy - clean) ** 2)


@pytest.mark.slow
def test_unwrap_smooths_textures_as_well_as_they_are_smoothed_without(tmp_path):
    """In the new texture noise would be spread over several texels, and take itself for a pattern."""
    clean, noisy = (SAMPLES / f"sphere-exr-{kind}.obj" for kind in ("clean", "noisy"))
    truth, before, after = (tmp_path / f"{which}.glb" for which in ("truth", "before", "after"))
    for source, result, number in ((clean, truth, ("-n", 0)), (noisy, before, ("-n", 0)), (noisy, after, ())):
        beltrami("smooth", source, result, "--unwrap", "--fast", *number)
    reported = (beltrami("compare", truth, result, "--json").stdout for result in (before, after))
    psnr_before, psnr_after = (json.loads(text)["overall"]["psnr"] for text in reported)
    # In the new texture lookups average the noise of texels, by 3 dB; the rest would be taken for a pattern.
    assert psnr_after > psnr_before + 6


@pytest.mark.slow
def test_unwrap_gives_every_place_of_a_mirrored_texture_texels_of_its_own(tmp_path):
    source, result = SAMPLES / "mirrored-noisy.obj", tmp_path / "out.obj"
    assert b"several places" in beltrami("smooth", source, result, "-n", 1, "--fast", "--dry-run").stderr
    run = beltrami("smooth", source, result, "--unwrap", "-n", 1, "--fast", "--texture-size", 256)
    assert run.stderr.endswith(b"out.obj: an 8-bit texture of 256 x 256\n")
    assert b"several places" not in beltrami("info", result, "--fast", "-v").stdout
    assert b"overlapped 0" in beltrami("info", result, "--fast", "-v").stdout
    one, other = tmp_path / "one.ply", tmp_path / "other.ply"
    beltrami("smooth", source, tmp_path / "same.obj", "--unwrap", "-n", 0)
    beltrami("bake", source, one, "--to", "vertices")
    beltrami("bake", tmp_path / "same.obj", other, "--to", "vertices")
    (places, colours, _), (new_places, new_colours, _) = vertices(one), vertices(other)
    far, nearest = cKDTree(places).query(new_places)
    assert far.max() < 1e-5
    # The texture is noisy: each lookup averages it a little.
    assert np.abs(colours[nearest] - new_colours).mean() < 0.03


_PIPED = "beltrami: <stdout>: there is no folder for its sidecar files; "


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["bake", "{sphere}", "{out}.ply", "--to", "vertices"], 3, "no texture"),
        (["bake", "{sphere}", "{out}.glb", "--to", "texture", "--max-unwrap-faces", "9"], 3, "--max-unwrap-faces 1280"),
        (["bake", "{sphere}", "{out}.glb", "--to", "texture", "--max-unwrap-faces", "9"], 3, "takes long: about 1 s,"),
        (["bake", "{sphere}", "{out}.glb", "--to", "texture", "--size", "3"], 2, "between 16 and 16384"),
        (["bake", "{sphere}", "{out}.glb", "--to", "texture", "--size", "16", "--padding", "3"], 1, "do not fit"),
        (["bake", "{sphere}", "{out}.glb", "--to", "texture", "--keep-uv"], 3, "texture"),
        (["bake", "{sphere}", "{out}.xyz", "--to", "texture"], 2, "has no textures"),
        (["bake", "{sphere}", "{out}.abc", "--to", "texture"], 2, "no format is known"),
        (["smooth", "{sphere}", "{out}.stl"], 2, "out.stl: .stl files are read, but not written: the STL format"),
        (["bake", "{sphere}", "-", "--to", "texture"], 4, _PIPED),
        (["bake", "{sphere}", "-", "--to", "texture", "--format", "obj"], 4, _PIPED),
        (["bake", "{sphere}", "{out}.glb"], 2, "--to"),
        (["smooth", "{sphere}", "{out}.glb", "--texture-size", "64"], 2, "--unwrap"),
        (["smooth", "{sphere}", "{out}.glb", "--unwrap", "--on", "both"], 2, "--on"),
        (["smooth", "{sphere}", "{out}.glb", "--unwrap", "--slots", "normal"], 2, "--slots"),
        (["smooth", "{sphere}", "{out}.glb", "--unwrap", "--texture-format", "tif"], 2, "PNG and JPEG"),
        (["smooth", "{sphere}", "{out}.glb", "--unwrap", "--on", "texture"], 3, "no texture"),
    ],
)  # fmt: skip
def test_what_cannot_be_done_is_said_in_one_line_and_nothing_is_written(
    arguments, code, said, sphere, tmp_path
):
    arguments = [part.format(sphere=sphere, out=tmp_path / "out") for part in arguments]
    refused(tmp_path, *arguments, code=code, said=said)


def test_what_was_made_is_counted_in_words(tmp_path):
    one = painted_file(tmp_path / "one.ply", np.eye(3), np.array([[0, 1, 2]]), np.eye(3))
    run = beltrami("bake", one, tmp_path / "o.obj", "--to", "texture")
    assert b"o.obj: 1 triangle, 1 chart, an 8-bit texture of" in run.stderr
    run = beltrami("bake", tmp_path / "o.obj", tmp_path / "b.ply", "--to", "vertices")
    assert b"b.ply: 3 coloured vertices, 1 triangle\n" in run.stderr


def test_points_without_triangles_are_refused(tmp_path):
    painted_file(tmp_path / "points.ply", np.eye(3), np.zeros((0, 3), int), np.eye(3))
    refused(tmp_path, "bake", "points.ply", "out.glb", "--to", "texture", code=3, said="no triangles")


@pytest.mark.slow
def test_an_output_is_replaced_only_if_that_is_asked_for_and_files_of_others_never(sphere, tmp_path):
    arguments = "bake", sphere, tmp_path / "out.obj", "--to", "texture"
    (tmp_path / "out.obj").write_text("precious")
    refused(tmp_path, *arguments, code=4, said="out.obj: exists already")
    (tmp_path / "out.png").write_text("precious")
    names = ["out-2.mtl", "out-2.png", "out.obj", "out.png", "sphere.ply"]
    for _ in range(2):  # the second time, it replaces its own files
        beltrami(*arguments, "--overwrite")
        assert sorted(path.name for path in tmp_path.iterdir()) == names
        assert (tmp_path / "out.png").read_text() == "precious"


def test_a_glb_goes_to_a_pipe(sphere):
    run = beltrami("bake", "-", "-", "--to", "texture", "--format", "glb", stdin=sphere.read_bytes())
    assert run.stdout[:4] == b"glTF"


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_job_leaves_no_file_and_no_process(number, tmp_path):
    positions, faces = surfaces.icosphere(5)  # takes some seconds
    source = painted_file(tmp_path / "large.ply", positions, faces, smooth_colours(positions))
    job = subprocess.Popen(
        [*COMMAND, "bake", source, tmp_path / "out.glb", "--to", "texture"], stderr=subprocess.PIPE
    )
    child = ""
    while not child and job.poll() is None:
        found = subprocess.run(["pgrep", "-P", str(job.pid)], capture_output=True, text=True, check=False)
        child = found.stdout.strip()
        time.sleep(0.02)
    assert b"files are as they were" in interrupted(job, number, patience=20)
    assert child
    assert subprocess.run(["kill", "-0", child], capture_output=True, check=False).returncode != 0
    assert [path.name for path in tmp_path.iterdir()] == ["large.ply"]
