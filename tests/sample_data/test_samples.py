"""What SOURCES.md claims about the sample meshes is true, and the files are what the script makes."""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

FOLDER = Path(__file__).parents[2] / "sample_data"
NAMES = ("knot", "head", "terrain", "nonmanifold")


@pytest.fixture(scope="module")
def samples(make):
    return dict(make.samples())


def edges(triangles):
    """Return how many triangles hold each edge."""
    pairs = np.sort(
        np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1
    )
    return np.unique(pairs, axis=0, return_counts=True)


def border_loops(triangles):
    """Return the number of closed curves that the edges with one triangle form."""
    pairs, count = edges(triangles)
    beside = {}
    for a, b in pairs[count == 1].tolist():
        beside.setdefault(a, []).append(b)
        beside.setdefault(b, []).append(a)
    loops, seen = 0, set()
    for start in beside:
        if start in seen:
            continue
        loops, todo = loops + 1, [start]
        while todo:
            here = todo.pop()
            seen.add(here)
            todo += [other for other in beside[here] if other not in seen]
    return loops


# 4 s: all samples are made.
@pytest.mark.slow
def test_the_files_are_what_the_script_makes(make, capsys):
    assert make.main(["--check"]) == 0, capsys.readouterr().err


@pytest.mark.slow
def test_check_reports_a_changed_and_a_missing_file_and_writes_nothing(make, capsys, monkeypatch, tmp_path):
    monkeypatch.setattr(make, "TEXTURED", {})
    for name, data in make.files():
        (tmp_path / name).write_bytes(data)
    changed, missing = tmp_path / "knot-noisy.ply", tmp_path / "head-clean.obj"
    changed.write_bytes(changed.read_bytes()[:-1] + b"!")
    before = changed.read_bytes()
    missing.unlink()
    monkeypatch.setattr(make, "FOLDER", tmp_path)
    assert make.main(["--check"]) == 1
    assert capsys.readouterr().err.splitlines() == ["knot-noisy.ply: differs", "head-clean.obj: is missing"]
    assert changed.read_bytes() == before
    assert not missing.exists()


def test_all_files_together_are_small():
    assert sum(p.stat().st_size for p in FOLDER.iterdir() if p.suffix not in {".py", ".md"}) < 10e6


@pytest.mark.parametrize("name", NAMES)
def test_noise_is_gaussian_of_20_levels_away_from_clipping(samples, name):
    clean, noisy = (samples[f"{name}-{kind}"].colours.astype(float) for kind in ("clean", "noisy"))
    # Five standard deviations from either end nothing is clipped.
    inside = (clean > 100) & (clean < 155)
    noise = (noisy - clean)[inside]
    # Rounding to 8 bit adds 1/12 to the variance; bounds are four standard errors.
    sigma = np.hypot(20, 12**-0.5)
    assert abs(noise.mean()) < 4 * sigma / len(noise) ** 0.5
    assert abs(noise.std() / sigma - 1) < 4 / (2 * len(noise)) ** 0.5
    assert abs((np.abs(noise) < sigma).mean() - 0.6827) < 0.02 + 4 * 0.47 / len(noise) ** 0.5


@pytest.mark.parametrize("name", NAMES)
def test_coincident_vertices_of_one_colour_stay_of_one_colour(samples, name):
    clean, noisy = samples[f"{name}-clean"], samples[f"{name}-noisy"]
    points = np.unique(np.hstack([clean.positions, clean.colours]), axis=0)
    assert len(np.unique(np.hstack([clean.positions, clean.colours, noisy.colours]), axis=0)) == len(points)
    assert clean.polygons == noisy.polygons
    assert np.array_equal(clean.positions, noisy.positions)


@pytest.mark.parametrize(("name", "euler"), [("knot", 0), ("head", 2)])
def test_closed_samples_are_closed_oriented_outwards_and_of_the_stated_genus(samples, name, euler):
    sample = samples[f"{name}-clean"]
    triangles = sample.triangles()
    pairs, count = edges(triangles)
    assert (count == 2).all()
    assert len(sample.positions) - len(pairs) + len(triangles) == euler
    directed = Counter((t[i], t[i - 2]) for t in triangles.tolist() for i in range(3))
    assert max(directed.values()) == 1
    a, b, c = (sample.positions[triangles[:, k]] for k in range(3))
    assert (np.cross(a, b) * c).sum() > 0


def test_the_terrain_is_open_with_one_hole_of_quads_and_triangles(samples):
    sample = samples["terrain-clean"]
    _, count = edges(sample.triangles())
    assert set(count.tolist()) == {1, 2}
    assert border_loops(sample.triangles()) == 2
    assert {len(p) for p in sample.polygons} == {3, 4}
    assert len(np.unique(sample.triangles())) == len(sample.positions)


def test_three_sheets_meet_along_the_spine_and_nowhere_else(samples, make):
    sheets = sys.modules["nonmanifold"]
    sample = samples["nonmanifold-clean"]
    triangles = sample.triangles()
    kept = np.unique(np.sort(triangles, axis=1), axis=0)
    assert len(triangles) - len(kept) == 1  # the duplicate face
    pairs, count = edges(kept)
    crowded = pairs[count == 3]
    assert count.max() == 3
    assert (crowded.max(axis=1) < sheets.HEIGHT).all()
    assert len(crowded) == sheets.HEIGHT - 1
    corners = sample.positions[kept]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    assert (area < 1e-5).sum() == 1  # the face without area, up to the rounding of positions
    assert len(sample.positions) - len(np.unique(triangles)) == 1  # the lone vertex


def test_the_hard_edge_and_the_seam_are_coincident_vertices(samples):
    sheets = sys.modules["nonmanifold"]
    sample = samples["nonmanifold-clean"]
    _, place_of, copies = np.unique(sample.positions, axis=0, return_inverse=True, return_counts=True)
    doubled = np.flatnonzero(copies[place_of.reshape(-1)] == 2)
    points = np.unique(np.hstack([sample.positions, sample.colours])[doubled], axis=0)
    assert len(doubled) == 2 * (sheets.HEIGHT + sheets.ACROSS)
    assert len(points) == 2 * sheets.HEIGHT + sheets.ACROSS
