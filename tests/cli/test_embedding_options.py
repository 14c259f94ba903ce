"""--guide, --guide-beta, --metric-channels, --smooth-geometry and --normal-beta do what their help says."""

import dataclasses
import json
import shutil

import numpy as np
import pytest

from beltrami_cli.formats.image.reading import read_image
from beltrami_cli.formats.registry import open_document
from beltrami_cli.layers.selection import select
from beltrami_cli.layers.settings import DEFAULTS
from beltrami_cli.layers.texture_layer import TextureLayer
from cli.commands import SAMPLES, beltrami, copy_samples
from formats.image_files import encode, noise
from hostile.folders import write
from oracles import surfaces
from small_models import ply

NOISY = SAMPLES / "terrain-noisy.ply"
CLEAN = SAMPLES / "terrain-clean.ply"
# Given, so that they are not chosen from the data, which takes time.
FIXED = ["-t", 2.4, "--beta", 8, "--beta-growth", 1.5, "--metric-steps", 1, "--overwrite", "-q"]


def run(*arguments, **more):
    iterations = [] if "-n" in arguments else ["-n", 4]
    return beltrami(*arguments, *iterations, *FIXED, **more)


def vertices_of(path):
    return open_document(str(path)).coloured_vertices()


def psnr(path, truth=CLEAN):
    return -10 * np.log10(np.mean((vertices_of(path).colours - vertices_of(truth).colours) ** 2))


@pytest.fixture(scope="module")
def textured(tmp_path_factory):
    """Make a folder with a noisy texture whose material has the clean one as its normal map, and half as large."""
    folder = copy_samples(tmp_path_factory.mktemp("textured"), "head-tex-noisy.*")
    shutil.copy(SAMPLES / "head-tex-clean.png", folder / "clean.png")
    with (folder / "head-tex-noisy.mtl").open("a") as file:
        file.write("norm clean.png\n")
    return folder


def covered(folder, name):
    """Colours of the covered texels of an image in the folder."""
    surface = open_document(str(folder / "head-tex-noisy.obj")).textured("baseColor")
    texels = TextureLayer.read(surface, "baseColor", DEFAULTS).atlas.owned_texels
    return read_image((folder / name).read_bytes(), name).pixels[..., :3].reshape(-1, 3)[texels] / 255


@pytest.mark.slow
def test_the_normal_map_of_a_material_guides_its_base_colour(textured):
    clean = covered(textured, "clean.png")
    guided = {"slot": "normal", "file": textured / "clean.png", "none": None}
    errors = {}
    for name, guide in guided.items():
        options = ["--metric-channels", "none", *(["--guide", guide] if guide else [])]
        run("smooth", textured / "head-tex-noisy.obj", textured / f"{name}.obj", *options)
        errors[name] = np.mean((covered(textured, f"{name}.png") - clean) ** 2)
    assert errors["slot"] < 0.5 * errors["none"]
    # Colours as a guide are the same in a slot and in a file, but for seams: a normal map has frames of its own there.
    apart = covered(textured, "slot.png") - covered(textured, "file.png")
    assert np.mean(apart**2) < 0.01 * errors["none"]
    assert (textured / "clean.png").read_bytes() == (SAMPLES / "head-tex-clean.png").read_bytes()


def test_notices_on_the_images_of_a_guiding_slot_are_shown_where_it_guides(tmp_path):
    library = b"newmtl a\nmap_Kd a.png\nnorm a.png\nnewmtl b\nmap_Kd a.png\nnorm -clamp on a.png\n"
    lines = b"mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n"
    faces = b"usemtl a\nf 1/1 2/2 3/3\nusemtl b\nf 3/1 2/2 1/3\n"
    write(tmp_path, {"m.mtl": library, "a.png": encode(noise("uint8", 3), "png"), "x.obj": lines + faces})
    for guides in ((), ("Normal",)):
        embedding = dataclasses.replace(DEFAULTS.embedding, guides=guides)
        settings = dataclasses.replace(DEFAULTS, embedding=embedding)
        notices = select(open_document(str(tmp_path / "x.obj")), settings).notices
        assert any(
            "normal image 'a.png' is used with several wrap modes" in each for each in notices
        ) == bool(guides)


