"""`beltrami smooth`, `info`, `kernel` and `check` on points without faces, in every format that has them."""

import json

import numpy as np
import pytest

from beltrami_cli.formats.ply.document import PlyDocument
from beltrami_cli.formats.registry import open_document
from beltrami_cli.surface.colour_values import linear_to_srgb
from cli.commands import beltrami
from small_models import COLOURED, ply

SIDE = 30
STRAY = 3


def scan():
    """A wavy sheet with noise in its colours, and a few points far from it."""
    rng = np.random.default_rng(0)
    flat = np.stack(np.meshgrid(np.arange(SIDE), np.arange(SIDE)), axis=-1).reshape(-1, 2).astype(float)
    flat += rng.uniform(-0.3, 0.3, flat.shape)
    sheet = np.column_stack([flat, np.sin(flat[:, 0] / 6)])
    clean = np.where(flat[:, :1] < SIDE / 2, [200, 80, 60], [70, 120, 180])
    colours = np.clip(np.rint(clean + 12 * rng.standard_normal(clean.shape)), 0, 255).astype(np.uint8)
    stray = np.array([[0, 0, 300], [400, 0, 0], [0, -500, 20]], float)
    return np.concatenate([sheet, stray]), np.concatenate([colours, colours[:STRAY]]), clean


def as_text(path, positions, colours):
    rows = zip(positions.tolist(), colours.tolist(), strict=True)
    path.write_text("".join(" ".join(map(repr, [*place, *shade])) + "\n" for place, shade in rows))
    return path


@pytest.fixture(scope="module")
def clouds(tmp_path_factory):
    """The same points in files of every format."""
    folder = tmp_path_factory.mktemp("clouds")
    positions, colours, _ = scan()
    as_text(folder / "scan.xyz", positions, colours)
    np.savez(folder / "scan.npz", positions=positions, colours=colours, label=np.arange(len(colours)))
    for extension in ("ply", "pts", "obj", "glb"):
        beltrami("smooth", folder / "scan.xyz", folder / f"scan.{extension}", "-n", "0")
    return folder


@pytest.mark.parametrize("extension", ["ply", "xyz", "pts", "npz", "obj", "glb"])
def test_points_of_every_format_become_the_same_and_outliers_are_counted(clouds, tmp_path, extension):
    source, target = clouds / f"scan.{extension}", tmp_path / f"clean.{extension}"
    # Positions are rounded differently, which may tip the balance between parameters that are chosen.
    given = ("-n", "3", "-t", "2.4", "--beta", "10", "--beta-growth", "1.5", "--metric-steps", "1")
    run = beltrami("smooth", source, target, *given, "--report", tmp_path / "r.json", text=True)
    assert f"{STRAY} of {SIDE * SIDE + STRAY} points are left as they are: they are too far" in run.stderr
    counts = json.loads((tmp_path / "r.json").read_text())["vertices"]["counts"]
    assert counts["outliers"] == STRAY
    squares = (SIDE - 1) ** 2  # of two triangles; the rim of points that were moved has a few more or less
    assert 1.95 * squares < counts["triangles"] < 2.1 * squares
    beltrami("check", source, target)
    beltrami("smooth", clouds / "scan.xyz", tmp_path / "text.xyz", *given)
    vertices, expected = (
        open_document(str(path)).coloured_vertices() for path in (target, tmp_path / "text.xyz")
    )
    assert not len(vertices.faces)
    colours = linear_to_srgb(vertices.colours) if vertices.encoding == "linear" else vertices.colours
    assert np.abs(colours - expected.colours).max() <= 1.01 / 255  # which are rounded to 8 bits
    beltrami("smooth", source, tmp_path / f"same.{extension}", "-n", "0")
    assert (tmp_path / f"same.{extension}").read_bytes() == source.read_bytes()


