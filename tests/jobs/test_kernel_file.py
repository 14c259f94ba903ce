"""The kernel that is shown is what smoothing averages by."""

import dataclasses
from pathlib import Path

import numpy as np
import OpenImageIO
import pytest
import trimesh

import beltrami_cli
from beltrami_cli.errors import UsageError
from beltrami_cli.fields import override
from beltrami_cli.flow.parameters import PRESETS, KernelParameters
from beltrami_cli.jobs.job import Job
from beltrami_cli.jobs.kernel.file import kernel_file
from beltrami_cli.layers.settings import DEFAULTS, ImageSettings, SmoothSettings
from formats.image_files import encode
from oracles import surfaces
from small_models import ply

SAMPLES = Path(__file__).parents[2] / "sample_data"
HEAD = SAMPLES / "head-noisy.ply"
TEXTURED = SAMPLES / "head-tex-noisy.glb"
SEVERAL = SAMPLES / "torus-two-noisy.gltf"
PICTURE = SAMPLES / "head-tex-noisy.png"
FAST = override(DEFAULTS, fast=True)  # the rule rather than a search
# Parameters that make different kernels: the default (a regularised metric), the paper's, a Gaussian.
KERNELS = {
    "default": SmoothSettings(KernelParameters(iterations=1, clipping="keep")),
    "paper": SmoothSettings(KernelParameters(**PRESETS["paper"])),
    "gauss": SmoothSettings(KernelParameters(iterations=1, beta=0.0)),
}
AREA = SmoothSettings(KernelParameters(iterations=1, weights="area", clipping="keep"))


RANGE = b"obj_info num_cols 14\nobj_info num_rows 11\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Inputs with float colours, which smoothing does not round: a mesh, an image, and heights for it."""
    path = tmp_path_factory.mktemp("float")
    random = np.random.default_rng(2)
    flat, faces = surfaces.plane(14, 11, 0.2)
    colours = step(flat[:, 0]) + random.normal(0, 0.06, (len(flat), 3))
    rows, floats = np.column_stack([flat, colours]).tolist(), "float x y z red green blue"
    (path / "mesh.ply").write_bytes(ply(floats, rows, faces.tolist(), "binary_little_endian"))
    grid = ply(floats, rows, encoding="binary_little_endian").replace(b"element", RANGE + b"element", 1)
    (path / "range.ply").write_bytes(grid)
    write_exr(path / "image.exr", step(np.arange(40) / 14)[None] + random.normal(0, 0.06, (30, 40, 3)))
    y, x = np.mgrid[:30, :40]
    write_exr(path / "heights.exr", 6 * np.sin(x / 4)[..., None] * np.cos(y / 5)[..., None])
    return path


def step(x):
    return np.where(x[..., None] > 1.4, [0.7, 0.6, 0.4], [0.3, 0.4, 0.5])


def write_exr(path, pixels):
    path.write_bytes(encode(np.float32(pixels), "openexr", "float"))


def read_pixels(path):
    return OpenImageIO.ImageBuf(str(path)).get_pixels("float")


def vertices_of(path):
    return trimesh.load(path, process=False).metadata["_ply_raw"]["vertex"]["data"]


def kernel_of(source, at, tmp_path, settings=FAST, **options):
    return kernel_file(source, tmp_path / "kernel.csv", at, settings, job=Job(overwrite=True), **options)


def drawn(source, at, target, settings=FAST, **options):
    kernel_file(source, target, at, settings, job=Job(overwrite=True), **options)
    return target


def smoothed(source, target, settings):
    beltrami_cli.smooth_file(source, target, settings, job=Job(overwrite=True))
    return target


def as_data(settings, **image):
    return dataclasses.replace(settings, space="data", image=ImageSettings(**image))


def mean_of(kernel):
    table = kernel.table
    return [np.average(table[channel], weights=table["weight"]) for channel in ("red", "green", "blue")]


def vertex_colour(path, facts):
    row = vertices_of(path)[facts.table["vertex"][0]]
    return [float(row[channel]) for channel in ("red", "green", "blue")]


def pixel_colour(path, facts):
    (image,) = [path] if path.suffix == ".exr" else path.parent.glob("*.png")
    return read_pixels(image)[facts.table["y"][0], facts.table["x"][0]]


# Of float32 twice: the stored colours, and the sums in the kernel; the last file has 8 bits.
@pytest.mark.parametrize(
    ("name", "at", "settings", "colour", "tolerance"),
    [
        *(("mesh.ply", "64", as_data(each), vertex_colour, 1e-6) for each in (*KERNELS.values(), AREA)),
        *(("range.ply", "64", as_data(each), vertex_colour, 1e-6) for each in KERNELS.values()),
        *(("image.exr", "18,11", as_data(each), pixel_colour, 1e-6) for each in KERNELS.values()),
        *(("image.exr", "39,0", as_data(each), pixel_colour, 1e-6) for each in KERNELS.values()),  # window is cut
        *(("image.exr", "18,11", as_data(each, height="heights.exr"), pixel_colour, 1e-6) for each in KERNELS.values()),
        *(
            pytest.param(SAMPLES / "head-tex-noisy.obj", "0.3,0.7", each, pixel_colour, 0.5 / 255 + 1e-6,
                         marks=pytest.mark.slow)
            for each in KERNELS.values()
        ),
    ],
)  # fmt: skip
def test_the_samples_of_a_kernel_give_what_smoothing_makes(
    name, at, settings, colour, tolerance, folder, tmp_path, monkeypatch
):
    monkeypatch.chdir(folder)  # where the heights are
    facts = kernel_of(folder / name, at, tmp_path, settings)
    out = smoothed(folder / name, tmp_path / f"out{Path(name).suffix}", settings)
    np.testing.assert_allclose(mean_of(facts), colour(out, facts), atol=tolerance)
    if "." not in at:  # no texture coordinates
        place = [facts.table[column][0] for column in (("vertex",) if "," not in at else ("x", "y"))]
        assert ",".join(map(str, place)) == at


