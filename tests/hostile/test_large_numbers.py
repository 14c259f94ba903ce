"""A number that is finite in a file, but not in the single precision of smoothing, is refused as infinity is."""

import numpy as np
import pytest

import beltrami_cli
from beltrami_cli.errors import InputError
from cli.commands import refused
from formats.volume_files import sphere_file
from oracles.surfaces import icosphere
from small_models import ply

POSITIONS, FACES = icosphere(1)
COLOURS = np.random.default_rng(0).uniform(0.3, 0.7, (len(POSITIONS), 3))
LARGE = (-1e308, 1e39)
SAID = "single precision"


def with_one(table, value):
    """Return a table of doubles with one other number."""
    table = np.array(table, np.float64)
    table.flat[-4] = value
    return table


def lines(*tables, separator=" ", before=""):
    rows = np.hstack(tables)
    return "".join(f"{before}{separator.join(map(repr, row))}\n" for row in rows.tolist())


def usda(colours):
    points, shades = (str([tuple(row) for row in table.tolist()]) for table in (POSITIONS, colours))
    return f"""#usda 1.0
def Mesh "m" {{
    int[] faceVertexCounts = {[3] * len(FACES)}
    int[] faceVertexIndices = {FACES.ravel().tolist()}
    point3f[] points = {points}
    color3d[] primvars:displayColor = {shades} (interpolation = "vertex")
}}
"""


def write_with(folder, kind, value):
    """Write a model of a kind, one colour of which has a value, or one coordinate; return its name."""
    colours, faces = with_one(COLOURS, value), lines(FACES + 1, before="f ")
    doubles = "double x y z red green blue"
    match kind:
        case "a.ply" | "place.ply":
            table = [POSITIONS, colours] if kind == "a.ply" else [with_one(POSITIONS, value), COLOURS]
            (folder / kind).write_bytes(ply(doubles, np.hstack(table).tolist(), FACES.tolist()))
        case "a.obj":
            (folder / kind).write_text(lines(POSITIONS, colours, before="v ") + faces)
        case "a.xyz":
            (folder / kind).write_text(lines(POSITIONS, colours))
        case "a.csv":
            (folder / kind).write_text("x,y,z,r,g,b\n" + lines(POSITIONS, colours, separator=","))
        case "a.off":
            opaque = np.ones((len(COLOURS), 1))
            head = f"COFF\n{len(POSITIONS)} {len(FACES)} 0\n"
            body = lines(POSITIONS, colours, opaque) + lines(FACES, before="3 ")
            (folder / kind).write_text(head + body)
        case "a.npz":
            np.savez(folder / kind, points=POSITIONS, colours=colours)
        case "intensity.npz":
            np.savez(folder / kind, points=POSITIONS, intensity=with_one(COLOURS[:, 1], value))
        case "a.usda":
            (folder / kind).write_text(usda(colours))
        case "level":
            sphere_file(folder, 0.5, lambda at: with_one(np.full(at.shape, 0.5), value))
            return "sphere.npz"
    return kind


KINDS = (
    "a.ply", "place.ply", "a.obj", "a.xyz", "a.csv", "a.off", "a.npz", "intensity.npz", "a.usda", "level",
)  # fmt: skip


@pytest.mark.parametrize("value", LARGE)
@pytest.mark.parametrize("kind", KINDS)
def test_files_with_a_number_too_large_are_refused(kind, value, tmp_path):
    name = write_with(tmp_path, kind, value)
    suffix = name.rpartition(".")[2] if kind not in ("a.off", "level") else "ply"
    refused(tmp_path, "smooth", name, f"out.{suffix}", "--noise", "10", code=3, said=SAID)


@pytest.mark.parametrize("option", ["--guide", "--noise"])
def test_tables_of_vertices_with_a_number_too_large_are_refused(option, tmp_path):
    table = np.hstack([POSITIONS, COLOURS]).tolist()
    (tmp_path / "a.ply").write_bytes(ply("double x y z red green blue", table, FACES.tolist()))
    np.save(tmp_path / "table.npy", with_one(COLOURS, 1e39))
    refused(tmp_path, "smooth", "a.ply", "out.ply", option, "table.npy", code=3, said=SAID)


@pytest.mark.parametrize("value", LARGE)
def test_arrays_with_a_number_too_large_are_refused(value):
    image = np.random.default_rng(0).uniform(0.3, 0.7, (16, 16, 3))
    uv = beltrami_cli.MeshArrays(POSITIONS, FACES, uv=np.clip(POSITIONS[:, :2], 0, 1))
    smooth, wrong = beltrami_cli.smooth, with_one(image, value)
    for attempt in (
        lambda: smooth(POSITIONS, FACES, with_one(COLOURS, value)),
        lambda: smooth(with_one(POSITIONS, value), FACES, COLOURS),
        lambda: smooth(POSITIONS, FACES, COLOURS, guide=with_one(COLOURS, value)),
        lambda: beltrami_cli.smooth_image(wrong),  # and no hole
        lambda: beltrami_cli.smooth_image(image, guide=wrong),
        lambda: beltrami_cli.smooth_textured(uv, [wrong]),
    ):
        with pytest.raises(InputError, match=SAID):
            attempt()


def test_light_beyond_single_precision_is_refused_though_its_display_value_is_not():
    with pytest.raises(InputError, match="linear light"):
        beltrami_cli.smooth(POSITIONS, FACES, with_one(COLOURS, 1e17), space="linear")
