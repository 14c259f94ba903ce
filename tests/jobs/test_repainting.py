"""Smoothed texels go back to the pictures that they are of."""

from __future__ import annotations

from pathlib import Path

from beltrami_cli.jobs.smooth.file import smooth_file
from beltrami_cli.samples.textures import smooth

SAMPLES = Path(__file__).parents[2] / "sample_data"


def test_each_texel_is_taken_from_the_canvas_once_however_many_pictures_there_are(tmp_path, monkeypatch):
    taken = []
    take = smooth.colours_at

    def counted(planes, cells, threads):
        taken.append(len(cells))
        return take(planes, cells, threads)

    monkeypatch.setattr(smooth, "colours_at", counted)
    report = smooth_file(SAMPLES / "torus-two-noisy.gltf", tmp_path / "clean.gltf")
    (slot,) = report.textures
    assert len(slot.textures) == 2
    assert sum(taken) == slot.counts["covered"]
