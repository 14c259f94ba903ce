"""Messages about models in which nothing can be smoothed."""

import re
from functools import partial

import numpy as np
import pytest

from beltrami_cli.errors import InputError, NoColoursError
from beltrami_cli.formats.registry import open_bytes, open_document
from beltrami_cli.jobs.job import Job
from beltrami_cli.jobs.smooth import smooth_file
from beltrami_cli.layers.settings import SmoothSettings
from beltrami_cli.view.drawing.views import view_of
from beltrami_cli.view.settings import RenderSettings
from formats.image_files import encode
from hostile.textured_models import PICTURE, write_model
from small_models import COLOURED, ply

PLY = (
    "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n"
    "property list uchar int vertex_indices\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n"
    "end_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2 255 0 0\n"
)
OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"


@pytest.mark.parametrize(
    ("name", "text", "reason"),
    [
        ("a.ply", PLY.replace("red", "heat"), "no vertex colours among"),
        ("a.obj", OBJ, "no vertex colours on its 'v' lines"),
        ("a.obj", f"mtllib gone.mtl\n{OBJ}", "'gone.mtl' is missing"),
    ],
)
def test_the_reason_is_reported(name, text, reason, tmp_path):
    (tmp_path / name).write_text(text)
    with pytest.raises(NoColoursError, match=f"neither vertex colours nor textures .*{reason}"):
        smooth_file(tmp_path / name, tmp_path / "out.ply")


def test_vertex_colours_are_not_denied_where_textures_are_asked_for(tmp_path):
    (tmp_path / "a.obj").write_text(f"{COLOURED_OBJ}f 1 2 3\n")
    with pytest.raises(NoColoursError, match="it has no textures, only vertex colours; use --on vertices"):
        smooth_file(tmp_path / "a.obj", tmp_path / "out.obj", SmoothSettings(on="texture"))


def test_slots_that_are_asked_for_and_empty_are_mentioned(tmp_path):
    model = write_model(tmp_path, "gltf", "skin.png")
    (tmp_path / "skin.png").write_bytes(PICTURE)
    done = smooth_file(model, tmp_path / "o.gltf", job=Job(dry_run=True), slots=("baseColor", "normal"))
    assert "it has no normal textures" in done.warnings


def test_what_is_known_by_its_name_only_does_not_come_through_a_pipe():
    with pytest.raises(InputError, match=r"no mark of a known format; give OBJ files, .* by their names"):
        open_bytes(OBJ.encode(), "<stdin>", None)


@pytest.mark.slow
def test_a_texture_that_cannot_be_seen_is_distinguished_from_one_that_is_not_covered(tmp_path):
    model = write_model(tmp_path, "obj", "skin.png")
    noise = np.random.default_rng(1).integers(0, 256, (32, 32, 4), np.uint8)
    noise[..., 3] = 0
    (tmp_path / "skin.png").write_bytes(encode(noise, "png"))
    dry = partial(smooth_file, model, tmp_path / "o.obj", job=Job(dry_run=True))
    (reported,) = dry().warnings
    assert reported.endswith("nothing was changed; --alpha smooth counts them, too")
    assert not any("--alpha smooth" in warning for warning in dry(alpha="smooth").warnings)
    noise[..., 3] = 255
    (tmp_path / "skin.png").write_bytes(encode(noise, "png"))
    model.write_text(re.sub(r"vt .*", "vt 0.5 0.5", model.read_text()))
    (reported,) = dry().warnings
    assert reported.endswith("`smooth --unwrap` makes a new atlas")


def test_what_is_wrong_with_an_image_is_said_with_the_model(tmp_path):
    model = write_model(tmp_path, "gltf", "skin.png")
    (tmp_path / "skin.png").write_bytes(PICTURE[:60])
    for attempt in (
        lambda: smooth_file(model, tmp_path / "o.gltf", iterations=1),
        lambda: view_of(open_document(str(model)), RenderSettings()),
    ):
        with pytest.raises(InputError, match=r"model\.gltf: skin\.png: the PNG image is damaged .*; export"):
            attempt()


COLOURED_OBJ = "v 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 1 0 0 0 1\n"
TEXTURED_OBJ = f"mtllib a.mtl\n{COLOURED_OBJ}vt 0 0\nvt 1 0\nusemtl m\nf 1/1 2/2 3/1"
TEXTURED_PLY = ply(
    f"{COLOURED}, float s t", [[0, 0, 0, 255, 0, 0, 0, 0], [1, 0, 0, 0, 255, 0, 1, 0], [0, 1, 0, 0, 0, 255, 0, 1]],
    [range(3)], comments=["TextureFile gone.png"],
).decode()  # fmt: skip


@pytest.mark.parametrize("target", ["b.obj", "b.ply", "b.glb"])
@pytest.mark.parametrize(("name", "text"), [("a.obj", TEXTURED_OBJ), ("a.ply", TEXTURED_PLY)])
def test_vertex_colours_do_not_need_a_missing_texture(name, text, target, tmp_path):
    (tmp_path / "a.mtl").write_text("newmtl m\nmap_Kd gone.png\n")
    (tmp_path / name).write_text(text)
    report = smooth_file(tmp_path / name, tmp_path / target, iterations=1, beta=1e-3)
    assert "'gone.png' is missing, and is left alone." in report.warnings
    before, after = (open_document(str(tmp_path / each)) for each in (name, target))
    assert np.abs(after.coloured_vertices().colours - before.coloured_vertices().colours).max() > 0.1
    view_of(before, RenderSettings())
    with pytest.raises(NoColoursError, match=r"'gone\.png' is missing; keep the model's files together"):
        smooth_file(tmp_path / name, tmp_path / f"c{name}", SmoothSettings(on="texture"))


@pytest.mark.parametrize("form", ["gltf", "obj", "ply"])
def test_the_remedy_is_that_of_the_cause_whatever_a_file_is_called(form, tmp_path):
    model = write_model(tmp_path, form, ".is missing.png")
    with pytest.raises(NoColoursError, match="is a hidden file") as refused:
        smooth_file(model, tmp_path / f"o.{form}", SmoothSettings(on="texture"))
    assert refused.value.remedy == ""
