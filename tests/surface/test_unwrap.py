"""New atlases: nothing overlaps, nothing is lost, and the process that makes them can always be ended."""

from pathlib import Path

import numpy as np
import pytest

from beltrami_cli.errors import InputError, ProcessingError
from beltrami_cli.surface import unwrap as unwrapping
from beltrami_cli.surface.unwrap import require_few_faces, unwrap
from oracles import surfaces
from processes import children


def unwrapped(positions, faces, size=256, padding=4, **options):
    return unwrap(np.asarray(positions, float), np.asarray(faces, np.int32), size, padding, "mesh", **options)


def owners(uv, size):
    """Which triangle holds each centre of a texel strictly inside, -1 for none, by trying all; and how many do."""
    width, height = size
    y, x = np.mgrid[:height, :width] + 0.5
    owner, hits = np.full((height, width), -1), np.zeros((height, width), int)
    for number, corners in enumerate(uv * size):
        low, high = np.floor(corners.min(axis=0)).astype(int), np.ceil(corners.max(axis=0)).astype(int) + 1
        window = slice(low[1], high[1]), slice(low[0], high[0])
        sides = []
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            sides.append((b[0] - a[0]) * (y[window] - a[1]) - (b[1] - a[1]) * (x[window] - a[0]))
        inside = (np.min(sides, axis=0) > 1e-7) | (np.max(sides, axis=0) < -1e-7)
        owner[window][inside] = number
        hits[window] += inside
    return owner, hits


def pinched_plane():
    """A plane with a fin on an edge in its middle, a copy of a triangle, and that triangle turned over."""
    positions, faces = surfaces.plane(6, 6)
    positions = np.concatenate([positions, [[2.5, 2.5, 3.0]]])
    return positions, np.concatenate([faces, [[14, 15, 36]], faces[:1], faces[:1, ::-1]])


MESHES = {
    "sphere": lambda: surfaces.icosphere(3),
    "terrain": lambda: surfaces.terrain(20, 20, 0.5, 1),
    "fin and copies": pinched_plane,
    "tiny": lambda: (1e-9 * surfaces.icosphere(2)[0], surfaces.icosphere(2)[1]),
    "huge and far": lambda: (1e30 * (surfaces.icosphere(2)[0] + 9), surfaces.icosphere(2)[1]),
    "as huge as numbers can be": lambda: (1e308 * surfaces.icosphere(2)[0], surfaces.icosphere(2)[1]),
    "one triangle": lambda: (np.eye(3), [[0, 1, 2]]),
}


@pytest.mark.slow
@pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)
def test_no_two_triangles_overlap_and_charts_keep_apart(mesh):
    positions, faces = mesh()
    made = unwrapped(positions, faces)
    assert max(made.size) == 256
    assert made.uv.min() > 0
    assert made.uv.max() < 1
    owner, hits = owners(made.uv, made.size)
    assert hits.max() == 1
    # Texels of different charts (triangles that share no vertex in the image) are further apart than the padding.
    corners = made.uv.reshape(-1, 2)
    point = np.unique(corners, axis=0, return_inverse=True)[1].reshape(-1, 3)
    chart = np.arange(point.max() + 1)
    for _ in range(len(chart)):
        least = chart[point].min(axis=1)
        np.minimum.at(chart, point, least[:, None])
        if (chart[point] == chart[point[:, :1]]).all():
            break
    label = np.where(owner >= 0, chart[point[:, 0]][owner], -1)
    for step in range(1, 4):
        for one, other in ((label[step:], label[:-step]), (label[:, step:], label[:, :-step])):
            assert not ((one >= 0) & (other >= 0) & (one != other)).any()


@pytest.mark.slow
@pytest.mark.parametrize("texels", [10_000, 40_000, 70_000, 400_000])
def test_charts_have_as_many_texels_as_wanted_on_no_larger_a_texture_than_they_need(texels):
    positions, faces = surfaces.icosphere(2)
    made = unwrapped(positions, faces, None, texels=texels)
    corners = made.uv * made.size
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    assert np.abs(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]).sum() / 2 == pytest.approx(texels, rel=0.05)
    side = max(made.size)
    assert side == 256 or corners.max() > 0.75 * side


def test_more_texels_than_there_is_room_for_fill_the_largest_size():
    positions, faces = surfaces.icosphere(1)
    corners, size, charts = unwrapping.cut_and_pack(
        positions.astype(np.float32), faces.astype(np.uint32), [64, 128], 1e12, 2
    )
    assert size == 128
    assert charts > 1
    assert 0.8 * 128 < corners.max() <= 128


