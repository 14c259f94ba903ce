"""What SOURCES.md claims about the textured samples is true: charts, seams, paintings, noise, kinds of files."""

from __future__ import annotations

import json
import struct
import sys
from pathlib import Path

import numpy as np
import pytest

from oracles import topology

OpenImageIO = pytest.importorskip("OpenImageIO")
pytestmark = pytest.mark.slow  # 3 s for each process of pytest-xdist in which the textures are baked
FOLDER = Path(__file__).parents[2] / "sample_data"
NAMES = ("head-tex", "torus-two", "mirrored", "tiled", "sphere-exr", "scan")
CHARTS = {"head-tex": 24, "torus-two": 2, "mirrored": 1, "tiled": 1, "sphere-exr": 6, "scan": 100}
COVERAGE = {"head-tex": 0.45, "torus-two": 0.88, "mirrored": 0.90, "sphere-exr": 0.84, "scan": 0.44}
SEAMED = ("head-tex", "torus-two", "sphere-exr", "scan")


@pytest.fixture(scope="module")
def samples(make):
    return dict(make.textured_samples())


def pixels(name):
    """Return the pixels of an image file of the folder in their stored type."""
    image = OpenImageIO.ImageInput.open(str(FOLDER / name))
    spec = image.spec()
    found = np.asarray(image.read_image(0, 0, 0, spec.nchannels, spec.format))
    image.close()
    return found.reshape(spec.height, spec.width, spec.nchannels), spec


def edges(sample):
    """Return per half edge its face, and its ends as vertices, shape (3F, 2), and as corners, in one order."""
    face, k = (part.ravel() for part in np.mgrid[: len(sample.vertices), :3])
    ends = np.stack([sample.vertices[face, k], sample.vertices[face, (k + 1) % 3]], axis=1)
    corners = np.stack([sample.corners[face, k], sample.corners[face, (k + 1) % 3]], axis=1)
    turned = ends[:, 0] > ends[:, 1]
    ends[turned], corners[turned] = ends[turned, ::-1], corners[turned, ::-1]
    return face, ends, corners


def paired(sample):
    """Return the corners and the faces on both sides of every edge with two faces: (E, 2, 2) and (E, 2)."""
    face, ends, corners = edges(sample)
    order = np.lexsort(ends.T)
    _, start, count = np.unique(ends[order], axis=0, return_index=True, return_counts=True)
    assert set(count.tolist()) <= {1, 2}
    pair = np.stack([order[start[count == 2]], order[start[count == 2] + 1]], axis=1)
    return corners[pair], face[pair]


def charts(sample):
    """Return how many groups of faces are joined over edges shared in place and in the texture."""
    corners, faces = paired(sample)
    same = (sample.coordinates[corners[:, 0]] == sample.coordinates[corners[:, 1]]).all(axis=(1, 2))
    same &= sample.material_of[faces[:, 0]] == sample.material_of[faces[:, 1]]
    return topology.components(len(sample.vertices), faces[same])


def seam_colours(sample):
    """Return the colours on both sides of the seams, at three places of each edge, shape (2, K, C)."""
    corners, faces = paired(sample)
    corners, faces = (part[(corners[:, 0] != corners[:, 1]).any(axis=1)] for part in (corners, faces))
    sides = []
    for side in range(2):
        colours = []
        for place in (0.2, 0.5, 0.8):
            uv = (
                place * sample.coordinates[corners[:, side, 0]]
                + (1 - place) * sample.coordinates[corners[:, side, 1]]
            )
            found = np.empty((len(uv), sample.paintings[0].pixels.shape[2]))
            for number, painting in enumerate(sample.paintings):
                mine = sample.material_of[faces[:, side]] == number
                found[mine] = bilinear(painting.pixels, uv[mine])
            colours.append(found)
        sides.append(np.concatenate(colours))
    return np.stack(sides)


