"""Textures for which there is too little memory are smoothed in files, with the same result to the last byte."""

from __future__ import annotations

import dataclasses
import errno
import os
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from beltrami_cli.errors import InputError, ProcessingError, UsageError
from beltrami_cli.flow import patches
from beltrami_cli.flow.beltrami_flow import smooth
from beltrami_cli.flow.noise.model import NoiseModel
from beltrami_cli.flow.parameters import KernelParameters, parameters_with
from beltrami_cli.flow.tuning.grid_trial import perturbations
from beltrami_cli.formats.access import Access
from beltrami_cli.formats.image import read_image
from beltrami_cli.formats.model_folder import tile_name
from beltrami_cli.formats.registry import open_document
from beltrami_cli.jobs.inspect import check_files
from beltrami_cli.jobs.job import Job
from beltrami_cli.jobs.smooth import smooth_file
from beltrami_cli.layers import memory_check
from beltrami_cli.layers.image_surface import ImageSurface, plan_on_image
from beltrami_cli.layers.settings import SmoothSettings, TextureSettings
from beltrami_cli.layers.texture_layer import TextureLayer
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import build_atlas, grid_atlas
from beltrami_cli.surface.records import Texture, TexturedSurface
from formats.image_files import encode
from formats.tile_files import GIVEN, tiled_model
from oracles.paintings import photograph, with_noise

SAMPLES = Path(__file__).parents[2] / "sample_data"


def smoothed(model, folder, memory, **options):
    """Smooth a model into a folder; return the content of all files there, by their names."""
    folder.mkdir()
    smooth_file(model, folder / model.name, job=Job(access=Access(memory=memory)), **options)
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture
def on_disk(monkeypatch):
    """All arrays for which there is no room, however small, are in files; returns the bytes that these take."""
    monkeypatch.setattr(large_arrays, "SMALLEST_FILE", 1)
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
    in_memory = smoothed(source, tmp_path / "memory", None)
    assert not on_disk
    monkeypatch.setattr(large_arrays, "BLOCK", 1000)
    monkeypatch.setattr(memory_check, "TEXEL_BYTES", 1e6)  # bytes a texel
    files = smoothed(source, tmp_path / "disk", 1 << 30)
    assert sum(on_disk) > 1 << 19  # at least the colours of 160 x 160 texels, old and new
    assert files == in_memory


def test_even_less_memory_is_refused_by_name(tmp_path, on_disk):
    with pytest.raises(InputError, match=r"do not fit into memory; scale it down, or raise --max-memory"):
        smoothed(SAMPLES / "head-tex-noisy.obj", tmp_path / "out", 1 << 20)
    assert not list((tmp_path / "out").iterdir())


SIDE = 4  # tiles


def tiles_of(model, folder, memory, settings):
    """Smooth tiles; return their pixels in order, the names of the groups in progress, and the report."""
    folder.mkdir()
    labels = {}

    def progress(label, *_):
        if "group" in label:
            labels.setdefault(label.partition(":")[0])

    job = Job(access=Access(memory=memory), progress=progress)
    report = smooth_file(model, folder / "new.obj", settings, job)
    files = sorted(folder.glob("*.png"))
    assert [path.name for path in files] == [
        f"new_skin.{1001 + u + 10 * v}.png" for v in range(SIDE) for u in range(SIDE)
    ]
    pixels = [read_image(path.read_bytes(), path.name).pixels.astype(int) for path in files]
    return pixels, list(labels), report.textures[0]


@pytest.mark.slow
def test_many_tiles_are_smoothed_in_groups_with_the_same_result(tmp_path, monkeypatch, on_disk):
    model = tiled_model(tmp_path / "in", size=SIDE)
    whole, _, expected = tiles_of(model, tmp_path / "whole", None, GIVEN)
    monkeypatch.setattr(large_arrays, "SMALLEST_FILE", 1 << 14)
    memory = 300_000  # bytes; all tiles take 302,000 with their arrays in files
    groups, labels, done = tiles_of(model, tmp_path / "groups", memory, GIVEN)
    assert labels[0] == f"baseColor textures, group 1 of {len(labels)}"
    assert len(labels) > 3
    assert max(on_disk) < 500_000  # of the whole, squared lengths alone take 920,000
    difference = np.abs(np.array(groups) - np.array(whole))
    assert difference.max() <= 1  # where charts meet in a corner, the order of those beyond may differ
    assert np.count_nonzero(difference) <= 10
    assert check_files(model, tmp_path / "groups" / "new.obj").faithful
    assert [image["name"] for image in done.textures] == [image["name"] for image in expected.textures]
    assert done.change == pytest.approx(expected.change)
    for count in ("charts", "covered"):
        assert done.counts[count] == expected.counts[count]


