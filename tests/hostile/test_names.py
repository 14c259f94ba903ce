"""Names that mean nothing, or say the wrong thing: a file is what its content is."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from beltrami_cli.cli.console import printable
from beltrami_cli.errors import InputError
from beltrami_cli.formats.image import read_image
from beltrami_cli.formats.registry import open_document
from beltrami_cli.jobs.smooth import smooth_file
from hostile.folders import snapshot
from hostile.textured_models import ONCE, PICTURE, write_model

if TYPE_CHECKING:
    from pathlib import Path

KINDS = ("obj", "ply", "gltf")


@pytest.mark.parametrize("name", ["skin", "skin.img", "skin.v1", "skin.jpg", "skin.PNG"])
@pytest.mark.parametrize("kind", KINDS)
def test_an_image_of_any_name_is_smoothed_by_its_content(kind: str, name: str, tmp_path: Path) -> None:
    model = write_model(tmp_path / "in", kind, name)
    (tmp_path / "in" / name).write_bytes(PICTURE)
    target = tmp_path / "out" / model.name
    target.parent.mkdir()
    smooth_file(model, target, ONCE)
    (texture,) = open_document(str(target)).textured("baseColor").textures
    assert texture.data != PICTURE
    assert texture.name.lower().endswith(".png")
    assert read_image(texture.data, texture.name).format == "png"


@pytest.mark.parametrize("name", ["model.{}", "junk.png"])
@pytest.mark.parametrize("kind", KINDS)
def test_what_is_no_image_is_a_fault_of_the_input(kind: str, name: str, tmp_path: Path) -> None:
    model = write_model(tmp_path, kind, name.format(kind))
    (tmp_path / "junk.png").write_bytes(b"junk")
    before = snapshot(tmp_path)
    with pytest.raises(InputError, match=f"{name.format(kind)}: .* no known image format"):
        smooth_file(model, tmp_path / f"out.{kind}")
    assert snapshot(tmp_path) == before


@pytest.mark.parametrize("kind", KINDS)
def test_a_name_of_a_million_letters_does_not_fill_the_terminal(kind: str, tmp_path: Path) -> None:
    model = write_model(tmp_path, kind, "x" * 1_000_000)
    with pytest.raises(InputError, match="cannot be the name") as caught:
        smooth_file(model, tmp_path / f"out.{kind}")
    assert len(str(caught.value)) < 1100
    notices = open_document(str(model)).notices
    assert all(len(printable(notice)) < 1100 for notice in notices)