@pytest.mark.slow
def test_vertices_are_guided_by_models_arrays_and_attributes_alike(tmp_path):
    colours = vertices_of(CLEAN).colours
    np.save(tmp_path / "guide.npy", colours)
    np.savez(tmp_path / "guide.npz", anything=colours.astype(np.float64))
    results = []
    for guide in (CLEAN, tmp_path / "guide.npy", tmp_path / "guide.npz"):
        run("smooth", NOISY, tmp_path / "out.ply", "--guide", guide, "--metric-channels", "none")
        results.append((tmp_path / "out.ply").read_bytes())
    assert results[0] == results[1] == results[2]
    run("smooth", NOISY, tmp_path / "plain.ply")
    assert psnr(tmp_path / "out.ply") > psnr(tmp_path / "plain.ply") + 1


def test_a_property_of_the_vertices_guides_and_stays(tmp_path):
    positions, faces = surfaces.plane(24, 24)
    side = (positions[:, 0] > 12).astype(np.float32)
    colours = 0.5 + 0.1 * side[:, None] + np.random.default_rng(1).normal(0, 0.15, (len(positions), 3))
    normals = np.column_stack([side, 0 * side, 1 - side])
    rows = np.column_stack([positions, normals, colours]).tolist()
    source, target = tmp_path / "source.ply", tmp_path / "target.ply"
    source.write_bytes(ply("float x y z nx ny nz red green blue", rows, faces.tolist()))
    run("smooth", source, target, "--guide", "normal", "--metric-channels", "none", "-n", 10)
    smoothed, document = vertices_of(target).colours, open_document(str(target))
    step = smoothed[side == 1].mean(axis=0) - smoothed[side == 0].mean(axis=0)
    # Averages within a region move its mean by less than the scatter of 0.15 over some 200 samples.
    assert np.allclose(step, colours[side == 1].mean(axis=0) - colours[side == 0].mean(axis=0), atol=0.01)
    assert np.array_equal(document.attribute("normal"), normals)


def test_channels_change_and_metric_channels_count(tmp_path):
    one = ["--channels", "r"]
    names, colours = {"all": [], "one": [*one, "--metric-channels", "r,g,b"], "alone": one}, {}
    for name, options in names.items():
        run("smooth", NOISY, tmp_path / "out.ply", *options)
        colours[name] = vertices_of(tmp_path / "out.ply").colours
    # What only enters the metric is smoothed along, though it is not written: so red comes out as with all channels.
    assert np.array_equal(colours["one"][:, 0], colours["all"][:, 0])
    assert np.array_equal(colours["one"][:, 1:], vertices_of(NOISY).colours[:, 1:])
    assert not np.array_equal(colours["alone"][:, 0], colours["all"][:, 0])


@pytest.mark.slow
@pytest.mark.parametrize("extension", ["ply", "obj", "glb"])
def test_vertices_move_if_that_is_asked_for_and_the_report_says_how_far(extension, tmp_path):
    source, target = NOISY.with_suffix(f".{extension}"), tmp_path / f"out.{extension}"
    report = tmp_path / "run.json"
    options = ("--guide", CLEAN, "--guide-beta", 5)
    run("smooth", source, target, *options)
    before = vertices_of(source)
    assert np.array_equal(vertices_of(target).positions, before.positions)
    run("smooth", source, target, *options, "--smooth-geometry", "--report", report)
    reported = json.loads(report.read_text())
    assert reported["parameters"]["embedding"]["smooth_geometry"] is True
    assert reported["vertices"]["guides"] == {str(CLEAN): 5.0}
    moves = np.linalg.norm(vertices_of(target).positions - before.positions, axis=1)
    geometry = reported["vertices"]["geometry"]
    assert geometry["normal_beta"] > 0
    assert moves.max() == pytest.approx(geometry["largest_move"], rel=1e-2)
    assert moves.mean() == pytest.approx(geometry["mean_move"], rel=1e-2)
    info = beltrami("info", source, *options, "--smooth-geometry", "--json")
    assert json.loads(info.stdout)["smooth"]["guide_betas"] == {str(CLEAN): 5.0}


@pytest.mark.slow
def test_moved_vertices_may_go_into_another_format(tmp_path):
    for name in ("same.ply", "other.glb"):  # in which the quads become triangles
        run("smooth", NOISY, tmp_path / name, "--smooth-geometry")
    same, other = (vertices_of(tmp_path / name).positions for name in ("same.ply", "other.glb"))
    assert not np.array_equal(same, vertices_of(NOISY).positions)
    assert np.allclose(same, other, atol=1e-6)
