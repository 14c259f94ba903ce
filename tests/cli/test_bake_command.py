"""`beltrami bake` and `beltrami smooth --unwrap`: colours go over to a new file, or nothing happens at all."""

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from beltrami_cli.formats.image.decoded_image import new_image
from beltrami_cli.formats.image.reading import read_image
from beltrami_cli.formats.image.writing import write_image
from beltrami_cli.formats.registry import open_document
from cli.commands import SAMPLES, beltrami, copy_samples
from cli.pictures import coloured_file
from formats.ply_files import build, coloured
from formats.volume_files import sphere_file
from oracles import surfaces


def smooth_colours(positions):
    return np.rint(255 * (0.5 + 0.4 * np.sin(2 * positions))) / 255


@pytest.fixture
def sphere(tmp_path):
    positions, faces = surfaces.icosphere(3)
    return coloured_file(tmp_path / "sphere.ply", positions, faces, smooth_colours(positions))


def vertices(path):
    """Colours by place, for comparison whatever the order of vertices."""
    vertices = open_document(str(path)).coloured_vertices()
    order = np.lexsort(np.rint(1e5 * vertices.positions).T)
    return vertices.positions[order], vertices.colours[order], vertices


@pytest.mark.parametrize("extension", ["ply", "gltf"])
def test_smooth_colours_go_to_a_texture_and_come_back(extension, sphere, tmp_path):
    textured, back = tmp_path / f"textured.{extension}", tmp_path / "back.ply"
    beltrami("bake", sphere, textured, "--to", "texture")
    beltrami("bake", textured, back, "--to", "vertices")
    places, colours, mesh = vertices(back)
    old_places, old_colours, old = vertices(sphere)
    assert mesh.stored == "uint8"
    assert len(mesh.faces) == len(old.faces)
    assert np.abs(places - old_places).max() < 1e-6
    # Linear interpolation over an edge h is off by h^2 / 8 times the second derivative, up to 1.6, and by four times
    # that beyond the border of a chart. Three roundings to 8 bits add to it.
    edge = surfaces.mean_edge_length(old.positions, old.faces)
    assert np.abs(colours - old_colours).max() < 1.6 * edge**2 / 2 + 1.5 / 255


@pytest.mark.slow
def test_linear_colours_of_gltf_make_the_texture_that_those_of_ply_make(sphere, tmp_path):
    glb = tmp_path / "sphere.glb"
    beltrami("smooth", sphere, glb, "-n", 0)
    assert open_document(str(glb)).coloured_vertices().encoding == "linear"
    seen = []
    for source in (sphere, glb):
        textured, back = tmp_path / f"from{source.suffix}.obj", tmp_path / f"back{source.suffix}.ply"
        beltrami("bake", source, textured, "--to", "texture")
        pixels = read_image(textured.with_suffix(".png").read_bytes(), "a.png").pixels
        assert pixels.dtype == np.uint8  # linear light has 16 bits in the file, but came from 8
        beltrami("bake", textured, back, "--to", "vertices")
        seen.append(vertices(back)[1])
    # The atlases differ, and between vertices interpolation in linear light and in sRGB; not so at them.
    assert np.abs(seen[0] - seen[1]).max() < 6 / 255


def test_vertices_stay_split_only_where_a_seam_is_a_real_edge(tmp_path):
    # A square in two charts, left and right, at the ends of one image.
    obj = ["mtllib a.mtl", "v 0 0 0", "v 1 0 0", "v 1 1 0", "v 0 1 0", "v 2 0 0", "v 2 1 0"]
    obj += ["vt 0.1 0.1", "vt 0.3 0.1", "vt 0.3 0.9", "vt 0.1 0.9"]
    obj += ["vt 0.7 0.1", "vt 0.9 0.1", "vt 0.9 0.9", "vt 0.7 0.9"]
    obj += ["usemtl m", "f 1/1 2/2 3/3", "f 1/1 3/3 4/4", "f 2/5 5/6 6/7", "f 2/5 6/7 3/8", "l 1 2"]
    source = tmp_path / "a.obj"
    source.write_text("\n".join(obj) + "\n")
    (tmp_path / "a.mtl").write_text("newmtl m\nmap_Kd a.png\n")
    for right, count, expected in ((105, 6, [102.5] * 2), (200, 8, [100, 100, 200, 200])):
        pixels = np.full((20, 40, 3), 100, np.uint8)
        pixels[:, 20:] = right
        (tmp_path / "a.png").write_bytes(write_image(new_image(pixels, "a"), pixels).data)
        result = tmp_path / f"{right}.ply"
        said = beltrami("bake", source, result, "--to", "vertices").stderr
        assert b"Not converted: texture coordinates; textures; materials; lines and points.\n" in said
        vertices = open_document(str(result)).coloured_vertices()
        assert len(vertices.positions) == count
        middle = 255 * vertices.colours[vertices.positions[:, 0] == 1]
        assert np.allclose(np.sort(middle[:, 0]), expected, atol=0.51)


