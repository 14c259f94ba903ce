"""The official validator and the asset auditor find the same in a file before and after."""

from __future__ import annotations

import os
from collections import Counter
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from beltrami_cli.errors import InputError
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.formats.image import write_image
from beltrami_cli.formats.image.extra_codecs import EXTRA_CODECS, missing_package
from beltrami_cli.formats.image.picture import new_picture
from beltrami_cli.jobs.smooth import smooth_file
from beltrami_cli.layers.settings import SmoothSettings, TextureSettings
from formats.gltf_compressed import GRID, draco_model, meshopt_model
from formats.gltf_files import Model, Textured, gltf_files
from formats.gltf_images import EXTENSIONS, with_better_image
from formats.gltf_showcase import noisy, photo, showcase
from formats.gltf_validator import issues, needs_auditor, needs_validator, unfit
from formats.image_files import noise

SAMPLES = Path(__file__).parents[2] / "sample_data"
EXTRA = os.environ.get("BELTRAMI_EXTRA_MESHES", "").split()  # folders
ONCE = KernelParameters(iterations=1, beta=1)
COLOURS = np.random.default_rng(7).integers(0, 256, (len(GRID), 4)).astype("u1")


def smoothed(source, folder):
    """Smooth a file in every slot that it has; return the result."""
    target = folder / "after" / source.name
    target.parent.mkdir()
    every = TextureSettings(slots=("baseColor", "emissive", "normal", "occlusion", "metallicRoughness"))
    for on in ("both", "auto"):
        try:
            smooth_file(source, target, SmoothSettings(kernel=ONCE, on=on, textures=every))
        except InputError as error:
            if on == "auto":
                pytest.skip(str(error))
        else:
            break
    return target


def issues_before_and_after(source, folder):
    return issues(source, smoothed(source, folder))


@needs_auditor
@pytest.mark.slow
@pytest.mark.parametrize(
    "file",
    [f for f in gltf_files(*EXTRA or [SAMPLES]) if EXTRA or "noisy" in f.name],
    ids=lambda file: file.name,
)
def test_the_asset_auditor_finds_nothing_new(tmp_path, file):
    before, after = unfit(file, smoothed(file, tmp_path), tmp_path)
    # JPEG images of quality 98 may take more than the 5 MB that the auditor allows a file.
    assert after - {"File Size"} <= before


@needs_auditor
@pytest.mark.slow
def test_the_auditor_sees_unfit_images_on_meshes_that_it_does_not_read(tmp_path):
    files = []
    for side in (512, 300):
        model, pixels = Textured(), noise("uint8", 3, side, side)
        image = model.image(write_image(new_picture(pixels, "x"), pixels, suffix=".png").data)
        material = model.material(baseColor=model.texture(image))
        model.triangles(np.eye(3), None, material)  # without texture coordinates
        model.tree = {key: value for key, value in model.tree.items() if value != []}
        (tmp_path / str(side)).mkdir()
        files.append(model.written_to(tmp_path / str(side)))
    before, after = unfit(*files, tmp_path)
    assert after - before == {
        "Texture Height >= Min",
        "Texture Width >= Min",
        "Texture Dimensions are Powers of 2",
    }


@needs_validator
@pytest.mark.slow
@pytest.mark.parametrize(
    "file", [f for f in gltf_files(SAMPLES) if "noisy" in f.name], ids=lambda file: file.name
)
def test_samples_stay_as_valid_as_they_were(tmp_path, file):
    before, after = issues_before_and_after(file, tmp_path)
    assert after == before


@needs_validator
@pytest.mark.skipif(not EXTRA, reason="BELTRAMI_EXTRA_MESHES names no folder")
@pytest.mark.parametrize("file", gltf_files(*EXTRA), ids=lambda file: file.name)
def test_other_files_stay_as_valid_as_they_were(tmp_path, file):
    before, after = issues_before_and_after(file, tmp_path)
    assert not Counter(after) - Counter(before)  # colours out of range may come into it


def with_colours(arrangement):
    """Return a model whose colours lie in one of the ways that cannot simply be overwritten."""
    model = Model()
    colours = noisy("u1", 4, 1)
    attributes = {
        "POSITION": model.packed(np.random.default_rng(0).random((len(colours), 3), "f4"), bounds=True)
    }
    if arrangement == "zeros":
        colour = model.accessor(colours, None, normalized=True)
    elif arrangement == "sparse zeros":
        colour = model.sparse(colours, [1, 3], None, normalized=True)
    else:
        colour = model.packed(colours, normalized=True)
    attributes["COLOR_0"] = colour
    if arrangement == "shared":
        attributes["COLOR_1"] = colour
    if arrangement == "overlapping":
        model.tree["accessors"].append(dict(model.tree["accessors"][colour]))
        attributes["COLOR_1"] = len(model.tree["accessors"]) - 1
    corners = np.arange(24, dtype="<u2").reshape(-1, 3)
    model.mesh({"attributes": attributes, "indices": model.indices(corners)})
    for view in model.tree["bufferViews"]:
        if "byteStride" in view:
            view["target"] = 34962
    return model


def with_extension(known, *, fallback):
    if known in EXTRA_CODECS and missing_package(known):
        pytest.skip(f"not installed: {missing_package(known)}")
    pixels = noise("uint8", 3, 16, 16)
    data = write_image(new_picture(pixels, "x"), pixels, suffix=f".{known}").data
    model = with_better_image(known, data, photo(1) if fallback else None)
    model.tree["accessors"][0] |= {"min": [0, 0, 0], "max": [1, 1, 0]}
    return model


COLOUR_KINDS = ("zeros", "sparse zeros", "shared", "overlapping")
MODELS = {
    **{f"everything, images as {place}": partial(showcase, place) for place in ("view", "data", "file")},
    **{f"colours {kind}": partial(with_colours, kind) for kind in COLOUR_KINDS},
    "Draco": lambda: draco_model(COLOURS),
    "Draco, vertices in order": lambda: draco_model(COLOURS, in_order=True),
    "meshoptimizer": lambda: meshopt_model(COLOURS),
    **{
        f"{known}{' with fallback' if fallback else ''}": partial(with_extension, known, fallback=fallback)
        for known in EXTENSIONS
        for fallback in (False, True)
    },
}


# Not in a GLB with images outside: these are an issue each, and one that two slots share becomes two.
FORMS = [
    *((name, "gltf") for name in MODELS),
    *((name, "glb") for name in ("everything, images as view", "colours zeros", "Draco", "meshoptimizer")),
]


@needs_validator
@pytest.mark.slow
@pytest.mark.parametrize(("name", "form"), FORMS)
def test_features_stay_as_valid_as_they_were(tmp_path, name, form):
    model = MODELS[name]()
    model.tree = {key: value for key, value in model.tree.items() if value != []}
    before, after = issues_before_and_after(model.written_to(tmp_path, form), tmp_path)
    assert after == before
    assert not [issue for issue in before if issue[0] == 0]


@needs_validator
def test_the_validator_sees_what_is_wrong(tmp_path):
    model = with_colours("plain")
    model.tree["accessors"][0]["count"] = 99
    (found,) = issues(model.written_to(tmp_path))
    assert any(code == "ACCESSOR_TOO_LONG" for _, code, _, _ in found)
