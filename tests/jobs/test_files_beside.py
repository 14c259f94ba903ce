"""Files beside an output: those of other models stay, superseded ones are not copied, none is written twice."""

from __future__ import annotations

import json

import numpy as np
import pytest

from beltrami_cli.errors import InputError, OutputError
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.formats.image import read_image
from beltrami_cli.formats.registry import open_bytes, open_document
from beltrami_cli.jobs.job import Job
from beltrami_cli.jobs.noise import noise_file
from beltrami_cli.jobs.settings import NoiseSettings
from beltrami_cli.jobs.smooth import smooth_file
from beltrami_cli.samples.settings import SmoothSettings, TextureSettings
from formats.image_files import encode
from hostile.textured_models import OTHER, PICTURE, write_model

KERNEL = KernelParameters(iterations=1, t=1.0, beta=3.0, metric_steps=0, beta_growth=1.0)
KINDS = ["obj", "ply", "gltf"]


def smooth(source, target, **textures):
    target.parent.mkdir(parents=True, exist_ok=True)
    settings = SmoothSettings(kernel=KERNEL, textures=TextureSettings(**textures))
    return smooth_file(source, target, settings, job=Job(overwrite=True))


def model(folder, kind, picture):
    path = write_model(folder, kind, "skin.png")
    (folder / "skin.png").write_bytes(picture)
    return path


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def texture(path):
    (found,) = open_document(str(path)).textured("baseColor").textures
    return found


@pytest.mark.parametrize(
    ("named", "there"),
    [("SKIN.png", "skin.png"), ("skins/Skin.png", "Skins/skin.PNG"), ("h\u00e4ute.png", "ha\u0308ute.png")],
)
@pytest.mark.parametrize("kind", KINDS)
def test_a_name_in_other_capitals_or_accents_is_pointed_out(kind, named, there, tmp_path):
    path = write_model(tmp_path, kind, named)
    (tmp_path / there).parent.mkdir(exist_ok=True)
    (tmp_path / there).write_bytes(PICTURE)
    if (tmp_path / named).exists():
        pytest.skip("this file system takes them for one name")
    with pytest.raises(InputError, match="is missing") as caught:
        smooth_file(path, tmp_path / f"o.{kind}")
    assert f"(there is '{there}', but capitals and accents count); keep the model's files" in str(
        caught.value
    )


def test_names_beyond_a_link_are_not_given_away(tmp_path):
    (tmp_path / "secret").mkdir()
    (tmp_path / "secret" / "skin.png").write_bytes(PICTURE)
    path = write_model(tmp_path / "in", "obj", "linked/SKIN.png")
    (tmp_path / "in" / "linked").symlink_to(tmp_path / "secret")
    with pytest.raises(InputError) as caught:
        smooth_file(path, tmp_path / "o.obj")
    assert "skin.png" not in str(caught.value)


@pytest.mark.parametrize("kind", ["ply", "gltf"])
def test_what_comes_through_a_pipe_has_no_files_beside_it(kind, tmp_path):
    data = write_model(tmp_path, kind, "skin.png").read_bytes()
    with pytest.raises(InputError, match="whose folder is not known; give the model as a file"):
        open_bytes(data, "<stdin>", None).textured("baseColor")


@pytest.mark.parametrize("kind", KINDS)
def test_tiles_are_not_called_missing(kind, tmp_path):
    with pytest.raises(InputError, match=r"\(UDIM\), which are not read; give each tile"):
        smooth_file(write_model(tmp_path, kind, "skin.<UDIM>.png"), tmp_path / f"o.{kind}")


@pytest.mark.parametrize("kind", KINDS)
def test_a_model_leaves_the_files_of_another_in_the_same_folder(kind, tmp_path):
    one, other = (model(tmp_path / name, kind, data) for name, data in (("a", PICTURE), ("b", OTHER)))
    out = tmp_path / "out"
    smooth(one, out / f"one.{kind}")
    before = contents(out)
    report = smooth(other, out / f"other.{kind}")
    after = contents(out)
    assert {name: after[name] for name in before} == before
    smooth(other, tmp_path / "alone" / f"other.{kind}")
    assert texture(out / f"other.{kind}").data == texture(tmp_path / "alone" / f"other.{kind}").data
    assert any("skin.png" in warning and "stays" in warning for warning in report.warnings)
    # Once more, both are replaced by themselves, under the names that they have.
    smooth(one, out / f"one.{kind}")
    smooth(other, out / f"other.{kind}")
    assert contents(out) == after


