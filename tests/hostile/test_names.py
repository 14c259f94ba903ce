"""Names that mean nothing, or say the wrong thing: a file is what its content is."""

import numpy as np
import pytest

from beltrami_cli.cli.console import printable
from beltrami_cli.errors import InputError
from beltrami_cli.formats.image.reading import read_image
from beltrami_cli.formats.registry import open_document
from beltrami_cli.jobs.smooth import smooth_file
from cli.commands import beltrami
from hostile.folders import snapshot
from hostile.test_hostile_values import MESH
from hostile.textured_models import KINDS, ONCE, PICTURE, write_model


@pytest.mark.parametrize(
    ("kind", "name"),
    [("obj", "skin"), ("ply", "skin.img"), ("gltf", "skin.v1"), ("obj", "skin.jpg"), ("gltf", "skin.jpg"),
     ("ply", "skin.PNG")],
)  # fmt: skip
def test_an_image_of_any_name_is_smoothed_by_its_content(kind, name, tmp_path):
    model = write_model(tmp_path / "in", kind, name)
    (tmp_path / "in" / name).write_bytes(PICTURE)
    target = tmp_path / "out" / model.name
    target.parent.mkdir()
    smooth_file(model, target, ONCE)
    (texture,) = open_document(str(target)).textured("baseColor").textures
    assert texture.data != PICTURE
    assert texture.name.lower().endswith(".png")
    assert read_image(texture.data, texture.name).format == "png"


@pytest.mark.parametrize(("kind", "name"), [("obj", "model.{}"), ("ply", "junk.png"), ("gltf", "junk.png")])
def test_what_is_no_image_is_a_fault_of_the_input(kind, name, tmp_path):
    model = write_model(tmp_path, kind, name.format(kind))
    (tmp_path / "junk.png").write_bytes(b"junk")
    before = snapshot(tmp_path)
    with pytest.raises(InputError, match=f"{name.format(kind)}: .* no known image format"):
        smooth_file(model, tmp_path / f"out.{kind}")
    assert snapshot(tmp_path) == before


@pytest.mark.parametrize("kind", KINDS)
def test_a_name_of_a_million_letters_does_not_fill_the_terminal(kind, tmp_path):
    model = write_model(tmp_path, kind, "x" * 1_000_000)
    with pytest.raises(InputError, match="cannot be the name") as caught:
        smooth_file(model, tmp_path / f"out.{kind}")
    assert len(str(caught.value)) < 1100
    notices = open_document(str(model)).notices
    assert all(len(printable(notice)) < 1100 for notice in notices)


STEMS = [
    "a\nf 1 1 1", "a\rb", "back\\slash", "a\\", " lead", "trail ", 'quo"te', "a #b", "\udcff", "%41%", "a:b", "<UDIM>",
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("stem", STEMS, ids=ascii)
def test_a_model_of_any_name_is_whole_and_finds_its_files(stem, tmp_path):
    """What a format cannot carry is in none of its files: they are named otherwise, or nothing is written."""
    (tmp_path / "mesh.ply").write_bytes(MESH)
    for kind in KINDS:
        source = write_model(tmp_path / kind, kind, "skin.png")
        (tmp_path / kind / "skin.png").write_bytes(PICTURE)
        _smoothed(source, tmp_path / f"{kind} out" / f"{stem}.{kind}")
    _smoothed(tmp_path / "mesh.ply", tmp_path / "converted" / f"{stem}.gltf")
    _smoothed(tmp_path / "ply" / "model.ply", tmp_path / "new" / f"{stem}.obj")


def _smoothed(source, target):
    target.parent.mkdir()
    done = beltrami("smooth", source, target, "--fast", "-n", "1", code=None)
    said = done.stderr.decode()
    assert "unexpected error" not in said
    if done.returncode:
        assert done.returncode in (2, 3, 4), said
        assert list(target.parent.iterdir()) == []
        return
    before, after = (open_document(str(path)) for path in (source, target))
    surfaces = [
        each.textured("baseColor") if each.slots() else each.coloured_vertices() for each in (before, after)
    ]
    assert len(surfaces[0].faces) == len(surfaces[1].faces)
    corners = [surface.positions[surface.faces].reshape(-1, 3) for surface in surfaces]
    np.testing.assert_allclose(*corners, atol=1e-6)
    assert bool(after.slots()) == bool(before.slots())
    sidecars = {path.name for path in target.parent.iterdir()} - {target.name}
    assert {name for name in after.references() if "/" not in name} >= sidecars
    assert not [notice for notice in after.notices if "missing" in notice]