def bilinear(image, uv):
    at = uv * image.shape[1::-1] - 0.5
    low = np.floor(at).astype(int)
    fx, fy = (at - low).T[:, :, None]
    x, y = low.T
    above = (1 - fx) * image[y, x] + fx * image[y, x + 1]
    return (1 - fy) * above + fy * ((1 - fx) * image[y + 1, x] + fx * image[y + 1, x + 1])


@pytest.mark.parametrize("name", NAMES)
def test_charts_are_as_many_as_stated(samples, name):
    assert charts(samples[f"{name}-clean"]) == CHARTS[name]


@pytest.mark.parametrize(("name", "euler"), [("head-tex", 2), ("torus-two", 0), ("sphere-exr", 2)])
def test_closed_samples_are_closed_and_oriented_outwards(samples, name, euler):
    sample = samples[f"{name}-clean"]
    pairs = topology.edges(sample.vertices)
    assert (pairs.count == 2).all()
    assert len(sample.positions) - len(pairs.count) + len(sample.vertices) == euler
    a, b, c = (sample.positions[sample.vertices[:, k]] for k in range(3))
    assert (np.cross(a, b) * c).sum() > 0


@pytest.mark.parametrize("name", SEAMED)
def test_triangles_keep_their_side_in_the_image_and_no_texel_has_two(samples, make, name):
    sample = samples[f"{name}-clean"]
    baking = sys.modules["baking"]
    for number, painting in enumerate(sample.paintings):
        size = painting.painted.shape[::-1]
        triangles = (sample.coordinates[sample.corners] * size)[sample.material_of == number]
        area = -baking.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]) / 2
        assert (area > 0).all()
        covered = (baking.covering(triangles, size) >= 0).sum()
        # Triangles that overlap would have more area than they cover together.
        assert abs(area.sum() / covered - 1) < 0.01
        assert covered / painting.painted.size >= COVERAGE[name]


def test_both_halves_of_the_vase_use_the_same_texels_for_mirrored_places(samples):
    sample = samples["mirrored-clean"]
    right, left = np.split(np.arange(len(sample.corners)), 2)

    def centres(rows):
        uv = sample.coordinates[sample.corners[rows]].mean(axis=1)
        order = np.lexsort(np.round(uv, 9).T)
        return uv[order], sample.positions[sample.vertices[rows]].mean(axis=1)[order]

    (uv, places), (uv_mirrored, mirrored) = centres(right), centres(left)
    assert np.allclose(uv, uv_mirrored, atol=1e-9)
    # Diagonals of the cells run the same way in both halves, so that the centres agree.
    assert np.allclose(places * (-1, 1, 1), mirrored, atol=2e-5)
    assert (np.abs(places[:, 0]) > 1e-4).all()


def test_the_floor_repeats_its_texture_six_by_four_times_and_the_painting_has_no_border(samples):
    sample = samples["tiled-clean"]
    assert sample.coordinates.min(axis=0).tolist() == [0, 0]
    assert sample.coordinates.max(axis=0).tolist() == [6, 4]
    image = sample.paintings[0].pixels
    for axis in (0, 1):
        steps = np.abs(np.diff(image, axis=axis)).mean()
        assert np.abs(image.take(0, axis) - image.take(-1, axis)).mean() < steps
    document = json.loads(chunk(FOLDER / "tiled-clean.glb"))
    assert document["samplers"] == [{"wrapS": 10497, "wrapT": 10497}]


@pytest.mark.parametrize("name", SEAMED)
def test_the_clean_painting_is_continuous_across_seams(samples, name):
    one, other = seam_colours(samples[f"{name}-clean"])
    jump = np.abs(one - other).max(axis=1)
    # Where a painted border runs along or over a seam, the two sides see it half a texel apart.
    assert np.median(jump) < 0.01
    assert (jump < 0.1).mean() > 0.9
    shuffled = np.abs(one - np.roll(other, 7, axis=0)).max(axis=1)
    assert jump.mean() < 0.25 * shuffled.mean()


