"""Surfaces of any size: the same colours, or a refusal in a line; never a warning, never nothing without a word."""

import numpy as np
import pytest

import beltrami_cli
from beltrami_cli.errors import InputError
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.jobs.inspect import inspect_file
from beltrami_cli.jobs.job import Job
from beltrami_cli.jobs.kernel.file import kernel_file
from beltrami_cli.jobs.smooth import smooth_file
from beltrami_cli.layers.settings import ImageSettings, SmoothSettings
from formats.image_files import encode, stored
from hostile.textured_models import PICTURE
from oracles import surfaces

KERNEL = KernelParameters(iterations=1, t=1.0, beta=3.0, metric_steps=0, beta_growth=1.0, clipping="keep")
SETTINGS = SmoothSettings(kernel=KERNEL)
EXTREME = [1e-310, 1e-160, 1e-45, 1e-38, 1e-22, 1e22, 1e38, 1e150, 1e200, 1e307]


def obj(folder, scale, kind, placed=float):
    """Write a square of a side of 8, with colours at its vertices or with a texture."""
    (folder / "m.mtl").write_text("newmtl m\nmap_Kd skin.png\n")
    (folder / "skin.png").write_bytes(PICTURE)
    lines = ["mtllib m.mtl", "usemtl m"] if kind == "texture" else []
    for number, (i, j) in enumerate(np.ndindex(9, 9)):
        colour = f"0.{number:02} 0.5 0.2" if kind == "vertices" else ""
        lines.append(f"v {placed(j * scale)!r} {placed(i * scale)!r} 0 {colour}\nvt {j / 8} {i / 8}")
    corners = 1 + surfaces.grid_faces(9, 9)
    corner = "{0}/{0}" if kind == "texture" else "{0}"
    lines += ["f " + " ".join(corner.format(c) for c in face) for face in corners.tolist()]
    (folder / "plane.obj").write_text("\n".join([*lines, ""]))
    return folder / "plane.obj"


@pytest.mark.parametrize("scale", EXTREME)
@pytest.mark.parametrize("kind", ["vertices", "texture"])
def test_what_cannot_be_measured_is_refused(kind, scale, tmp_path):
    source = obj(tmp_path, scale, kind)
    before = set(tmp_path.iterdir())
    said = rf"{source}: its edges are \S+ units, .* single precision; scale it"
    with pytest.raises(InputError, match=said):
        smooth_file(source, tmp_path / "out.obj", SETTINGS)
    with pytest.raises(InputError, match=said):
        inspect_file(source, SETTINGS)
    with pytest.raises(InputError, match=said):
        kernel_file(source, tmp_path / "kernel.png", "3" if kind == "vertices" else "0.5,0.5", SETTINGS)
    assert set(tmp_path.iterdir()) == before


@pytest.mark.parametrize("kind", ["vertices", "texture"])
def test_positions_rounded_as_coarsely_as_vertices_lie_are_told(kind, tmp_path):
    northing = 5_200_000.0
    coarse = obj(tmp_path, 0.1, kind, lambda x: float(np.float32(northing + x)))
    report = smooth_file(coarse, tmp_path / "out.obj", SETTINGS)
    (said,) = (text for text in report.warnings if "rounded to steps" in text)
    assert said.startswith("Positions are rounded to steps of 0.5 in single precision, ")
    assert said in inspect_file(coarse, SETTINGS)["notices"]
    job = Job(overwrite=True)
    for offset, precision in ((northing, np.float64), (0, np.float32), (1000, np.float32)):
        fine = obj(tmp_path, 0.02, kind, lambda x: float(precision(offset + x)))  # noqa: B023
        report = smooth_file(fine, tmp_path / "out.obj", SETTINGS, job=job)
        assert not [text for text in report.warnings if "rounded" in text]


@pytest.mark.parametrize("scale", EXTREME)
def test_arrays_and_clouds_that_cannot_be_measured_are_refused(scale):
    random = np.random.default_rng(4)
    points = np.column_stack([random.random((50, 2)), np.zeros(50)]) * scale
    colours = random.random((50, 3))
    with pytest.raises(InputError, match="the arrays: its points are apart"):
        beltrami_cli.smooth(points, None, colours)
    with pytest.raises(InputError, match="the arrays: its edges are"):
        beltrami_cli.smooth(points, np.arange(48).reshape(-1, 3), colours)


def test_a_map_of_positions_is_judged_by_what_most_of_it_is_like(tmp_path):
    y, x = np.mgrid[:20, :24].astype(np.float32)
    photo = np.random.default_rng(5).integers(0, 256, (20, 24, 3), np.uint8)
    (tmp_path / "photo.png").write_bytes(encode(photo, "png"))
    settings = SmoothSettings(kernel=KERNEL, image=ImageSettings(positions=str(tmp_path / "xyz.exr")))
    results = []
    for background in (np.nan, 1e30):  # a hole, or far away, as renderers have it
        places = np.dstack([x, y, 0 * x])
        places[:3] = background
        (tmp_path / "xyz.exr").write_bytes(encode(places, "openexr", "float"))
        smooth_file(tmp_path / "photo.png", tmp_path / "out.png", settings, job=Job(overwrite=True))
        results.append(stored(tmp_path / "out.png")[10:])  # beyond its windows
    np.testing.assert_array_equal(*results)
    tiny = np.dstack([x, y, 0 * x]) * np.float32(1e-30)
    (tmp_path / "xyz.exr").write_bytes(encode(tiny, "openexr", "float"))
    with pytest.raises(InputError, match=r"xyz\.exr: its edges are"):
        smooth_file(tmp_path / "photo.png", tmp_path / "out.png", settings, job=Job(overwrite=True))
