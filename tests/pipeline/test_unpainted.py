"""What is said of models in which nothing can be smoothed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from beltrami_cli.errors import UnpaintedError
from beltrami_cli.pipeline.smooth.file import smooth_file

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