@pytest.mark.parametrize("name", NAMES)
def test_noise_is_gaussian_of_20_levels_on_painted_texels_and_nowhere_else(samples, name):
    pairs = zip(samples[f"{name}-clean"].paintings, samples[f"{name}-noisy"].paintings, strict=True)
    for clean, noisy in pairs:
        noise = noisy.pixels - clean.pixels
        assert (noise[~clean.painted] == 0).all()
        painted = noise[clean.painted] * 255 / 20
        # Four standard errors.
        assert abs(painted.mean()) < 4 / painted.size**0.5
        assert abs(painted.std() - 1) < 4 / (2 * painted.size) ** 0.5


@pytest.mark.parametrize(
    ("file", "kind", "channels", "size"),
    [
        ("head-tex-{}.png", "uint8", 3, (416, 416)),
        ("torus-two-{}-icing.png", "uint8", 3, (512, 136)),
        ("torus-two-{}-dough.png", "uint8", 3, (320, 88)),
        ("mirrored-{}.png", "uint8", 1, (256, 320)),
        ("sphere-exr-{}.exr", "half", 3, (288, 192)),
        ("scan-{}.jpg", "uint8", 3, (512, 512)),
    ],
)
def test_images_are_of_the_stated_kind_and_size(file, kind, channels, size):
    for which in ("clean", "noisy"):
        _, spec = pixels(file.format(which))
        assert (str(spec.format), spec.nchannels, (spec.width, spec.height)) == (kind, channels, size)
        assert spec.getattribute("jpeg:subsampling") == ("4:2:0" if file.endswith("jpg") else None)


def test_the_glint_on_the_planet_is_brighter_than_white():
    light, _ = pixels("sphere-exr-clean.exr")
    assert light.max() > 2


@pytest.mark.parametrize("kind", ["clean", "noisy"])
def test_glb_files_hold_the_same_images_as_the_files_beside_them(kind):
    for name, suffix in (("head-tex", ".png"), ("scan", ".jpg")):
        assert (FOLDER / f"{name}-{kind}{suffix}").read_bytes() in (
            FOLDER / f"{name}-{kind}.glb"
        ).read_bytes()
    document = json.loads(chunk(FOLDER / f"tiled-{kind}.glb"))
    view = document["bufferViews"][document["images"][0]["bufferView"]]
    data = (FOLDER / f"tiled-{kind}.glb").read_bytes()[-document["buffers"][0]["byteLength"] :]
    header = data[view["byteOffset"] : view["byteOffset"] + 25]
    assert struct.unpack_from(">II", header, 16) == (256, 256)
    assert header[24] == 16


def chunk(path):
    data = path.read_bytes()
    return data[20 : 20 + struct.unpack_from("<I", data, 12)[0]]


def test_check_looks_at_pixels_not_at_how_they_are_packed(make, tmp_path):
    path = tmp_path / "again.png"
    clean, _ = pixels("mirrored-clean.png")
    clean = clean.copy()
    same = sys.modules["comparison"].same
    made = (FOLDER / "mirrored-clean.png").read_bytes()
    for change, expected in ((0, True), (1, False)):
        clean[5, 7] += change
        spec = OpenImageIO.ImageSpec(clean.shape[1], clean.shape[0], 1, "uint8")
        spec["png:compressionLevel"] = 1
        output = OpenImageIO.ImageOutput.create(str(path))
        output.open(str(path), spec)
        output.write_image(clean)
        output.close()
        assert path.read_bytes() != made
        assert same(path.read_bytes(), made, ".png") is expected


def test_check_sees_what_changes_in_a_glb_besides_the_packing_of_its_images(make):
    same = sys.modules["comparison"].same
    data = (FOLDER / "scan-clean.glb").read_bytes()
    start = 28 + len(chunk(FOLDER / "scan-clean.glb"))
    assert same(data, data, ".glb")
    moved = bytearray(data)
    moved[start] ^= 1
    assert not same(bytes(moved), data, ".glb")
    assert not same(data[:1000], data, ".glb")