def test_a_kernel_of_a_later_iteration_continues_those_before_it(folder, tmp_path):
    kernel = KernelParameters(iterations=3, beta=8.0, beta_growth=1.5, clipping="keep")
    settings = as_data(SmoothSettings(kernel))
    facts = kernel_of(folder / "image.exr", "18,11", tmp_path, settings, iteration=3)
    image = read_pixels(smoothed(folder / "image.exr", tmp_path / "out.exr", settings))
    np.testing.assert_allclose(mean_of(facts), image[11, 18], atol=1e-6)
    assert facts.beta == pytest.approx(8 * 1.5**2)
    with pytest.raises(UsageError, match=r"^--iteration 4 is not among the 3 of smoothing"):
        kernel_of(folder / "image.exr", "18,11", tmp_path, settings, iteration=4)


def test_a_kernel_that_is_cut_short_says_so(tmp_path):
    few = SmoothSettings(KernelParameters(beta=0.0, max_samples=20))
    assert kernel_of(HEAD, "1234", tmp_path, few).cut_short
    assert not kernel_of(HEAD, "1234", tmp_path).cut_short


@pytest.mark.parametrize(("source", "at"), [(HEAD, "1234"), (TEXTURED, "0.3,0.3"), (PICTURE, "100,300")])
def test_weights_are_the_kernel_of_the_distances(source, at, tmp_path):
    settings = SmoothSettings(KernelParameters(t=1.7, threshold=0.05))
    facts = kernel_of(source, at, tmp_path, settings)
    distances, weights = facts.table["distance"].astype(float), facts.table["weight"]
    assert distances[0] == 0
    assert (np.diff(distances) >= 0).all()
    np.testing.assert_allclose(weights, np.exp(-(distances**2) / (4 * 1.7)), rtol=1e-6)
    assert weights.min() >= 0.05 * (1 - 1e-6)


def test_a_mesh_to_look_at_holds_the_kernel_in_colours_and_its_surroundings_in_grey(tmp_path):
    facts = kernel_of(HEAD, "1234", tmp_path, iteration=4)
    rows = vertices_of(drawn(HEAD, "1234", tmp_path / "kernel.ply", iteration=4))
    held = np.isfinite(rows["distance"])
    assert 10 < np.count_nonzero(held) == len(facts.table["vertex"]) < len(rows)
    np.testing.assert_array_equal(np.sort(rows["distance"][held]), facts.table["distance"])
    assert (rows["weight"][~held] == 0).all()
    grey = (rows["red"] == rows["green"]) & (rows["green"] == rows["blue"])
    np.testing.assert_array_equal(grey, ~held)
    # Dark where the kernel ends: the colour map's lightness grows towards the source, up to rounding.
    light = rows["red"] * 0.2126 + rows["green"] * 0.7152 + rows["blue"] * 0.0722
    assert (np.diff(light[held][np.argsort(rows["distance"][held])]) < 1.5).all()


def test_a_position_chooses_the_vertex_nearest_to_it(tmp_path):
    row = vertices_of(HEAD)[1234]
    near = ",".join(str(float(row[axis]) + 1e-4) for axis in "xyz")
    assert kernel_of(HEAD, near, tmp_path).at == "vertex 1234"


@pytest.mark.slow
def test_texture_coordinates_are_those_of_the_file(tmp_path):
    # glTF counts v from the upper side of the image, OBJ from the lower.
    upper = kernel_of(TEXTURED, "0.3,0.2", tmp_path).at
    lower = kernel_of(SAMPLES / "head-tex-noisy.obj", "0.3,0.8", tmp_path).at
    assert upper.split()[1] == lower.split()[1]


def test_a_picture_shows_painting_distances_and_weights_side_by_side(tmp_path):
    facts = kernel_of(PICTURE, "100,300", tmp_path)
    picture = read_pixels(drawn(PICTURE, "100,300", tmp_path / "kernel.png"))
    cells = 2 * (3 + 4) + 1  # the window of 7, and four beyond on each side
    side = len(picture)
    assert side % cells == 0
    gap, zoom = (picture.shape[1] - 3 * side) // 2, side // cells
    panels = [picture[zoom // 2 :: zoom, k * (side + gap) : k * (side + gap) + side] for k in range(3)]
    phantom, distances, weights = (panel[:, zoom // 2 :: zoom] for panel in panels)
    np.testing.assert_allclose(phantom, read_pixels(PICTURE)[293:308, 93:108, :3], atol=0.6 / 255)
    columns = facts.table
    held = {(y - 293, x - 93) for x, y in zip(columns["x"], columns["y"], strict=True)}
    for panel in (distances, weights):
        assert {tuple(cell) for cell in np.argwhere(np.ptp(panel, axis=2) > 1e-6).tolist()} == held


def test_a_place_without_colour_stands_for_the_nearest_texel_with_one(tmp_path):
    corner = kernel_of(TEXTURED, "0,0", tmp_path)
    column, row = corner.table["x"][0], corner.table["y"][0]
    assert (column, row) != (0, 0)
    assert corner.at.startswith(f"texel {column},{row} of ")


def test_one_of_several_textures_is_chosen_by_a_glob(tmp_path):
    facts = kernel_of(SEVERAL, "*icing*:0.3,0.3", tmp_path)
    assert facts.table["texture"][0] == "torus-two-noisy-icing.png"