@pytest.mark.slow
def test_info_describes_a_cloud(clouds):
    run = beltrami("info", clouds / "scan.ply", "--json")
    facts = json.loads(run.stdout)
    assert "surface" not in facts
    assert facts["cloud"]["points"] == SIDE * SIDE + STRAY
    assert facts["cloud"]["outliers"] == STRAY
    assert 0.8 < facts["cloud"]["mean_edge_length"] < 1.4
    assert 9 < 255 * facts["noise"]["red"] < 15
    assert b"outliers" in beltrami("info", clouds / "scan.pts", "-v").stdout


@pytest.mark.slow
def test_intensities_alone_are_smoothed(tmp_path):
    positions, colours, _ = scan()
    reflectance = (colours[:, :1].astype(float) - 100) * 16.5
    source = as_text(tmp_path / "scan.pts", positions, reflectance)
    run = beltrami("smooth", source, tmp_path / "clean.pts", "-v")
    assert b"x y z intensity" in run.stderr
    before, after = (np.loadtxt(tmp_path / name) for name in ("scan.pts", "clean.pts"))
    assert np.array_equal(before[:, :3], after[:, :3])
    left = slice(SIDE * SIDE // 4)
    assert after[left, 3].std() < before[left, 3].std()


def test_a_mesh_with_some_faces_stays_a_mesh(tmp_path):
    """Its points without faces are as isolated as before."""
    rows = [[i % 6, i // 6, 0, 20 * (i % 2), 100, 5 * i] for i in range(30)]
    source = tmp_path / "mesh.ply"
    source.write_bytes(ply(COLOURED, rows, [(0, 1, 6)]))
    beltrami("smooth", source, tmp_path / "out.ply", "--beta", "1", "-n", "3")
    before, after = (file.read_text().split("\n") for file in (source, tmp_path / "out.ply"))
    changed = [row - 12 for row, line in enumerate(before) if after[row] != line]
    assert changed == [0, 1, 6]


@pytest.mark.slow
@pytest.mark.parametrize("extension", ["ply", "xyz", "npz"])
def test_points_that_were_not_measured_stay_and_do_not_count(tmp_path, extension):
    positions, colours, _ = scan()
    gone = np.random.default_rng(1).random(len(positions)) < 0.1
    holed = np.where(gone[:, None], np.nan, positions)
    np.savez(tmp_path / "scan.npz", positions=holed, colours=colours)
    as_text(tmp_path / "scan.xyz", holed, colours)
    rows = [[*place, *shade] for place, shade in zip(holed.tolist(), colours.tolist(), strict=True)]
    properties = "double x y z, uchar red green blue"
    (tmp_path / "scan.ply").write_bytes(ply(properties, rows, encoding="binary_little_endian"))
    target = tmp_path / f"clean.{extension}"
    beltrami("smooth", tmp_path / f"scan.{extension}", target, "--beta", "8")
    as_text(tmp_path / "rest.xyz", positions[~gone], colours[~gone])
    beltrami("smooth", tmp_path / "rest.xyz", tmp_path / "done.xyz", "--beta", "8")
    expected = colours.copy()
    expected[~gone] = np.loadtxt(tmp_path / "done.xyz")[:, 3:]
    if extension == "ply":
        found = np.rint(255 * PlyDocument(target.read_bytes(), "x.ply").coloured_vertices().colours)
    else:
        found = np.load(target)["colours"] if extension == "npz" else np.loadtxt(target)[:, 3:]
    assert np.abs(found.astype(int) - expected).max() <= 1


def test_faces_are_dropped_with_a_word_when_a_mesh_becomes_points(tmp_path):
    positions, colours, _ = scan()
    faces = np.array([[0, 1, SIDE], [1, SIDE + 1, SIDE]])
    np.savez(tmp_path / "mesh.npz", xyz=positions, rgb=colours, faces=faces)
    run = beltrami("smooth", tmp_path / "mesh.npz", tmp_path / "points.pts", "-n", "0")
    assert b"Faces are dropped" in run.stderr
    assert (tmp_path / "points.pts").read_bytes().startswith(b"%d\n" % len(positions))
