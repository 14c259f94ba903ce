"""`beltrami info` describes a file and what smoothing would do."""

import json
import re
import shutil

import numpy as np
import pytest

from beltrami_cli import SmoothSettings, inspect_file
from beltrami_cli.cli.documentation import notes_on
from beltrami_cli.cli.phrases import label_of
from beltrami_cli.fields import override
from beltrami_cli.surface.slots import SLOTS
from cli.commands import SAMPLES, beltrami, colours_in, copy_samples
from formats.gltf_files import Textured
from formats.image_files import encode
from formats.volume_files import sphere_file
from oracles.pictures import photograph
from small_models import COLOURED, ply, textured_squares


def info(name, *options):
    run = beltrami("info", SAMPLES / name, "--json", *options)
    return json.loads(run.stdout)


@pytest.mark.slow
def test_the_keys_in_the_examples_of_help_are_there():
    samples = {"ply": "nonmanifold-noisy.ply", "glb": "tiled-noisy.glb", "obj": "mirrored-noisy.obj"}
    examples = re.findall(r"scan\.(\w+) --json \| jq '?\.([.\w\[\]]+)", notes_on("info"))
    assert len(examples) == 3
    for suffix, path in examples:
        values = [info(samples[suffix], "--fast")]
        for key in path.split("."):
            values = [each[key.removesuffix("[]")] for each in values]
            values = [each for value in values for each in value] if key.endswith("[]") else values
        assert values
        assert all(values)


@pytest.mark.parametrize("name", ["nonmanifold-noisy.ply", "torus-two-noisy.gltf", "head-tex-clean.png"])
def test_the_short_text_has_the_answer_in_few_lines(name):
    lines = beltrami("info", SAMPLES / name, "--fast").stdout.decode().splitlines()
    assert len(lines) <= 20
    labels = [line.split("  ")[0] for line in lines]
    assert labels.index("noise") < labels.index("smooth")
    assert "_" not in "".join(line for line in lines if not line.startswith("file"))  # no name of a field


def test_a_range_image_has_no_triangles_in_the_short_text(tmp_path):
    y, x = np.mgrid[:6, :8]
    colours = np.full((6, 8, 3), 0.5)
    np.savez(tmp_path / "range.npz", positions=np.dstack([x, y, 0 * x]).astype(float), colours=colours)
    line = beltrami("info", tmp_path / "range.npz", "--fast", text=True).stdout.splitlines()[0]
    assert line.endswith("npz, 48 vertices")


@pytest.mark.slow
def test_each_of_several_textures_has_its_own_noise_charts_and_pitch(tmp_path):
    copy_samples(tmp_path, "torus-two-noisy*")
    shutil.copy(SAMPLES / "torus-two-clean-dough.png", tmp_path / "torus-two-noisy-dough.png")
    facts = info(tmp_path / "torus-two-noisy.gltf", "--fast")
    (slot,) = facts["textures"]
    icing, dough = slot["images"]
    assert min(icing["noise"].values()) > 15 / 255
    assert max(dough["noise"].values()) < 4 / 255
    # Each is one strip around the torus, whose ends meet in a seam; along both rims it meets the other.
    assert (icing["charts"], dough["charts"], slot["charts"]) == (1, 1, 2)
    assert (icing["seams"], dough["seams"], slot["seams_between_textures"], slot["seams"]) == (1, 1, 1, 3)
    # The same surface: where there are fewer texels each is wider.
    assert min(icing["pitch"], dough["pitch"]) <= slot["pitch"] <= max(icing["pitch"], dough["pitch"])


def test_overlap_is_counted_for_the_texture_that_has_it(tmp_path):
    shutil.copy(SAMPLES / "mirrored-noisy.png", tmp_path / "shared.png")
    shutil.copy(SAMPLES / "mirrored-noisy.png", tmp_path / "own.png")
    places = {0: "shared.png", 5: "shared.png", 9: "own.png"}
    textured_squares(tmp_path / "both.obj", *((image, left, (0, 1)) for left, image in places.items()))
    slots = info(tmp_path / "both.obj", "--fast")["textures"]  # which do not touch
    shared, own = (image for slot in slots for image in slot["images"])
    assert shared["overlapped"] == shared["width"] * shared["height"] == slots[0]["overlapped"]
    assert (shared["charts"], own["charts"], own["overlapped"]) == (2, 1, 0)


@pytest.mark.slow
def test_textures_in_other_slots_are_named(tmp_path):
    model = json.loads((SAMPLES / "torus-two-noisy.gltf").read_text())
    model["materials"][0]["emissiveTexture"] = {"index": 0}
    copy_samples(tmp_path, "torus-two-noisy*")
    (tmp_path / "both.gltf").write_text(json.dumps(model))
    assert "--slots emissive shows" in info(tmp_path / "both.gltf", "--fast")["notices"][-1]
    assert info(tmp_path / "both.gltf", "--fast", "--slots", "baseColor,emissive")["notices"] == []


