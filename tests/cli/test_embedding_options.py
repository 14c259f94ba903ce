"""--guide, --guide-beta, --metric-channels, --smooth-geometry and --normal-beta do what their help says."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest

from beltrami_cli.formats.image.reading import read_image
from beltrami_cli.formats.ply.writer import write_ply
from beltrami_cli.formats.registry import open_document
from beltrami_cli.layers.settings import DEFAULTS
from beltrami_cli.layers.texture_layer import TextureLayer
from beltrami_cli.surface.records import MeshContents
from cli.commands import SAMPLES, beltrami, refused
from oracles import surfaces

NOISY = SAMPLES / "terrain-noisy.ply"
CLEAN = SAMPLES / "terrain-clean.ply"
TEXTURED = SAMPLES / "head-tex-noisy.obj"
# Given, so that they are not chosen from the data, which takes time.
FIXED = ["-t", 2.4, "--beta", 8, "--beta-growth", 1.5, "--metric-steps", 1, "--overwrite", "-q"]


def run(*arguments, **more):
    iterations = [] if "-n" in arguments else ["-n", 4]
    return beltrami(*arguments, *iterations, *FIXED, **more)


def painted(path):
    return open_document(str(path)).painted()


def psnr(path, truth=CLEAN):
    return -10 * np.log10(np.mean((painted(path).colours - painted(truth).colours) ** 2))


@pytest.fixture(scope="module")
def textured(tmp_path_factory):
    """Make a folder with a noisy texture whose material has the clean one as its normal map, and half as large."""
    folder = tmp_path_factory.mktemp("textured")
    for suffix in ("obj", "mtl", "png"):
        shutil.copy(SAMPLES / f"head-tex-noisy.{suffix}", folder)
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
    assert (
        np.mean((covered(textured, "slot.png") - covered(textured, "file.png")) ** 2) < 0.01 * errors["none"]
    )
    assert (textured / "clean.png").read_bytes() == (SAMPLES / "head-tex-clean.png").read_bytes()


def test_vertices_are_guided_by_models_arrays_and_attributes_alike(tmp_path):
    colours = painted(CLEAN).colours
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
    offsets = np.arange(0, 3 * len(faces) + 1, 3)
    normals = np.column_stack([side, 0 * side, 1 - side]).astype(np.float32)
    contents = MeshContents(
        positions, faces.reshape(-1), offsets, colours.astype(np.float32), "srgb", "float32", normals=normals
    )
    source, target = tmp_path / "source.ply", tmp_path / "target.ply"
    source.write_bytes(b"".join(write_ply(contents, "source").main))
    run("smooth", source, target, "--guide", "normal", "--metric-channels", "none", "-n", 10)
    smoothed, document = painted(target).colours, open_document(str(target))
    step = smoothed[side == 1].mean(axis=0) - smoothed[side == 0].mean(axis=0)
    # Averages within a region move its mean by less than the scatter of 0.15 over some 200 samples.
    assert np.allclose(step, colours[side == 1].mean(axis=0) - colours[side == 0].mean(axis=0), atol=0.01)
    assert np.array_equal(document.attribute("normal"), normals)


def test_channels_change_and_metric_channels_count(tmp_path):
    names = {
        "all": [],
        "one": ["--channels", "r", "--metric-channels", "r,g,b"],
        "alone": ["--channels", "r"],
    }
    colours = {}
    for name, options in names.items():
        run("smooth", NOISY, tmp_path / "out.ply", *options)
        colours[name] = painted(tmp_path / "out.ply").colours
    # What only enters the metric is smoothed along, though it is not written: so red comes out as with all channels.
    assert np.array_equal(colours["one"][:, 0], colours["all"][:, 0])
    assert np.array_equal(colours["one"][:, 1:], painted(NOISY).colours[:, 1:])
    assert not np.array_equal(colours["alone"][:, 0], colours["all"][:, 0])


def test_the_report_says_what_was_used(tmp_path):
    run("smooth", NOISY, tmp_path / "out.ply", "--guide", CLEAN, "--guide-beta", 5, "--smooth-geometry",
        "--report", tmp_path / "report.json")  # fmt: skip
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["vertices"]["guides"] == {str(CLEAN): 5.0}
    assert report["vertices"]["geometry"]["normal_beta"] > 0
    assert report["vertices"]["geometry"]["largest_move"] >= report["vertices"]["geometry"]["mean_move"] > 0
    assert report["parameters"]["embedding"]["smooth_geometry"] is True
    info = beltrami("info", NOISY, "--guide", CLEAN, "--guide-beta", 5, "--smooth-geometry", "--json")
    assert json.loads(info.stdout)["smooth"]["guide_betas"] == {str(CLEAN): 5.0}


def rough(path, extension, tmp_path):
    """Shake the vertices of a sample, and write it with another extension."""
    document = open_document(str(path))
    contents = document.contents()
    edge = surfaces.mean_edge_length(contents.positions, document.painted().faces)
    shaken = contents.positions + np.random.default_rng(5).normal(0, 0.1 * edge, contents.positions.shape)
    source = tmp_path / "rough.ply"
    moved = MeshContents(shaken, contents.corners, contents.offsets, contents.colours, "srgb", "uint8")
    source.write_bytes(b"".join(write_ply(moved, "rough").main))
    if extension == "ply":
        return source
    run("smooth", source, tmp_path / f"rough.{extension}", "-n", 0)
    return tmp_path / f"rough.{extension}"


@pytest.mark.slow
@pytest.mark.parametrize("extension", ["ply", "obj", "glb"])
def test_positions_move_only_if_that_is_asked_for(extension, tmp_path):
    source = rough(NOISY, extension, tmp_path)
    before = painted(source)
    run("smooth", source, tmp_path / f"colours.{extension}")
    assert np.array_equal(painted(tmp_path / f"colours.{extension}").positions, before.positions)
    run("smooth", source, tmp_path / f"both.{extension}", "--smooth-geometry")
    after = painted(tmp_path / f"both.{extension}")
    truth = painted(CLEAN).positions
    spacing = surfaces.mean_edge_length(truth, before.faces)
    # A terrain is a height map: what counts is the error upwards. Its border stays as noisy as it was.
    inside = np.any(after.positions != before.positions, axis=1)
    noise = np.std((before.positions - truth)[inside, 2])
    assert inside.mean() > 0.8
    assert np.std((after.positions - truth)[inside, 2]) < noise
    assert noise == pytest.approx(0.1 * spacing, rel=0.1)


def test_positions_may_go_into_another_format(tmp_path):
    source = rough(NOISY, "ply", tmp_path)
    run("smooth", source, tmp_path / "same.ply", "--smooth-geometry")
    run("smooth", source, tmp_path / "other.obj", "--smooth-geometry")
    same, other = painted(tmp_path / "same.ply"), painted(tmp_path / "other.obj")
    assert np.allclose(same.positions, other.positions, atol=1e-5 * np.abs(same.positions).max())


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        ([NOISY, "out.ply", "--guide", "nothing"], 3, "no such file, and no attribute"),
        ([NOISY, "out.ply", "--guide", SAMPLES / "knot-noisy.ply"], 3, "do not fit the 2539 vertices"),
        ([NOISY, "out.ply", "--guide", "odd.npy"], 3, "3 x 3 numbers do not fit"),
        ([NOISY, "out.ply", "--guide", "many.npz"], 3, "which of its arrays one, two is meant"),
        ([NOISY, "out.ply", "--guide", "hollow.npy"], 3, "its row 7 is not finite"),
        ([NOISY, "out.ply", "--guide", "words.npy"], 3, "not of real numbers"),
        ([NOISY, "out.ply", "--guide", "damaged.npy"], 3, "too few numbers"),
        ([NOISY, "out.ply", "--guide", CLEAN, "--guide-beta", "-1"], 2, "one of --guide-beta is -1.0"),
        ([NOISY, "out.ply", "--guide", CLEAN, "--guide-beta", "1", "--guide-beta", "2"], 2, "guide_beta has 2 values"),
        ([NOISY, "out.ply", "--guide-beta", "1"], 2, "add --guide"),
        ([NOISY, "out.ply", "--metric-channels", "x"], 2, "no channel x"),
        ([NOISY, "out.ply", "--metric-channels", "r,none"], 2, "or none"),
        ([NOISY, "out.ply", "--metric-channels", "r", "--space", "oklab"], 2, "oklab"),
        ([NOISY, "out.ply", "--normal-beta", "1"], 2, "add --smooth-geometry"),
        ([NOISY, "out.glb", "--unwrap", "--smooth-geometry"], 2, "--unwrap"),
        ([TEXTURED, "out.obj", "--smooth-geometry"], 2, "--on vertices"),
        ([TEXTURED, "out.obj", "--guide", "normal"], 3, "the slots of"),
        ([TEXTURED, "out.obj", "--guide", SAMPLES / "scan-clean.jpg"], 3, "do not fit the"),
        ([TEXTURED, "out.obj", "--guide", NOISY], 3, "no known image format"),
        ([SAMPLES / "torus-two-noisy.gltf", "out.gltf", "--guide", TEXTURED.with_suffix(".png")], 2, "--texture"),
        ([TEXTURED.with_suffix(".glb"), "out.glb", "--unwrap", "--guide", "normal"], 2, "--unwrap"),
        ([TEXTURED.with_suffix(".png"), "out.png", "--guide", SAMPLES / "scan-clean.jpg"], 3, "do not fit the"),
        ([TEXTURED.with_suffix(".png"), "out.png", "--smooth-geometry"], 2, "--smooth-geometry"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_reported_in_one_line(arguments, code, words, tmp_path):
    np.save(tmp_path / "odd.npy", np.zeros((3, 3)))
    np.savez(tmp_path / "many.npz", one=np.zeros(2539), two=np.zeros(2539))
    hollow = np.zeros(2539)
    hollow[7] = np.inf
    np.save(tmp_path / "hollow.npy", hollow)
    np.save(tmp_path / "words.npy", np.array(["a"] * 2539))
    np.save(tmp_path / "damaged.npy", hollow)
    (tmp_path / "damaged.npy").write_bytes((tmp_path / "damaged.npy").read_bytes()[:-9])
    refused(tmp_path, "smooth", *arguments, code=code, said=words)