def test_texture_coordinates_can_be_kept_if_every_texel_has_one_place(tmp_path):
    both = copy_samples(tmp_path, "head-tex-clean.*") / "head-tex-clean.obj"
    both.write_text(re.sub(r"(?m)^(v .*)$", r"\1 0.2 0.4 0.6", both.read_text()))
    beltrami("bake", both, tmp_path / "kept.obj", "--to", "texture", "--keep-uv")
    one = open_document(str(both)).textured("baseColor")
    other = open_document(str(tmp_path / "kept.obj")).textured("baseColor")
    assert np.allclose(one.uv, other.uv, atol=1e-6)
    pixels = read_image(other.textures[0].data, "a.png").pixels
    assert (pixels == [51, 102, 153]).all()


@pytest.mark.slow
def test_unwrap_gives_every_place_of_a_mirrored_texture_texels_of_its_own(tmp_path):
    source, result = SAMPLES / "mirrored-noisy.obj", tmp_path / "out.obj"
    assert b"several places" in beltrami("smooth", source, result, "-n", 1, "--fast", "--dry-run").stderr
    run = beltrami("smooth", source, result, "--unwrap", "-n", 1, "--fast", "--texture-size", 256)
    assert run.stderr.endswith(b"out.obj: an 8-bit texture of 256 x 256\n")
    described = beltrami("info", result, "--fast", "-v").stdout
    assert b"several places" not in described
    assert re.search(rb"^ +overlapped +0$", described, re.MULTILINE)
    one, other = tmp_path / "one.ply", tmp_path / "other.ply"
    beltrami("smooth", source, tmp_path / "same.obj", "--unwrap", "-n", 0)
    beltrami("bake", source, one, "--to", "vertices")
    beltrami("bake", tmp_path / "same.obj", other, "--to", "vertices")
    (places, colours, _), (new_places, new_colours, _) = vertices(one), vertices(other)
    far, nearest = cKDTree(places).query(new_places)
    assert far.max() < 1e-5
    # The texture is noisy: each lookup averages it a little.
    assert np.abs(colours[nearest] - new_colours).mean() < 0.03


@pytest.mark.parametrize(
    ("suffix", "bits"), [("png", b"a 16-bit"), ("jpg", b"an 8-bit"), ("exr", b"a 32-bit")]
)
def test_the_words_on_a_new_texture_are_of_its_file(suffix, bits, tmp_path):
    source, result = tmp_path / "in.ply", tmp_path / "out.obj"
    source.write_bytes(build(coloured(colour="ushort", value=60000)).data)
    run = beltrami("smooth", source, result, "--unwrap", "-n", 1, "--fast", "--texture-format", suffix)
    assert bits + b" texture of " in run.stderr


def test_a_glb_goes_to_a_pipe(sphere):
    run = beltrami("bake", "-", "-", "--to", "texture", "--format", "glb", stdin=sphere.read_bytes())
    assert run.stdout[:4] == b"glTF"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("extension", "kind"), [("ply", "uint8"), ("obj", "uint16"), ("glb", "uint8"), ("gltf", "uint16")]
)
def test_one_colour_stays_exactly_that_colour(extension, kind, tmp_path):
    positions, faces = surfaces.icosphere(1)
    full = np.iinfo(kind).max
    colour, alpha = np.array([13, 130, 251]) / 255, np.float32(128 / 255)
    source = coloured_file(
        tmp_path / "plain.ply", positions, faces, np.tile(colour, (len(positions), 1)),
        np.full(len(positions), alpha), stored=kind,
    )  # fmt: skip
    textured, back = tmp_path / f"textured.{extension}", tmp_path / "back.ply"
    beltrami("bake", source, textured, "--to", "texture", "--size", 64)
    texture = open_document(str(textured)).textured("baseColor").textures[0]
    pixels = read_image(texture.data, texture.name).pixels
    assert (pixels.shape, pixels.dtype) == ((64, 64, 4), kind)
    assert (pixels == full // 255 * np.array([13, 130, 251, 128])).all()
    beltrami("bake", textured, back, "--to", "vertices")
    contents = open_document(str(back)).contents()
    assert (contents.colours == colour.astype(np.float32)).all()
    assert (contents.alpha == alpha).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["nonmanifold-noisy.ply", "sphere-exr-noisy.obj", "volume"])
def test_unwrap_lays_out_what_was_smoothed_where_it_was(name, tmp_path):
    """In the new texture noise would be spread over several texels, and would be taken for a pattern."""
    source = sphere_file(tmp_path, 0.3) if name == "volume" else SAMPLES / name
    smooth, new, expected = (
        tmp_path / each for each in (f"smooth{Path(name).suffix or '.ply'}", "new.glb", "expected.glb")
    )
    size = ("--unwrap", "--texture-size", 128)
    beltrami("smooth", source, new, "--fast", "-n", 3, *size)
    beltrami("smooth", source, smooth, "--fast", "-n", 3)
    beltrami("smooth", smooth, expected, "-n", 0, *size)
    found = [open_document(str(path)).textured("baseColor") for path in (new, expected)]
    assert np.array_equal(found[0].uv, found[1].uv)
    one, other = (read_image(each.textures[0].data, "a.png").pixels.astype(int) for each in found)
    # Of three roundings each may move a value by half a level.
    assert np.abs(one - other).max() <= 2
