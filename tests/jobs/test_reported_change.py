"""The change that a report tells is the one between the files, whatever their formats lose of it."""

import dataclasses

import numpy as np
import pytest

from beltrami_cli import SmoothSettings, smooth_file
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.formats.registry import open_document
from beltrami_cli.jobs.compare.files import compare_files
from beltrami_cli.jobs.noise.file import noise_file
from beltrami_cli.jobs.settings import NoiseSettings
from cli.commands import refused
from formats.image_files import encode, phantom
from hostile.textured_models import write_model
from small_models import COLOURED, ply

SOURCES = {
    ".png": ("png", {}), ".jpg": ("jpeg", {"jpeg__subsampling": "4:2:0"}),
    ".webp": ("webp", {"compression": "webp:90"}),
}  # fmt: skip
# Kinds of OUTPUT, from lossless ones to those that take most of the noise away.
TARGETS = (".png", ".jpg", ".webp", ".avif", ".ktx2", ".bmp", ".jxl")
GIVEN = SmoothSettings(KernelParameters(iterations=1, beta=9, patches="off"))


def rms_between(before, after):
    return 10 ** (-compare_files(before, after).overall["psnr"] / 20)


@pytest.mark.parametrize("suffix", TARGETS)
@pytest.mark.parametrize("own", SOURCES)
def test_the_change_of_an_image_is_that_of_the_file(own, suffix, tmp_path):
    source, target = tmp_path / f"in{own}", tmp_path / f"out{suffix}"
    known, options = SOURCES[own]
    source.write_bytes(encode(phantom(), known, **options))
    (added,) = noise_file(source, target, NoiseSettings(sigma=0.1)).added
    assert added.rms == pytest.approx(rms_between(source, target), rel=1e-3)
    smoothed = tmp_path / f"smooth{suffix}"
    report = smooth_file(source, smoothed, GIVEN)
    assert report.image.change["rms"] == pytest.approx(rms_between(source, smoothed), rel=1e-3)


@pytest.mark.parametrize("suffix", [None, ".jpg"])
def test_the_change_of_a_texture_is_that_of_the_file(suffix, tmp_path):
    source, target = write_model(tmp_path / "in", "obj", "skin.png"), tmp_path / "out.obj"
    (source.parent / "skin.png").write_bytes(encode(phantom(), "png"))
    wanted = dataclasses.replace(SmoothSettings().textures, image_suffix=suffix)
    settings = SmoothSettings(textures=wanted)
    report = noise_file(source, target, NoiseSettings(sigma=0.1), settings)
    image = next(tmp_path / name for name in report.written if name.endswith((".png", ".jpg")))
    # All texels but those at the border are covered.
    assert report.added[0].rms == pytest.approx(rms_between(source.parent / "skin.png", image), rel=0.05)


def test_the_change_of_vertices_is_rounded_as_the_file_is(tmp_path):
    rows = [[x, y, 0, 100, 100, 100] for x in range(20) for y in range(20)]
    faces = [[a, a + 1, a + 21, a + 20] for a in range(379) if a % 20 < 19]
    (tmp_path / "in.ply").write_bytes(ply(COLOURED, rows, faces))
    (added,) = noise_file(tmp_path / "in.ply", tmp_path / "out.ply", NoiseSettings(sigma=0.3 / 255)).added
    stored = open_document(str(tmp_path / "out.ply")).coloured_vertices().colours
    assert added.rms == pytest.approx(np.sqrt(np.mean(np.square(stored - 100 / 255))), rel=1e-3)


@pytest.mark.parametrize("name", ["flat.ply", "flat.jpg"])
def test_noise_of_which_nothing_is_left_is_an_error(name, tmp_path):
    if name == "flat.ply":
        rows = [[0, 0, 0, 9, 9, 9], [1, 0, 0, 9, 9, 9], [0, 1, 0, 9, 9, 9]]
        data = ply(COLOURED, rows, [[0, 1, 2]])
    else:
        data = encode(phantom(), "jpeg", compression="jpeg:30", jpeg__subsampling="4:2:0")
    (tmp_path / name).write_bytes(data)
    words = ("noise", name, f"out{name[-4:]}", "--sigma", "0.05/255")
    refused(tmp_path, *words, code=1, said=f"{name}: nothing of the noise would be left")
