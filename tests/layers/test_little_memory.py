"""Textures for which there is too little memory are smoothed in files, with the same result to the last byte."""

import dataclasses
import errno
import os
import tracemalloc
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from beltrami_cli.errors import InputError, OutputError, UsageError
from beltrami_cli.flow.beltrami_flow import smooth_in_place
from beltrami_cli.flow.decoding import plan_on_canvas
from beltrami_cli.flow.noise.grid_squares import GridSquares
from beltrami_cli.flow.noise.reading import read_noise
from beltrami_cli.flow.parameters import KernelParameters, parameters_from
from beltrami_cli.formats.files.access import Access
from beltrami_cli.jobs.job import Job
from beltrami_cli.jobs.smooth import smooth_file
from beltrami_cli.layers.image_surface import ImageSurface, canvas_of_image
from beltrami_cli.layers.settings import DEFAULTS, SmoothSettings, TextureSettings
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import OWNED, build_atlas
from beltrami_cli.surface.records import Texture, TexturedSurface
from formats.image_files import encode
from formats.tile_files import GIVEN, tiled_model
from oracles.pictures import photograph, with_noise

SAMPLES = Path(__file__).parents[2] / "sample_data"


def smoothed(model, folder, memory, settings=DEFAULTS):
    """Smooth a model into a folder; return the content of all files there, by their names, and the report."""
    folder.mkdir()
    report = smooth_file(model, folder / model.name, settings, Job(access=Access(memory=memory)))
    return {path.name: path.read_bytes() for path in folder.iterdir()}, report.textures


@pytest.fixture
def on_disk(monkeypatch):
    """All arrays, however small, are in files where memory is limited; returns the bytes that these take."""
    monkeypatch.setattr(large_arrays, "MIN_COUNTED_BYTES", 1)
    monkeypatch.setattr(large_arrays, "_SHARE", 0)
    sizes = []
    take = os.posix_fallocate

    def measured(descriptor, offset, size):
        sizes.append(size)
        take(descriptor, offset, size)

    monkeypatch.setattr(os, "posix_fallocate", measured)
    return sizes


@pytest.fixture(scope="module")
def photograph_as_jpeg(tmp_path_factory):
    path = tmp_path_factory.mktemp("photograph") / "photograph.jpg"
    noisy = with_noise(photograph(160), 12 / 255)
    path.write_bytes(encode(np.rint(255 * noisy).astype(np.uint8), "jpeg", compression="jpeg:85"))
    return path


# Several images with seams, mirrored charts, floats, and JPEG with guides for noise: each with chosen parameters.
@pytest.mark.slow
@pytest.mark.parametrize(
    "model", ["torus-two-noisy.gltf", "mirrored-noisy.obj", "sphere-exr-noisy.exr", "photograph.jpg"]
)
def test_the_result_is_the_same(model, photograph_as_jpeg, tmp_path, monkeypatch, on_disk):
    source = photograph_as_jpeg if model == photograph_as_jpeg.name else SAMPLES / model
    in_memory, _ = smoothed(source, tmp_path / "memory", None)
    assert not on_disk
    monkeypatch.setattr(large_arrays, "BLOCK", 1000)
    files, _ = smoothed(source, tmp_path / "disk", 1 << 30)
    assert sum(on_disk) > 1 << 19  # at least the colours of 160 x 160 texels, old and new
    assert files == in_memory


def test_reading_noise_takes_no_memory_for_each_texel():
    def peak(side):
        planes, grid = np.zeros((3, side, side), np.float32), GridSquares.of(np.ones((side, side), bool))
        tracemalloc.start()
        try:
            read_noise(planes, grid)
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    assert peak(4096) - peak(2048) < (4096**2 - 2048**2) / 4


def test_even_less_memory_is_refused_by_name(tmp_path, on_disk):
    with pytest.raises(InputError, match=r"do not fit into memory; scale it down, or raise --max-memory"):
        smoothed(SAMPLES / "head-tex-noisy.obj", tmp_path / "out", 1 << 20)
    assert not list((tmp_path / "out").iterdir())


SIDE = 4  # tiles


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kernel", "noise"),
    [
        (GIVEN.kernel, "12"),
        (parameters_from({}, fast=True), None),
        (parameters_from({}, fast=True), "shot:0.002,read:0.03"),
    ],
)
def test_many_tiles_have_the_same_result(tmp_path, monkeypatch, on_disk, kernel, noise):
    model = tiled_model(tmp_path / "in", size=SIDE)
    settings = SmoothSettings(dataclasses.replace(kernel, noise=noise))
    whole = smoothed(model, tmp_path / "whole", None, settings)
    assert len([name for name in whole[0] if "skin.10" in name]) == SIDE * SIDE
    assert not on_disk
    memory = 120_000  # bytes, for 37,000 texels
    assert smoothed(model, tmp_path / "little", memory, settings) == whole
    assert sum(on_disk) > memory


def test_a_map_of_noise_is_for_one_tile_whose_result_memory_does_not_change(tmp_path, monkeypatch):
    model, noise = tiled_model(tmp_path / "in", size=SIDE), tmp_path / "noise.png"
    deviations = np.linspace(5, 25, 48 * 48).reshape(48, 48, 1)
    noise.write_bytes(encode(deviations.astype(np.uint8), "png"))
    settings = dataclasses.replace(GIVEN, kernel=dataclasses.replace(GIVEN.kernel, noise=str(noise)))
    with pytest.raises(UsageError, match=r"is the noise of one of 16 textures; choose it by --texture"):
        smoothed(model, tmp_path / "all", None, settings)
    monkeypatch.setattr(large_arrays, "MIN_COUNTED_BYTES", 1)
    one = dataclasses.replace(settings, textures=TextureSettings(names=("skin.1023.png",)))
    files, report = smoothed(model, tmp_path / "one", None, one)
    assert smoothed(model, tmp_path / "little", 50_000, one) == (files, report)
    assert files["model_skin.1023.png"] != (tmp_path / "in" / "skin.1023.png").read_bytes()