def test_noise_leaves_the_files_of_another_model_too(tmp_path):
    one, other = (model(tmp_path / name, "obj", data) for name, data in (("a", PICTURE), ("b", OTHER)))
    (tmp_path / "out").mkdir()
    for source, name in ((one, "one"), (other, "other")):
        noise_file(
            source, tmp_path / "out" / f"{name}.obj", NoiseSettings(sigma=0.1), job=Job(overwrite=True)
        )
    assert texture(tmp_path / "out" / "one.obj").data != texture(tmp_path / "out" / "other.obj").data
    assert texture(tmp_path / "out" / "one.obj").name == "skin.png"


def test_unchanged_files_of_one_name_but_other_content_are_refused(tmp_path):
    sources = [model(tmp_path / name, "obj", PICTURE) for name in ("a", "b")]
    for number, source in enumerate(sources):
        library = source.parent / "m.mtl"
        library.write_text(library.read_text() + "map_Ks shine.png\n")
        (source.parent / "shine.png").write_bytes([PICTURE, OTHER][number])
    out = tmp_path / "out"
    smooth(sources[0], out / "one.obj")
    before = contents(out)
    with pytest.raises(OutputError, match=r"shine\.png.* choose another folder"):
        smooth(sources[1], out / "other.obj")
    assert contents(out) == before
    (sources[1].parent / "shine.png").write_bytes(PICTURE)
    smooth(sources[1], out / "other.obj")
    assert contents(out)["shine.png"] == PICTURE


@pytest.mark.parametrize("kind", KINDS)
def test_an_image_that_becomes_one_of_another_format_is_not_copied_besides(kind, tmp_path):
    source = model(tmp_path / "a", kind, PICTURE)
    target = tmp_path / "out" / source.name
    smooth(source, target, image_suffix=".jpg")
    named = open_document(str(target)).references()
    assert {path.name for path in target.parent.iterdir()} == {source.name, *named}
    assert "skin.jpg" in named
    assert "skin.png" not in named


def test_an_image_that_comes_out_as_it_was_replaces_no_other(tmp_path):
    source = model(tmp_path / "a", "gltf", PICTURE)
    smooth(source, tmp_path / "out" / "one.gltf")
    flat = model(tmp_path / "b", "gltf", encode(np.full((16, 16, 3), 90, np.uint8), "png"))
    smooth(flat, tmp_path / "c" / "model.gltf")  # encoded as it is here
    before = contents(tmp_path / "out")
    with pytest.raises(OutputError, match="choose another folder"):
        smooth(tmp_path / "c" / "model.gltf", tmp_path / "out" / "other.gltf")
    assert contents(tmp_path / "out") == before


def test_an_old_image_that_something_else_shows_is_copied_though(tmp_path):
    source = model(tmp_path / "a", "obj", PICTURE)
    library = source.parent / "m.mtl"
    library.write_text(library.read_text() + "map_Ks skin.png\n")
    target = tmp_path / "out" / "model.obj"
    smooth(source, target, image_suffix=".jpg")
    assert contents(target.parent)["skin.png"] == PICTURE


def test_occlusion_and_roughness_of_one_image_stay_one_image(tmp_path):
    source = model(tmp_path / "a", "gltf", PICTURE)
    tree = json.loads(source.read_text())
    tree["materials"][0] = {
        "occlusionTexture": {"index": 0},
        "pbrMetallicRoughness": {"metallicRoughnessTexture": {"index": 0}},
    }
    source.write_text(json.dumps(tree))
    pixels = {}
    for slots in (("occlusion",), ("metallicRoughness",), ("occlusion", "metallicRoughness")):
        target = tmp_path / "-".join(slots) / "model.gltf"
        smooth(source, target, slots=slots)
        (found,) = open_document(str(target)).textured(slots[0]).textures
        pixels[slots] = read_image(found.data, found.name).pixels
    both = pixels["occlusion", "metallicRoughness"]
    np.testing.assert_array_equal(both[..., 0], pixels["occlusion",][..., 0])
    np.testing.assert_array_equal(both[..., 1:], pixels["metallicRoughness",][..., 1:])
    assert (both != read_image(PICTURE, "skin.png").pixels).any(axis=(0, 1)).all()
    tree = json.loads(target.read_text())
    assert len(tree["images"]) == len(tree["textures"]) == 1
    assert {path.name for path in target.parent.iterdir()} == {"model.gltf", "skin.png"}


def test_an_image_that_two_slots_show_alike_is_written_once(tmp_path):
    source = model(tmp_path / "a", "obj", PICTURE)
    library = source.parent / "m.mtl"
    library.write_text(library.read_text() + "map_Ke skin.png\n")
    target = tmp_path / "out" / "model.obj"
    smooth(source, target, slots=("baseColor", "emissive"))
    assert {path.name for path in target.parent.iterdir()} == {"model.obj", "m.mtl", "skin.png"}
    assert texture(target).data != PICTURE
