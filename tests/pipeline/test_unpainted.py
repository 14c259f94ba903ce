"""What is said of models in which nothing can be smoothed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from beltrami_cli.errors import InputError, UnpaintedError
from beltrami_cli.formats.source import recognise
from beltrami_cli.pipeline.settings.smooth import SmoothSettings, TextureSettings
from beltrami_cli.pipeline.smooth.file import smooth_file
from hostile.textured_models import PICTURE, write_model

if TYPE_CHECKING:
    from pathlib import Path

PLY = (
    "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n"
    "property list uchar int vertex_indices\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n"
    "end_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2 255 0 0\n"
)
OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"


@pytest.mark.parametrize(
    ("name", "text", "reason"),
    [
        ("a.ply", PLY, "only face colours"),
        ("a.obj", OBJ, "no vertex colours on its 'v' lines"),
        ("a.obj", f"mtllib gone.mtl\n{OBJ}", "'gone.mtl' is missing"),
    ],
)
def test_the_reason_is_told(name: str, text: str, reason: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(UnpaintedError, match=f"neither vertex colours nor textures .*{reason}"):
        smooth_file(tmp_path / name, tmp_path / "out.ply")


def test_vertex_colours_are_not_denied_where_textures_are_asked_for(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text("v 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 1 0 0 0 1\nf 1 2 3\n")
    with pytest.raises(UnpaintedError, match="it has no textures, only vertex colours; use --on vertices"):
        smooth_file(tmp_path / "a.obj", tmp_path / "out.obj", SmoothSettings(on="texture"))


def test_slots_that_are_asked_for_and_empty_are_told_of(tmp_path: Path) -> None:
    model = write_model(tmp_path, "gltf", "skin.png")
    (tmp_path / "skin.png").write_bytes(PICTURE)
    settings = SmoothSettings(textures=TextureSettings(slots=("baseColor", "normal")))
    assert (
        "it has no normal textures"
        in smooth_file(model, tmp_path / "o" / "m.gltf", settings, dry_run=True).warnings
    )


def test_what_is_known_by_its_name_only_does_not_come_through_a_pipe() -> None:
    with pytest.raises(InputError, match=r"no mark of a known format; give OBJ files, .* by their names"):
        recognise(OBJ.encode(), "<stdin>", None)
