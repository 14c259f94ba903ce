"""PLY files whose vertices lie on a grid: recognised, smoothed like an image on a surface, patched in place."""

import struct

import numpy as np
import pytest

from beltrami_cli import InputError, UsageError, inspect_file, smooth_file, smooth_image
from beltrami_cli.formats.ply.document import PlyDocument
from beltrami_cli.formats.registry import open_document
from beltrami_cli.jobs.job import Job
from beltrami_cli.layers.image_surface import ImageSurface
from beltrami_cli.layers.selection import select
from hostile.textured_models import ONCE

ROWS, COLUMNS = 20, 26
VERTEX = "property float x\nproperty float y\nproperty float z\n" + "".join(
    f"property uchar {name}\n" for name in ("red", "green", "blue")
)
RECORD = {">": [("place", ">f4", 3), ("colour", "u1", 3)], "<": [("place", "<f4", 3), ("colour", "u1", 3)]}


def scene():
    """Places, 8-bit colours and measured places of a scan with a step in depth."""
    y, x = np.mgrid[:ROWS, :COLUMNS]
    places = np.dstack([x, y, 3 * np.sin(x / 4) + 40 * (y > 11)]).astype(np.float32)
    colours = 90 + 60 * (x > 12)[..., None] + np.random.default_rng(0).normal(0, 12, (ROWS, COLUMNS, 3))
    return places, np.rint(colours).astype(np.uint8), np.random.default_rng(1).random((ROWS, COLUMNS)) > 0.1


def vertices(places, colours, order):
    table = np.zeros(len(places), RECORD[order])
    table["place"], table["colour"] = places, colours
    return table.tobytes()


