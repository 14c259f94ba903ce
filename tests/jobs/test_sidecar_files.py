"""Sidecar files of an output: named after it, never in the way of other files, and none is written twice."""

import json

import numpy as np
import pytest

from beltrami_cli.errors import InputError
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.formats.image.reading import read_image
from beltrami_cli.formats.registry import open_bytes, open_document
from beltrami_cli.jobs.bake import bake_file
from beltrami_cli.jobs.check import check_files
from beltrami_cli.jobs.job import Job
from beltrami_cli.jobs.noise.file import noise_file
from beltrami_cli.jobs.settings import BakeSettings, NoiseSettings
from beltrami_cli.jobs.smooth import smooth_file
from beltrami_cli.layers.settings import SmoothSettings, TextureSettings
from cli.commands import SAMPLES
from formats.image_files import encode
from hostile.textured_models import KINDS, OTHER, PICTURE, write_model

KERNEL = KernelParameters(iterations=1, t=1.0, beta=3.0, metric_steps=0, beta_growth=1.0)


def smooth(source, target, **textures):
    target.parent.mkdir(parents=True, exist_ok=True)
    settings = SmoothSettings(kernel=KERNEL, textures=TextureSettings(**textures))
    return smooth_file(source, target, settings, job=Job(overwrite=True))


def add_noise(source, target, **textures):
    target.parent.mkdir(parents=True, exist_ok=True)
    noise_file(source, target, NoiseSettings(0.1), SmoothSettings(textures=TextureSettings(**textures)))


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
    said = f"(there is '{there}', but capitals and accents count); keep the model's files"
    assert said in str(caught.value)


def test_names_beyond_a_link_are_not_given_away(tmp_path):
    (tmp_path / "secret").mkdir()
    (tmp_path / "secret" / "skin.png").write_bytes(PICTURE)
    path = write_model(tmp_path / "in", "obj", "linked/SKIN.png")
    (tmp_path / "in" / "linked").symlink_to(tmp_path / "secret")
    with pytest.raises(InputError) as caught:
        smooth_file(path, tmp_path / "o.obj")
    assert "skin.png" not in str(caught.value)


@pytest.mark.parametrize("kind", ["ply", "gltf"])
def test_what_comes_through_a_pipe_has_no_sidecar_files(kind, tmp_path):
    data = write_model(tmp_path, kind, "skin.png").read_bytes()
    with pytest.raises(InputError, match="which is not known; give the model as a file"):
        open_bytes(data, "<stdin>", None).textured("baseColor")


@pytest.mark.parametrize("kind", ["ply", "gltf"])
def test_tiles_are_not_called_missing(kind, tmp_path):
    with pytest.raises(InputError, match=r"\(UDIM\), which are not read; give each tile"):
        smooth_file(write_model(tmp_path, kind, "skin.<UDIM>.png"), tmp_path / f"o.{kind}")


PAIRS = ([f"one.{kind}", f"other.{kind}"] for kind in KINDS)


@pytest.mark.parametrize("targets", [*PAIRS, [f"model.{kind}" for kind in KINDS]], ids=" ".join)
def test_models_whose_files_have_one_name_go_to_one_folder(targets, tmp_path):
    out = tmp_path / "out"
    sources = {
        name: model(tmp_path / str(number), name.rpartition(".")[2], PICTURE if number else OTHER)
        for number, name in enumerate(targets)
    }
    out.mkdir()
    for number, (name, source) in enumerate(sources.items()):
        before = contents(out)
        warnings = smooth(source, out / name).warnings
        # Models of one name would give their files the same names, which is reported.
        assert any("another model" in warning for warning in warnings) == (number > 0 and name[0] == "m")
        assert contents(out).items() >= before.items()
    after = contents(out)
    for name, source in sources.items():
        smooth(source, tmp_path / "alone" / source.suffix / name)
        assert texture(out / name).data == texture(tmp_path / "alone" / source.suffix / name).data
        smooth(source, out / name)  # once more, it replaces its own files
    assert contents(out) == after


def test_unchanged_files_of_one_name_but_other_content_are_copied_each_for_itself(tmp_path):
    sources = [model(tmp_path / name, "obj", PICTURE) for name in ("a", "b")]
    for number, source in enumerate(sources):
        library = source.parent / "m.mtl"
        library.write_text(library.read_text() + "map_Ks maps/shine.png\n")
        (source.parent / "maps").mkdir()
        (source.parent / "maps" / "shine.png").write_bytes([PICTURE, OTHER][number])
        smooth(source, tmp_path / "out" / f"{source.parent.name}.obj")
        assert check_files(source, tmp_path / "out" / f"{source.parent.name}.obj").faithful
    shines = contents(tmp_path / "out" / "maps")
    assert shines == {"a_shine.png": PICTURE, "b_shine.png": OTHER}
    assert "map_Ks maps/b_shine.png" in (tmp_path / "out" / "b.mtl").read_text()