@pytest.mark.slow
def test_parameters_are_chosen_once_for_all_groups(tmp_path, monkeypatch):
    model = tiled_model(tmp_path / "in", size=SIDE)
    monkeypatch.setattr(large_arrays, "SMALLEST_FILE", 1 << 14)
    settings = SmoothSettings(parameters_with({}, fast=True))
    whole, _, expected = tiles_of(model, tmp_path / "whole", None, settings)
    groups, labels, done = tiles_of(model, tmp_path / "groups", 300_000, settings)
    assert len(labels) > 3
    assert done.iterations == expected.iterations
    assert done.beta == pytest.approx(expected.beta, rel=0.1)
    assert np.abs(np.array(groups) - np.array(whole)).mean() < 0.5  # of 255


@pytest.mark.slow
def test_noise_of_each_level_is_known_to_all_groups(tmp_path, monkeypatch):
    """Noise that grows with the level is made even, as on the whole, although no group alone shows all levels."""
    side = 96
    model, random = tiled_model(tmp_path / "in", size=SIDE), np.random.default_rng(4)
    level = np.linspace(0.1, 0.9, SIDE * side)
    for v in range(SIDE):
        for u in range(SIDE):
            clean = np.broadcast_to(level[u * side :][:side, None], (side, side, 3))
            noisy = clean + (0.01 + 0.08 * clean) * random.normal(size=clean.shape)
            file = model.with_name(tile_name("skin.<UDIM>.png", (u, v)))
            file.write_bytes(encode(np.rint(noisy.clip(0, 1) * 255).astype(np.uint8), "png"))
    made, take = [], TextureLayer.manifold
    monkeypatch.setattr(
        TextureLayer, "manifold", lambda *of, **more: made.append(take(*of, **more)) or made[-1]
    )
    monkeypatch.setattr(large_arrays, "SMALLEST_FILE", 1 << 16)
    memory = 1_100_000  # bytes; all tiles take 1,207,000 with their arrays in files
    settings = SmoothSettings(parameters_with({}, fast=True))
    _, labels, _ = tiles_of(model, tmp_path / "groups", memory, settings)
    assert len(made) == len(labels) + 1  # also of the textures on which parameters were chosen
    assert len(labels) > 4
    first, *others = made
    assert first.noise.stabiliser is not None
    for other in others:
        assert other.noise.stabiliser is first.noise.stabiliser
        assert np.array_equal(other.noise.sigma, first.noise.sigma)


@pytest.mark.slow
@pytest.mark.parametrize("noise", ["12", "shot:0.002,read:0.03"])
def test_groups_take_the_noise_that_is_given(tmp_path, monkeypatch, noise):
    model = tiled_model(tmp_path / "in", size=SIDE)
    settings = dataclasses.replace(GIVEN, kernel=dataclasses.replace(GIVEN.kernel, noise=noise))
    whole, _, expected = tiles_of(model, tmp_path / "whole", None, settings)
    monkeypatch.setattr(large_arrays, "SMALLEST_FILE", 1 << 14)
    groups, labels, done = tiles_of(model, tmp_path / "groups", 300_000, settings)
    assert len(labels) > 3
    # The strength is the same; how channels share it is read on some of the tiles.
    strengths = [np.sqrt(np.mean(np.square(list(own.noise.values())))) for own in (done, expected)]
    assert strengths[0] == pytest.approx(strengths[1])
    assert np.abs(np.subtract(groups, whole, dtype=float)).mean() < 1


