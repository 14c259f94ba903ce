"""A whole glTF file through smoothing: all but colours comes out as it went in, to the last byte."""

from __future__ import annotations

import dataclasses
import os
import re

import pytest

from beltrami_cli.errors import InputError
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.jobs.smooth import smooth_file
from beltrami_cli.layers.settings import SmoothSettings
from formats.gltf_comparison import byte_differences, json_differences
from formats.gltf_files import gltf_files, opened
from formats.gltf_showcase import showcase

EXTRA = os.environ.get("BELTRAMI_EXTRA_MESHES", "").split()  # folders
SETTINGS = SmoothSettings(kernel=KernelParameters(iterations=1, beta=1), on="both")
GLOSS = r"extensions\.KHR_materials_pbrSpecularGlossiness\.diffuseTexture"
INFOS = rf"(pbrMetallicRoughness\.baseColorTexture|{GLOSS})\.index"


def smoothed(model, form, folder, *, moved):
    """Return the paths of a model before and after."""
    source = model.written_to(folder, form)
    target = folder / "other" / source.name if moved else folder / f"smooth{source.suffix}"
    target.parent.mkdir(exist_ok=True)
    smooth_file(source, target, SETTINGS)
    return source, target


def allowed(tree):
    """Return what may differ in the JSON: where colours, images and their buffers are."""
    colours = {part["attributes"].get("COLOR_0") for mesh in tree["meshes"] for part in mesh["primitives"]}
    tree = {"images": [], "textures": [], "bufferViews": []} | tree
    views = {image["bufferView"] for image in tree["images"] if "bufferView" in image}
    new = {
        key: "|".join(str(len(tree[key]) + more) for more in range(6))
        for key in ("bufferViews", "images", "textures")
    }
    patterns = [
        r"buffers\[0\]\.byteLength",
        r"(buffers|images)\[\d+\]\.uri",
        *(rf"bufferViews\[{view}\]\.(byteOffset|byteLength)" for view in views),
        *(rf"accessors\[{colour}\]\.(min|max)\[[0-3]\]" for colour in colours),
        *(rf"{key}\[({numbers})\]" for key, numbers in new.items()),
        r"textures\[\d+\]\.source",
        rf"materials\[\d+\]\.{INFOS}",
    ]
    return re.compile("|".join(patterns))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("place", "form", "moved"),
    [("view", "glb", False), ("view", "gltf", True), ("view", "data", True), ("data", "glb", True),
     ("data", "gltf", False), ("file", "glb", True), ("file", "gltf", True), ("file", "data", False)],
)  # fmt: skip
def test_only_colours_change_in_a_file_with_everything(tmp_path, place, form, moved):
    source, target = smoothed(showcase(place), form, tmp_path, moved=moved)
    check_only_colours_changed(source, target)


def check_only_colours_changed(source, target):
    before, after = opened(source), opened(target)
    free = allowed(before[0])
    changed = json_differences(before[0], after[0])
    assert [place for place in changed if not free.fullmatch(place)] == []
    assert byte_differences(before, after) <= {"COLOR_0", "image"}


@pytest.mark.skipif(not EXTRA, reason="BELTRAMI_EXTRA_MESHES names no folder")
@pytest.mark.parametrize("file", gltf_files(*EXTRA), ids=lambda file: file.name)
def test_only_colours_change_in_other_files(tmp_path, file):
    try:
        smooth_file(file, tmp_path / file.name, dataclasses.replace(SETTINGS, on="auto"))
    except InputError as error:
        pytest.skip(str(error))
    check_only_colours_changed(file, tmp_path / file.name)


def test_the_comparison_sees_every_kind_of_change(tmp_path):
    model = showcase()
    source = model.written_to(tmp_path, "glb")
    before = opened(source)
    attributes = before[0]["meshes"][0]["primitives"][0]["attributes"]
    for name in ("POSITION", "WEIGHTS_0", "COLOR_0"):
        tree, (octets, *_), _ = opened(source)
        view = tree["bufferViews"][tree["accessors"][attributes[name]]["bufferView"]]
        changed = bytearray(octets)
        changed[view["byteOffset"]] ^= 1
        assert byte_differences(before, (tree, [bytes(changed)])) == {name}
        tree["nodes"][0]["extras"]["number"] = 99
        assert list(json_differences(before[0], tree)) == ["nodes[0].extras.number"]