def stanford(rows=ROWS, columns=COLUMNS, listed=None):
    """A range_grid as the Stanford repository has it; vertices in the order of `listed`."""
    places, colours, measured = scene()
    number = np.full((ROWS, COLUMNS), -1)
    number[measured] = np.random.default_rng(2).permutation(np.count_nonzero(measured))
    order = np.argsort(number[measured])
    number = number.ravel() if listed is None else listed
    header = (
        f"ply\nformat binary_big_endian 1.0\nobj_info num_cols {columns}\nobj_info num_rows {rows}\n"
        f"element vertex {len(order)}\n{VERTEX}element range_grid {len(number)}\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    grid = b"".join(b"\0" if n < 0 else b"\1" + int(n).to_bytes(4, "big") for n in number)
    return header.encode() + vertices(places[measured][order], colours[measured][order], ">") + grid


def organised(size, text=False):
    """Every place a vertex, NaN where nothing was measured; `size` describes the grid."""
    places, colours, measured = scene()
    places[~measured] = np.nan
    form = "ascii" if text else "binary_little_endian"
    head, tail = (size, b"") if isinstance(size, str) else ("", size[1])
    header = f"ply\nformat {form} 1.0\n{head}element vertex {ROWS * COLUMNS}\n{VERTEX}"
    header += "" if isinstance(size, str) else size[0]
    places, colours = places.reshape(-1, 3), colours.reshape(-1, 3)
    body = vertices(places, colours, "<")
    if text:
        rows = zip(places.tolist(), colours.tolist(), strict=True)
        body = "".join(" ".join(map(str, (*place, *colour))) + "\n" for place, colour in rows).encode()
    return header.encode() + b"end_header\n" + body + tail


CAMERA = (
    "element camera 1\nproperty float view_px\nproperty int viewportx\nproperty int viewporty\n",
    np.float32(0).tobytes() + np.array([COLUMNS, ROWS], "<i4").tobytes(),
)
ONE_FACE = b"element face 1\nproperty list uchar int vertex_indices\n"
FILES = {
    "range_grid": stanford(),
    "camera": organised(CAMERA),
    "obj_info": organised(f"obj_info width {COLUMNS}\nobj_info height {ROWS}\n"),
    "comments": organised(f"comment width: {COLUMNS}\ncomment height: {ROWS}\n", text=True),
}


def colours_on_grid(path):
    document = open_document(str(path))
    grid, image = document.grid(), np.zeros((ROWS, COLUMNS, 3), np.float32)
    image[grid >= 0] = document.coloured_vertices().colours[grid[grid >= 0]]
    return image


@pytest.mark.parametrize("data", FILES.values(), ids=FILES)
def test_a_range_image_is_smoothed_like_the_image_at_its_positions(data, tmp_path):
    source, target = tmp_path / "a.ply", tmp_path / "b.ply"
    source.write_bytes(data)
    kernel = {"iterations": 5, "t": 2.4, "beta": 9, "beta_growth": 2.0, "metric_steps": 2}
    report = smooth_file(source, target, **kernel)
    places, colours, measured = scene()
    expected = smooth_image(colours, surface=ImageSurface(positions=places, valid=measured), **kernel).colours
    apart = np.abs(colours_on_grid(target) - expected / 255)[measured]
    assert apart.max() < 1.5 / 255  # halves may round either way
    assert apart.mean() < 1e-4
    assert report.vertices.counts["samples"] == np.count_nonzero(measured)
    assert report.vertices.spacing > 0


def test_only_colours_of_what_was_measured_change(tmp_path):
    for number, data in enumerate((FILES["range_grid"], FILES["camera"])):
        source, target = tmp_path / f"a{number}.ply", tmp_path / f"b{number}.ply"
        source.write_bytes(data)
        smooth_file(source, target, ONCE)
        new = target.read_bytes()
        assert len(new) == len(data)
        start = data.index(b"end_header\n") + len(b"end_header\n")
        changed = np.flatnonzero(np.frombuffer(new, np.uint8) != np.frombuffer(data, np.uint8)) - start
        assert len(changed) > 500
        assert (changed % 15 >= 12).all()  # of 15 bytes of a vertex the last three
        if number == 1:
            assert scene()[2].ravel()[changed // 15].all()
        smooth_file(source, target, iterations=0, job=Job(overwrite=True))
        assert target.read_bytes() == data


def test_samples_are_the_vertices_that_were_measured():
    measured = scene()[2].ravel()
    (layer,) = select(PlyDocument(FILES["camera"], "a.ply"), ONCE).layers()
    sample_of = layer.places().sample_of
    np.testing.assert_array_equal(sample_of >= 0, measured)
    np.testing.assert_array_equal(sample_of[measured], np.arange(np.count_nonzero(measured)))
    assert len(layer.normalised().plan().manifold.new_colours().table()) == np.count_nonzero(measured)


@pytest.mark.parametrize(
    "data",
    [
        organised(""),
        organised(f"comment width {COLUMNS}\ncomment height {ROWS + 1}\n"),
        organised("comment width 9\n"),
        b"ply\nformat ascii 1.0\nelement range_grid 1\nproperty list uchar int vertex_indices\nend_header\n0\n",
        FILES["obj_info"].replace(b"end_header\n", ONE_FACE + b"end_header\n")
        + struct.pack("<B3i", 3, 0, 1, 2),
    ],
    ids=["no size", "too high", "no height", "no vertices", "faces count more"],
)
def test_without_a_grid_of_the_right_size_vertices_are_no_image(data):
    assert PlyDocument(data, "a.ply").grid() is None


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (stanford(rows=ROWS + 1), "520 places, but obj_info num_cols and num_rows say 26 and 21"),
        (stanford(listed=np.full(ROWS * COLUMNS, 3)), "a vertex at several places"),
        (stanford(listed=np.full(ROWS * COLUMNS, 9999)), "vertices that are not there"),
    ],
)
def test_damaged_grids_are_refused(data, said, tmp_path):
    (tmp_path / "a.ply").write_bytes(data)
    with pytest.raises(InputError, match=said):
        smooth_file(tmp_path / "a.ply", tmp_path / "b.ply")


def test_what_is_not_done_on_grids_is_refused_and_info_describes_them(tmp_path):
    (tmp_path / "a.ply").write_bytes(FILES["camera"])
    with pytest.raises(UsageError, match="--weights: not on range images"):
        smooth_file(tmp_path / "a.ply", tmp_path / "b.ply", weights="area")
    facts = inspect_file(tmp_path / "a.ply")
    assert facts["surface"]["range_image"] == [COLUMNS, ROWS]
    assert facts["surface"]["holes"] == np.count_nonzero(~scene()[2])
    assert facts["noise"]["red"] == pytest.approx(12 / 255, rel=0.4)  # of 520 samples