def test_a_map_of_noise_is_for_one_tile_whose_result_memory_does_not_change(tmp_path):
    """There are no groups with it: all tiles are refused, and the one that is chosen fits by itself."""
    model, noise = tiled_model(tmp_path / "in", size=SIDE), tmp_path / "noise.png"
    deviations = np.linspace(5, 25, 48 * 48).reshape(48, 48, 1)
    noise.write_bytes(encode(deviations.astype(np.uint8), "png"))
    settings = dataclasses.replace(GIVEN, kernel=dataclasses.replace(GIVEN.kernel, noise=str(noise)))
    with pytest.raises(UsageError, match=r"is the noise of one of 16 textures; choose it by --texture"):
        tiles_of(model, tmp_path / "all", None, settings)
    with pytest.raises(InputError, match="do not fit into memory"):
        tiles_of(model, tmp_path / "little", 300_000, settings)
    one = dataclasses.replace(settings, textures=TextureSettings(names=("skin.1023.png",)))
    results = []
    for memory in (None, 300_000):
        folder = tmp_path / f"one{memory}"
        folder.mkdir()
        smooth_file(model, folder / "new.obj", one, Job(access=Access(memory=memory)))
        results.append({path.name: path.read_bytes() for path in folder.iterdir()})
    assert results[0] == results[1]
    assert results[0]["new_skin.1023.png"] != (tmp_path / "in" / "skin.1023.png").read_bytes()


@pytest.mark.slow
def test_images_inside_a_file_count_as_memory(tmp_path, on_disk):
    """Those of a GLB stay in memory, as they are and as they are written; so there is a group more for a byte less."""
    smooth_file(tiled_model(tmp_path / "in", size=SIDE), tmp_path / "model.glb", GIVEN, iterations=0)
    document = open_document(str(tmp_path / "model.glb"))
    files = [texture.data for texture in document.textured("baseColor").textures]
    texels = 48 * 48
    needed = 8 * len(files) * texels + 3 * texels + len(document.data) + 2 * sum(map(len, files))
    for memory, parts in ((needed, 1), (needed - 1, 2)):
        labels = {}
        job = Job(
            access=Access(memory=memory), progress=lambda label, *_, seen=labels: seen.setdefault(label)
        )
        smooth_file(tmp_path / "model.glb", tmp_path / f"new{memory}.glb", GIVEN, job)
        assert len(labels) >= parts
        assert ("group" in "".join(labels)) == (parts > 1)


def test_a_tile_that_does_not_fit_with_those_around_it_is_refused(tmp_path, monkeypatch):
    model = tiled_model(tmp_path / "in", size=3)
    monkeypatch.setattr(memory_check, "TEXEL_BYTES_ON_DISK", 20)
    with pytest.raises(InputError, match=r"^skin.1001.png: its 48 x 48 pixels .* raise --max-memory$"):
        tiles_of(model, tmp_path / "out", 30_000, GIVEN)
    assert not list((tmp_path / "out").iterdir())


def test_a_full_disk_is_reported_and_leaves_nothing(tmp_path, monkeypatch, on_disk):
    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "posix_fallocate", full)
    monkeypatch.setattr(memory_check, "TEXEL_BYTES", 1e6)
    with pytest.raises(
        ProcessingError, match=r"no room for \d+ MB of working space \(No space left on device\)"
    ):
        smoothed(SAMPLES / "head-tex-noisy.obj", tmp_path / "out", 1 << 30)
    assert not list((tmp_path / "out").iterdir())


@pytest.mark.skipif(
    not Path("/proc/self/status").exists(), reason="only Linux says how much of files is in memory"
)
def test_an_atlas_leaves_memory_as_it_is_made(tmp_path, monkeypatch):
    """What it holds of its files at a time does not grow with the textures, of which most may only lie around."""
    count, side = 8, 2048
    triangle = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], float)
    positions = np.concatenate([triangle + np.array([2 * number, 0, 0]) for number in range(count)])
    faces = np.arange(3 * count, dtype=np.int32).reshape(-1, 3)
    uv = np.tile(triangle[:, :2] / 100, (count, 1, 1))
    textures = tuple(Texture(str(number), "x.png", b"") for number in range(count))
    surface = TexturedSurface(positions, faces, uv, np.arange(count, dtype=np.int32), textures)
    held, leave = [], large_arrays.leave_memory

    def measured():
        status = Path("/proc/self/status").read_text().split("RssFile:")[1]
        held.append(int(status.split()[0]) << 10)
        leave()

    monkeypatch.setattr(large_arrays, "leave_memory", measured)
    with large_arrays.kept_on_disk(tmp_path):
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
    return plan_on_image(surface, colours.__getitem__, kernel)


def planned_image():
    return plan_with_patches(64)