@pytest.mark.slow
def test_vertex_colours_beside_textures_are_described_and_said_to_stay(tmp_path):
    copy_samples(tmp_path, "scan-noisy.jpg")
    rows = [[x, y, 0, 60 * x, 90, 200 * y, x, y] for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))]
    model = ply(f"{COLOURED}, float s t", rows, [range(4)], comments=["TextureFile scan-noisy.jpg"])
    (tmp_path / "both.ply").write_bytes(model)
    facts = info(tmp_path / "both.ply", "--fast")
    assert facts["colours"]["greatest"] == pytest.approx([60 / 255, 90 / 255, 200 / 255])
    assert facts["surface"]["triangles"] == 2
    assert "smooth" not in facts
    assert facts["textures"][0]["images"][0]["name"] == "scan-noisy.jpg"
    assert "--on both" in facts["notices"][0]
    assert "smooth" in info(tmp_path / "both.ply", "--fast", "--on", "both")
    assert "colours" not in info(tmp_path / "both.ply", "--fast", "--on", "texture")


def kinds_in(value):
    """The types of a value and of all in it."""
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return {type(value)}.union(*map(kinds_in, inner))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("nonmanifold-noisy.obj", ("--fast", "--smooth-geometry")),
        ("nonmanifold-noisy.obj", ("--preset", "paper")),
        ("torus-two-noisy-dough.png", ("--fast",)),
    ],
)
def test_facts_are_of_json_types_alone_and_can_be_shown(name, options):
    source = SAMPLES / name
    settings = override(SmoothSettings(), smooth_geometry="--smooth-geometry" in options)
    assert kinds_in(inspect_file(source, settings)) <= {dict, list, str, int, float, bool, type(None)}
    assert beltrami("info", source, *options).stderr == b""


@pytest.mark.slow
def test_many_files_make_a_table_with_a_line_for_each_part(tmp_path):
    copy_samples(tmp_path, "knot-noisy.ply", "torus-two-noisy*", "scan-noisy.jpg")
    run = beltrami("info", tmp_path, tmp_path / "*.jpg", tmp_path / "knot-noisy.ply", "--fast", text=True)
    head, *lines = run.stdout.splitlines()
    assert head.split() == ["file", "format", "part", "samples", "noise", "n", "t", "beta"]
    rows = {line.split()[0].rpartition("/")[2]: line.split()[1:] for line in lines}
    assert len(lines) == len(rows) == 3  # each once
    assert rows["knot-noisy.ply"][:3] == ["ply", "vertices", "5184"]
    assert rows["torus-two-noisy.gltf"][:2] == ["gltf", "baseColor"]
    assert rows["scan-noisy.jpg"][:3] == ["jpeg", "pixels", str(512 * 512)]
    for name, row in rows.items():
        alone = json.loads(beltrami("info", tmp_path / name, "--fast", "--json", text=True).stdout)
        part = alone["textures"][0] if "textures" in alone else alone
        assert float(row[-1]) == pytest.approx(part["smooth"]["beta"], rel=5e-3)


def test_the_table_has_no_kernel_for_what_is_not_smoothed(tmp_path):
    copy_samples(tmp_path, "nonmanifold-noisy.ply", "nonmanifold-noisy.obj")
    lines = beltrami("info", *tmp_path.iterdir(), "--noise", "0", text=True).stdout.splitlines()[1:]
    assert [line.split()[-2:] for line in lines] == [["0.0/255", "0"]] * 2


def test_many_files_make_a_line_of_json_each_and_what_cannot_be_read_is_said(tmp_path):
    for name in ("a.ply", "b.ply"):
        shutil.copy(SAMPLES / "nonmanifold-noisy.ply", tmp_path / name)
    (tmp_path / "c.ply").write_bytes(b"ply\nformat ascii 1.0\n")
    run = beltrami("info", "*.ply", "--fast", "--json", cwd=tmp_path, text=True, code=3)
    assert [json.loads(line)["file"]["name"] for line in run.stdout.splitlines()] == ["a.ply", "b.ply"]
    assert "c.ply" in run.stderr
    assert "1 of 3 files" in run.stderr
    beltrami("info", "none*.ply", cwd=tmp_path, code=3)


@pytest.mark.slow
def test_noise_that_samples_share_is_that_which_smooth_finds(tmp_path):
    noisy, done = tmp_path / "noisy.png", tmp_path / "done.json"
    (tmp_path / "clean.png").write_bytes(encode(np.rint(255 * photograph(160)).astype(np.uint8), "png"))
    grain = ("--kind", "grain", "--grain-size", "2", "--sigma", "12")
    beltrami("noise", tmp_path / "clean.png", noisy, *grain)
    beltrami("smooth", noisy, tmp_path / "smooth.png", "--report", done)
    facts, report = info(noisy), json.loads(done.read_text())["image"]
    assert facts["noise_model"]["grain"] > 1
    assert facts["noise"] == report["noise"]


