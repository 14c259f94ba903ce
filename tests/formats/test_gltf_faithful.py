"""A whole glTF file through smoothing: all but colours comes out as it went in, and as valid.

JSON and buffers are compared value by value, and judged by the official validator.
"""

import re
from functools import partial

import numpy as np
import pytest

from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.formats.image.decoded_image import new_image
from beltrami_cli.formats.image.extra_codecs import EXTRA_CODECS, missing_package
from beltrami_cli.formats.image.writing import write_image
from beltrami_cli.jobs.smooth import smooth_file
from beltrami_cli.layers.settings import SmoothSettings, TextureSettings
from beltrami_cli.surface.slots import SLOTS
from formats.gltf_comparison import (
    EXTENSIONS,
    byte_differences,
    issues,
    json_differences,
    needs_validator,
    with_better_image,
)
from formats.gltf_compressed import GRID, draco_model, meshopt_model
from formats.gltf_files import ARRANGEMENTS, coloured, opened
from formats.gltf_showcase import photo, showcase
from formats.image_files import noise

SETTINGS = SmoothSettings(kernel=KernelParameters(iterations=1, beta=1), on="both")
GLOSS = r"extensions\.KHR_materials_pbrSpecularGlossiness\.diffuseTexture"
INFOS = rf"(pbrMetallicRoughness\.baseColorTexture|{GLOSS})\.index"


def allowed(tree):
    """Return what may differ in the JSON: where colours, images and their buffers are."""
    colours = {part["attributes"].get("COLOR_0") for mesh in tree["meshes"] for part in mesh["primitives"]}
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
    source = showcase(place).written_to(tmp_path, form)
    target = tmp_path / "other" / source.name if moved else tmp_path / f"smooth{source.suffix}"
    target.parent.mkdir(exist_ok=True)
    smooth_file(source, target, SETTINGS)
    before, after = opened(source), opened(target)
    free = allowed(before[0])
    changed = json_differences(before[0], after[0])
    assert [place for place in changed if not free.fullmatch(place)] == []
    assert byte_differences(before, after) <= {"COLOR_0", "image"}


ONCE = SmoothSettings(KernelParameters(iterations=1, beta=1), textures=TextureSettings(slots=SLOTS))
COLOURS = np.random.default_rng(7).integers(0, 256, (len(GRID), 4)).astype("u1")
INVALID = (
    "interleaved",
    "overlapping",
)  # without bounds of positions, and with attributes of several lengths


def with_colours(arrangement):
    model = coloured(arrangement, np.random.default_rng(0)).model
    corners = model.indices(np.arange(24, dtype="<u2").reshape(-1, 3))
    for primitive in model.tree["meshes"][0]["primitives"]:
        primitive["indices"] = corners
    for view in model.tree["bufferViews"]:
        if "byteStride" in view:
            view["target"] = 34962
    return model


def with_extension(known, *, fallback):
    pixels = noise("uint8", 3, 16, 16)
    data = write_image(new_image(pixels, "x"), pixels, suffix=f".{known}").data
    model = with_better_image(known, data, photo(1) if fallback else None)
    model.tree["accessors"][0] |= {"min": [0, 0, 0], "max": [1, 1, 0]}
    return model


MODELS = {
    **{f"images as {place}": partial(showcase, place) for place in ("view", "data", "file")},
    **{f"colours {kind}": partial(with_colours, kind) for kind in ARRANGEMENTS if kind not in INVALID},
    "Draco": partial(draco_model, COLOURS),
    "Draco, vertices in order": partial(draco_model, COLOURS, in_order=True),
    "meshoptimizer": partial(meshopt_model, COLOURS),
    **{
        f"{known}{' with fallback' * fallback}": partial(with_extension, known, fallback=fallback)
        for known in EXTENSIONS
        if known not in EXTRA_CODECS or not missing_package(known)
        for fallback in (False, True)
    },
}


@needs_validator
@pytest.mark.slow  # all files together, since to start the validator takes longest
def test_results_are_as_valid_as_their_sources(tmp_path):
    files = {}
    for name, make in MODELS.items():
        # Not in a GLB with images outside: these are an issue each, and one that two slots share becomes two.
        for form in ("gltf", "glb") if name in ("images as view", "colours zeros", "Draco") else ("gltf",):
            folder = tmp_path / f"{name} {form}"
            (folder / "after").mkdir(parents=True)
            model = make()
            model.tree = {key: value for key, value in model.tree.items() if value != []}
            source = model.written_to(folder, form)
            target = folder / "after" / source.name
            has_colours = "COLOR_0" in source.read_bytes().decode("latin-1")
            on = "both" if "textures" in model.tree and has_colours else "auto"
            smooth_file(source, target, ONCE, on=on)
            files[folder.name] = source, target
    before, after = (issues(*column) for column in zip(*files.values(), strict=True))
    assert dict(zip(files, after, strict=True)) == dict(zip(files, before, strict=True))
    assert not [issue for found in before for issue in found if issue[0] == 0]


@needs_validator
def test_the_validator_sees_what_is_wrong(tmp_path):
    model = with_colours("dense")
    model.tree["accessors"][0]["count"] = 99
    (found,) = issues(model.written_to(tmp_path))
    assert any(code == "ACCESSOR_TOO_LONG" for _, code, _, _ in found)