def planned_textures():
    settings = SmoothSettings(kernel=KernelParameters(iterations=1, beta=20, t=2.4, patches="on", threads=1))
    surface = open_document(str(SAMPLES / "mirrored-noisy.obj")).textured("baseColor")
    return TextureLayer.read(surface, "baseColor", settings).plan()


@pytest.mark.parametrize("planned", [planned_image, planned_textures])
def test_distances_are_no_longer_in_memory_with_patches_but_can_be_measured_again(planned):
    plan = planned()
    assert plan.takes_patches
    geometry = plan.manifold.geometry
    before = geometry.atlas.squared_lengths.copy(), geometry.scale.copy()
    smooth(plan)
    assert geometry.atlas.lengths.array is None
    assert geometry.scales.array is None
    for old, new in zip(before, (geometry.atlas.squared_lengths, geometry.scale), strict=True):
        np.testing.assert_array_equal(old, new)


def test_estimates_may_take_the_memory_of_their_pilot():
    manifold = plan_with_patches(160).manifold
    mixing = patches.mixing_of(manifold, manifold.colours, manifold.noise.covariance)
    second, pilot = patches.with_pilot(mixing, manifold), manifold.colours.copy()
    found = manifold.collaborate(manifold.colours, pilot, second, None)
    np.testing.assert_array_equal(pilot, manifold.colours)
    again = manifold.collaborate(manifold.colours, pilot, second, None, replaces_pilot=True)
    np.testing.assert_array_equal(again, found)
    assert np.shares_memory(again, pilot)


@pytest.mark.slow
def test_patches_keep_what_is_large_for_the_memory_in_files(tmp_path):
    """Besides fixed blocks of samples: the colours alone, in all their versions, are 44 MB in memory."""
    memory = 8 << 20
    with large_arrays.kept_on_disk(tmp_path, memory):
        plan = plan_with_patches(512)
        tracemalloc.start()
        try:
            smooth(plan)
            _, peak = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
    # Some twenty arrays of three floats a sample, for 65,536 samples.
    assert peak < memory + 20 * 12 * 65_536


@pytest.mark.slow
def test_means_of_squares_are_kept_in_files(tmp_path, monkeypatch):
    """For squares of 4 x 4 cells, colours take 0.2 MB, of which there are ten versions."""
    monkeypatch.setattr(large_arrays, "CACHED", 1 << 12)
    monkeypatch.setattr(large_arrays, "BLOCK", 1 << 14)
    improve, grown = patches._improve_means, []

    def measured(*arguments):
        tracemalloc.reset_peak()
        before, _ = tracemalloc.get_traced_memory()
        gain = improve(*arguments)
        grown.append(tracemalloc.get_traced_memory()[1] - before)
        return gain

    monkeypatch.setattr(patches, "_improve_means", measured)
    with large_arrays.kept_on_disk(tmp_path, 1 << 20):
        plan = plan_with_patches(512)
        tracemalloc.start()
        try:
            smooth(plan)
        finally:
            tracemalloc.stop()
    assert len(grown) == 2
    assert max(grown) < 1 << 20


@pytest.mark.parametrize("scales", [1, 3], ids=["white", "shared"])
def test_random_planes_are_in_files_and_the_same(tmp_path, scales):
    shape = (610, 607)
    atlas = grid_atlas(shape, 1, None, np.ones(shape, bool))
    noise = NoiseModel(np.tile(0.01 * np.eye(3), (scales, 1, 1)))
    expected = perturbations(1, atlas, noise)[0]
    with large_arrays.kept_on_disk(tmp_path, 1 << 20):
        tracemalloc.start()
        try:
            planes = perturbations(1, atlas, noise)[0]
            _, peak = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
    assert np.array_equal(planes, expected)
    assert peak < 3 << 20  # as floats they are 4.4 MB, and twice that while they are made


def test_arrays_in_files_are_like_others(tmp_path, on_disk):
    with large_arrays.kept_on_disk(tmp_path):
        array = large_arrays.zeros((5, 7), np.int16)
        assert array.shape == (5, 7)
        assert not array.any()
        for block in large_arrays.blocks(5, 2):
            array[block] = block.start
        copy = large_arrays.copy_of(array)
    large_arrays.leave_memory()
    assert array[:, 3].tolist() == [0, 0, 2, 2, 4]
    assert np.array_equal(copy, array)
    assert on_disk == [array.nbytes, copy.nbytes]
    assert not list(tmp_path.iterdir())
