"""Textures for which there is too little memory are smoothed in files, with the same result to the last byte."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import numpy as np
import pytest

from beltrami_cli.errors import InputError, ProcessingError
from beltrami_cli.formats.access import Access
from beltrami_cli.jobs.job import Job
from beltrami_cli.jobs.smooth import smooth_file
from beltrami_cli.samples import memory_check
from beltrami_cli.surface import large_arrays

SAMPLES = Path(__file__).parents[2] / "sample_data"


def smoothed(model, folder, memory, **options):
    """Smooth a sample into a folder; return the content of all files there, by their names."""
    folder.mkdir()
    smooth_file(SAMPLES / model, folder / model, job=Job(access=Access(memory=memory)), **options)
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


# Seams, several images, mirrored charts, floats, JPEG with guides for noise: each with chosen parameters.
@pytest.mark.slow
@pytest.mark.parametrize(
    "model", ["head-tex-noisy.obj", "torus-two-noisy.gltf", "mirrored-noisy.obj", "scan-noisy.glb"]
)
def test_the_result_is_the_same(model, tmp_path, monkeypatch, on_disk):
    in_memory = smoothed(model, tmp_path / "memory", None)
    assert not on_disk
    monkeypatch.setattr(large_arrays, "BLOCK", 1000)
    monkeypatch.setattr(memory_check, "TEXEL_BYTES", 1e6)  # bytes a texel
    files = smoothed(model, tmp_path / "disk", 1 << 30)
    assert sum(on_disk) > 1 << 20  # at least the colours of a texture of 256 x 256 texels, old and new
    assert files == in_memory


def test_even_less_memory_is_refused_by_name(tmp_path, on_disk):
    with pytest.raises(InputError, match=r"do not fit into memory; scale it down, or raise --max-memory"):
        smoothed("head-tex-noisy.obj", tmp_path / "out", 1 << 20)
    assert not list((tmp_path / "out").iterdir())


def test_a_full_disk_is_reported_and_leaves_nothing(tmp_path, monkeypatch, on_disk):
    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "posix_fallocate", full)
    monkeypatch.setattr(memory_check, "TEXEL_BYTES", 1e6)
    with pytest.raises(
        ProcessingError, match=r"no room for \d+ MB of working space \(No space left on device\)"
    ):
        smoothed("head-tex-noisy.obj", tmp_path / "out", 1 << 30)
    assert not list((tmp_path / "out").iterdir())


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