@pytest.mark.parametrize("kind", KINDS)
def test_in_its_own_place_a_model_keeps_the_names_of_its_files(kind, tmp_path):
    source = model(tmp_path, kind, PICTURE)
    before = contents(tmp_path)
    smooth(source, source)
    after = contents(tmp_path)
    assert after.keys() == before.keys()
    assert {name for name in before if after[name] != before[name]} == {"skin.png"}
    smooth(source, source, image_suffix=".jpg")
    assert contents(tmp_path).keys() == before.keys() | {"skin.jpg"}
    assert texture(source).name == "skin.jpg"


def test_a_file_that_appears_meanwhile_is_not_replaced(tmp_path):
    source, out = model(tmp_path / "in", "obj", PICTURE), tmp_path / "out"
    out.mkdir()
    settings, meant = SmoothSettings(kernel=KERNEL), out / "one_skin.png"
    job = Job(overwrite=True, progress=lambda *_: meant.write_bytes(b"of another program"))
    smooth_file(source, out / "one.obj", settings, job=job)
    assert meant.read_bytes() == b"of another program"
    assert texture(out / "one.obj").name == "one_skin-2.png"


@pytest.mark.slow
def test_new_textures_do_not_replace_those_of_another_file(tmp_path):
    ply = SAMPLES / "nonmanifold-clean.ply"
    job = Job(overwrite=True)
    reports = [bake_file(ply, tmp_path / name, "texture", job=job) for name in ("scan.obj", "scan.ply")]
    reports.append(smooth_file(ply, tmp_path / "scan.gltf", job=job, unwrap=BakeSettings()))
    assert ["another model" in " ".join(report.warnings) for report in reports] == [False, True, True]
    names = [texture(tmp_path / f"scan.{kind}").name for kind in KINDS]
    assert names == ["scan.png", "scan-2.png", "scan-3.png"]


@pytest.mark.parametrize("kind", KINDS)
def test_an_image_that_becomes_one_of_another_format_is_not_copied_besides(kind, tmp_path):
    source = model(tmp_path / "a", kind, PICTURE)
    target = tmp_path / "out" / source.name
    smooth(source, target, image_suffix=".jpg")
    named = open_document(str(target)).references()
    assert {path.name for path in target.parent.iterdir()} == {source.name, *named}
    assert "model_skin.jpg" in named
    assert "model_skin.png" not in named


def test_an_image_that_comes_out_as_it_was_replaces_no_other(tmp_path):
    source = model(tmp_path / "a", "gltf", PICTURE)
    smooth(source, tmp_path / "out" / "one.gltf")
    flat = model(tmp_path / "b", "gltf", encode(np.full((16, 16, 3), 90, np.uint8), "png"))
    smooth(flat, tmp_path / "c" / "model.gltf")  # encoded as it is here
    before = contents(tmp_path / "out")
    smooth(tmp_path / "c" / "model.gltf", tmp_path / "out" / "other.gltf")
    after = contents(tmp_path / "out")
    assert {name: after[name] for name in before} == before
    assert texture(tmp_path / "out" / "other.gltf").data == texture(tmp_path / "c" / "model.gltf").data


def test_an_old_image_that_something_else_shows_is_copied_though(tmp_path):
    source = model(tmp_path / "a", "obj", PICTURE)
    library = source.parent / "m.mtl"
    library.write_text(library.read_text() + "map_Ns skin.png\n")
    target = tmp_path / "out" / "model.obj"
    smooth(source, target, image_suffix=".jpg")
    assert contents(target.parent)["model_skin.png"] == PICTURE


@pytest.mark.parametrize("change", [smooth, add_noise])
def test_occlusion_and_roughness_of_one_image_stay_one_image(change, tmp_path):
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
        change(source, target, slots=slots)
        (found,) = open_document(str(target)).textured(slots[0]).textures
        pixels[slots] = read_image(found.data, found.name).pixels
    both = pixels["occlusion", "metallicRoughness"]
    np.testing.assert_array_equal(both[..., 0], pixels["occlusion",][..., 0])
    np.testing.assert_array_equal(both[..., 1:], pixels["metallicRoughness",][..., 1:])
    assert (both != read_image(PICTURE, "skin.png").pixels).any(axis=(0, 1)).all()
    tree = json.loads(target.read_text())
    assert len(tree["images"]) == len(tree["textures"]) == 1
    assert {path.name for path in target.parent.iterdir()} == {"model.gltf", "model_skin.png"}


def test_an_image_that_two_slots_show_alike_is_written_once(tmp_path):
    source = model(tmp_path / "a", "obj", PICTURE)
    library = source.parent / "m.mtl"
    library.write_text(library.read_text() + "map_Ke skin.png\n")
    target = tmp_path / "out" / "model.obj"
    smooth(source, target, slots=("baseColor", "emissive"))
    assert {path.name for path in target.parent.iterdir()} == {"model.obj", "model.mtl", "model_skin.png"}
    assert texture(target).data != PICTURE