@pytest.mark.parametrize(
    ("name", "at", "options"),
    [
        ("nonmanifold-noisy.ply", "100", ("--strength", "strong", "-n", 1, "--patches", "on")),
        ("mirrored-noisy.obj", "0.4,0.4", ("--fast",)),
        ("torus-two-noisy-dough.png", "90,70", ()),
    ],
)
@pytest.mark.slow
def test_kernel_info_and_smooth_say_the_same_parameters_of_a_file(name, at, options, tmp_path):
    source, record = SAMPLES / name, tmp_path / "run.json"
    smooth = beltrami("smooth", source, tmp_path / name, "-v", "--dry-run", "--report", record, *options)
    shown = beltrami("kernel", source, tmp_path / "kernel.csv", "--at", at, *options, text=True).stderr
    done, info = colours_in(record), json.loads(beltrami("info", source, "--json", *options).stdout)
    planned = info["smooth"] if "smooth" in info else info["textures"][0]["smooth"]
    for key in ("beta", "iterations"):
        assert done[key] == planned[key]
    assert planned["patches"] == ("off" if done["patches"] is None else "on")
    if planned["iterations"] == 1:  # of the first iteration, from some of the kernels
        assert planned["samples_per_kernel"] == pytest.approx(done["counts"]["samples_per_kernel"], rel=0.05)
    assert f"in iteration 1 of {planned['iterations']}," in shown
    assert f"beta {planned['beta']:.3g}\n" in shown
    assert re.search(rf"^  beta +{planned['beta']:.5g}$", smooth.stderr.decode(), re.MULTILINE)
    predicted = (planned.get("choice") or {}).get("predicted")
    assert predicted == (done["choice"] or {}).get("predicted")


def write_textured(path, slots, *, is_flat=False, colours=False):
    """Write a square with one image in the given slots; `is_flat`: with all of its vertices at one place."""
    model = Textured("data")
    shown = model.texture(model.image(encode((200 * photograph(64)).astype(np.uint8), "png")))
    corners = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)], "<f4")
    attributes = {"TEXCOORD_0": model.packed(corners[:, :2].copy())}
    if colours:
        attributes["COLOR_0"] = model.packed(np.full((4, 3), 0.5, "<f4"))
    positions, material = corners * (not is_flat), model.material("m", **dict.fromkeys(slots, shown))
    model.triangles(positions, attributes, material, corners=[0, 1, 2, 1, 3, 2])
    path.write_bytes(model.glb())


def write_of_kind(folder, kind):
    """Write a small file whose parts are of a kind of layer; return its path."""
    rng, path = np.random.default_rng(0), folder / "a.ply"
    if kind in SLOTS:
        write_textured(folder / "a.glb", [kind])
        return folder / "a.glb"
    if kind.startswith("both"):
        write_textured(folder / "a.glb", ["baseColor", "normal"], is_flat="flat" in kind, colours=True)
        return folder / "a.glb"
    if kind == "image":
        return shutil.copy(SAMPLES / "torus-two-clean-dough.png", folder / "a.png")
    if kind == "level set":
        return sphere_file(folder, 0.3)
    if kind == "range image":
        y, x = np.mgrid[:8, :8]
        places = np.dstack([x, y, 0 * x]).astype(float)
        np.savez(folder / "a.npz", positions=places, colours=rng.random((8, 8, 3)))
        return folder / "a.npz"
    y, x = np.divmod(np.arange(64), 8)
    rows = [[*p, 0, *c] for p, c in zip(zip(x, y, strict=True), rng.integers(0, 255, (64, 3)), strict=True)]
    faces = [[8 * i + j, 8 * i + j + 1, 8 * i + j + 9, 8 * i + j + 8] for i in range(7) for j in range(7)]
    if kind == "flat vertices":
        rows = [[0, 0, 0, *row[3:]] for row in rows]
    path.write_bytes(ply(COLOURED, rows, [] if kind == "points" else faces))
    return path


KINDS = (
    "vertices",
    "flat vertices",
    "points",
    "level set",
    "range image",
    "image",
    "both",
    "both flat",
    *SLOTS,
)
CHOICES = {"both": ("auto", "both", "vertices", "texture"), "both flat": ("auto", "texture")}


@pytest.mark.parametrize(
    ("kind", "on"), [(kind, on) for kind in KINDS for on in CHOICES.get(kind, ("auto",))]
)
def test_every_key_of_every_kind_of_layer_and_slot_is_shown(kind, on, tmp_path):
    source = write_of_kind(tmp_path, kind)
    options = [
        "--fast",
        *(["--slots", kind] if kind in SLOTS else []),
        *(["--on", on] if on != "auto" else []),
    ]
    facts = info(source, *options)
    long, short = (beltrami("info", source, *options, *more).stdout.decode() for more in (["-v"], []))
    table = beltrami("info", source, source, *options).stdout.decode()
    parts = [*facts.get("textures", []), *([facts] if "smooth" in facts else [])]
    assert len(parts) == {"both": 2}.get(on, 1)
    assert short.count("\nnoise ") == len(parts)
    for part in parts:
        assert {"noise", "noise_model", "reading", "smooth"} <= part.keys()
    for name, value in [*facts.items(), *(each for part in parts for each in part.items())]:
        assert label_of(name) in long or value in (None, {}, [])
    rows = table.splitlines()[1:]
    assert len(rows) == len(parts)
    for row in rows:
        assert int(re.split(r"  +", row)[3]) > 0  # samples