@pytest.mark.slow
def test_repetition_unit_stray_and_split_vertices_make_no_difference():
    positions, faces = surfaces.icosphere(2)
    one = unwrapped(positions, faces)
    stray = np.concatenate([positions, [[1e9, 0, 0], [0, 0, -1e300]]])
    for places in (positions, 1024 * positions, stray):
        assert np.array_equal(one.uv, unwrapped(places, faces).uv)
    soup = positions[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)
    assert unwrapped(*soup).charts == one.charts


@pytest.mark.slow
def test_triangles_without_area_get_a_single_place_of_their_vertex():
    positions, faces = surfaces.plane(5, 5)
    flat = [[0, 1, 2], [3, 3, 4], [7, 7, 7]]
    made = unwrapped(positions, np.concatenate([flat, faces]))
    assert (np.ptp(made.uv[:3], axis=1) == 0).all()
    for row, vertex in enumerate((0, 3, 7)):
        assert (made.uv[3:][faces == vertex] == made.uv[row, 0]).all(axis=1).any()
    assert np.array_equal(made.uv[3:], unwrapped(positions, faces).uv)


@pytest.mark.parametrize(
    ("positions", "faces", "said"),
    [
        ([[0, 0, 0], [1, 0, np.nan], [0, 1, 0]], [[0, 1, 2]], "position of vertex 1 is not finite"),
        ([[0, 0, 0], [1, 0, np.inf], [0, 1, 0]], [[0, 1, 2]], "position of vertex 1 is not finite"),
        ([[0, 0, 0], [1, 1, 1], [2, 2, 2]], [[0, 1, 2]], "no triangle with an area"),
        ([[0, 0, 0]], np.zeros((0, 3)), "no triangle with an area"),
    ],
)
def test_what_cannot_be_unwrapped_is_refused_in_words(positions, faces, said):
    with pytest.raises(InputError, match=said):
        unwrapped(positions, faces)


def test_large_meshes_are_refused_with_the_reason_and_the_way_out():
    require_few_faces(80, 80, "mesh")
    with pytest.raises(InputError, match=r"80 triangles.*--max-unwrap-faces 80"):
        require_few_faces(80, 79, "mesh")


def test_a_texture_too_small_for_the_charts_is_refused():
    positions = np.random.default_rng(0).normal(size=(300, 3))
    with pytest.raises(ProcessingError, match="100 charts do not fit on a texture of 32 texels"):
        unwrapped(positions, np.arange(300).reshape(-1, 3), 32)


def test_stopping_ends_the_process_and_leaves_nothing_behind(monkeypatch, tmp_path):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    before = children("self")
    seen = []

    def stop(done, total):
        seen.extend(set(children("self")) - set(before))
        raise KeyboardInterrupt

    positions, faces = surfaces.icosphere(4)
    with pytest.raises(KeyboardInterrupt):
        unwrapped(positions, faces, progress=stop)
    assert seen
    assert children("self") == before
    assert not list(tmp_path.iterdir())


def test_more_is_sent_than_a_pipe_holds():
    positions, faces = surfaces.plane(60, 60)  # 170 kB; Linux holds 64 KiB
    assert unwrapped(positions, faces).charts == 1


def started():
    """Numbers of all processes that this one has started and not yet waited for."""
    return {
        child for each in Path("/proc/self/task").glob("*/children") for child in each.read_text().split()
    }


def test_ctrl_c_leaves_no_zombie(monkeypatch, tmp_path):
    before = started()
    (tmp_path / "endless.py").write_text(
        "import os, signal, time\ntime.sleep(0.2)\nos.kill(os.getppid(), signal.SIGINT)\nwhile True: pass"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr(unwrapping, "WORKER", "endless")
    with pytest.raises(KeyboardInterrupt):
        unwrapped(np.eye(3), [[0, 1, 2]])
    assert started() == before


def test_a_process_that_hangs_is_given_up(monkeypatch, tmp_path):
    before = children("self")
    (tmp_path / "endless.py").write_text("while True: pass")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr(unwrapping, "MIN_TIMEOUT", 0.2)
    monkeypatch.setattr(unwrapping, "WORKER", "endless")
    with pytest.raises(ProcessingError, match="did not end within"):
        unwrapped(np.eye(3), [[0, 1, 2]])
    assert children("self") == before


def test_what_the_process_dies_of_is_reported_in_one_line(monkeypatch):
    monkeypatch.setattr(unwrapping, "WORKER", "beltrami_cli.no_such_module")
    with pytest.raises(ProcessingError, match=r"^xatlas could not unwrap .*no_such_module") as caught:
        unwrapped(np.eye(3), [[0, 1, 2]])
    assert "\n" not in str(caught.value)