def test_tiles_that_do_not_fit_are_refused_by_name(tmp_path):
    model = tiled_model(tmp_path / "in", size=3)
    with pytest.raises(InputError, match=r"^skin.10\d\d.png: its 48 x 48 pixels .* raise --max-memory$"):
        smoothed(model, tmp_path / "out", 30_000, GIVEN)
    assert not list((tmp_path / "out").iterdir())


def test_a_full_disk_is_reported_and_leaves_nothing(tmp_path, monkeypatch, on_disk):
    full = Mock(side_effect=OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))
    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(OutputError, match=r"no room for \d+ MB of working space \(No space left"):
        smoothed(SAMPLES / "head-tex-noisy.obj", tmp_path / "out", 1 << 30)
    assert not list((tmp_path / "out").iterdir())


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="only Linux counts memory of files")
def test_an_atlas_leaves_memory_as_it_is_made(tmp_path, monkeypatch):
    """What it holds of its files at a time does not grow with the textures, as most may only lie around."""
    count, side = 8, 2048
    triangle = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], float)
    positions = np.concatenate([triangle + np.array([2 * number, 0, 0]) for number in range(count)])
    faces = np.arange(3 * count, dtype=np.int32).reshape(-1, 3)
    uv = np.tile(triangle[:, :2] / 100, (count, 1, 1))
    textures = tuple(Texture(str(number), "x.png", b"") for number in range(count))
    surface = TexturedSurface(positions, faces, uv, np.arange(count, dtype=np.int32), textures)
    held, leave = [], large_arrays.release_pages

    def measured():
        status = Path("/proc/self/status").read_text().split("RssFile:")[1]
        held.append(int(status.split()[0]) << 10)
        leave()

    monkeypatch.setattr(large_arrays, "release_pages", measured)
    with large_arrays.arrays_in_files(0, tmp_path):
        measured()
        build_atlas(surface, [(side, side)] * count, 3)
    # Two numbers of 4 bytes a texel would be 268 MB; every 4 million texels they leave.
    assert max(held) - held[0] < 64 << 20


def plan_with_patches(side):
    """Plan the smoothing of a noisy grey image."""
    random = np.random.default_rng(5)
    colours = (0.5 + 0.1 * random.normal(size=(side * side, 3))).clip(0, 1).astype(np.float32)
    flat = np.dstack([*np.meshgrid(np.arange(side), np.arange(side)), np.zeros((side, side))])
    surface = ImageSurface(None, flat, np.ones((side, side), bool))
    kernel = KernelParameters(iterations=2, beta=20, t=2.4, patches="on", threads=1)
    return plan_on_canvas(canvas_of_image(surface, colours.__getitem__, kernel))


def test_what_is_dropped_from_memory_before_kernels_and_patches_is_found_again():
    plan = plan_with_patches(64)
    geometry, atlas = plan.manifold.geometry, plan.manifold.geometry.atlas
    before = atlas.squared_lengths.copy(), geometry.scale.copy(), np.flatnonzero(atlas.kind == OWNED)
    smooth_in_place(plan)
    assert atlas.lengths.array is geometry.scales.array is atlas.owned.array is None
    for old, new in zip(before, (atlas.squared_lengths, geometry.scale, atlas.owned_cells), strict=True):
        np.testing.assert_array_equal(old, new)


@pytest.mark.slow
def test_patches_keep_what_is_large_for_the_memory_in_files(tmp_path):
    """Besides fixed blocks of samples: the colours alone, in all their versions, are 44 MB in memory."""
    memory = 8 << 20
    with large_arrays.arrays_in_files(memory, tmp_path):
        plan = plan_with_patches(512)
        tracemalloc.start()
        try:
            smooth_in_place(plan)
            _, peak = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
    # Some twenty arrays of three floats a sample, for 65,536 samples.
    assert peak < memory + 20 * 12 * 65_536


def test_arrays_in_files_are_like_others(tmp_path, on_disk):
    with large_arrays.arrays_in_files(1 << 20, tmp_path):
        array = large_arrays.zeros((5, 7), np.int16)
        assert array.shape == (5, 7)
        assert not array.any()
        for block in large_arrays.blocks(5, 2):
            array[block] = block.start
        copy = large_arrays.copy_of(array)
    large_arrays.release_pages()
    assert array[:, 3].tolist() == [0, 0, 2, 2, 4]
    assert np.array_equal(copy, array)
    assert on_disk == [array.nbytes, copy.nbytes]
    assert not list(tmp_path.iterdir())


def test_arrays_are_in_memory_up_to_a_share_of_it(tmp_path):
    size = large_arrays.MIN_COUNTED_BYTES
    with large_arrays.arrays_in_files(4 * size, tmp_path):  # for three of them
        kept = [large_arrays.empty(size, np.uint8), large_arrays.kept(np.ones(size, np.uint8))]
        freed = large_arrays.zeros(size, np.uint8)
        assert not large_arrays.any_in_files()
        one = large_arrays.kept(np.ones(size, np.uint8))
        assert large_arrays.any_in_files()
        assert one.all()
        small = large_arrays.zeros(size - 1, np.uint8)
        del one, freed
        assert not large_arrays.any_in_files()
        kept.append(large_arrays.empty(size, np.uint8))
        assert not large_arrays.any_in_files()
        assert large_arrays.kept_bytes(b"x" * size) == b"x" * size
    del small
