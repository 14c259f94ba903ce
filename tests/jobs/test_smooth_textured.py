"""`beltrami_cli.smooth_textured` changes arrays as files are changed, and refuses all that does not fit."""

import numpy as np
import pytest
import trimesh
from PIL import Image

from beltrami_cli import MeshArrays, smooth, smooth_file, smooth_textured
from beltrami_cli.errors import BeltramiError, UsageError
from beltrami_cli.formats.image.reading import read_image
from formats.image_files import encode
from small_models import textured_squares

CORNERS = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
POSITIONS = np.array([[left + x, y, 0] for left in (0, 1) for x, y in CORNERS])
FACES = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
UV = np.tile(CORNERS, (2, 1)).astype(float)
TEXTURE_OF = [0, 0, 1, 1]
MESH, SQUARE = MeshArrays(POSITIONS, FACES, uv=UV), MeshArrays(POSITIONS[:4], FACES[:2], uv=UV[:4])
NOISY = (0.5 + np.random.default_rng(0).normal(0, 0.05, (32, 32, 3))).clip(0, 1)
BYTES = np.rint(255 * NOISY).astype(np.uint8)
FIXED = {"beta": 8.0, "iterations": 1}


@pytest.mark.parametrize(
    ("suffix", "kind", "pixels"),
    [(".png", "uint8", BYTES), (".png", "uint16", 257 * BYTES.astype(np.uint16)),
     (".exr", "half", NOISY.astype(np.float16)), (".exr", "float", NOISY.astype(np.float32))],
)  # fmt: skip
@pytest.mark.parametrize("gutter", [0, 4])
def test_arrays_come_out_as_files_do(suffix, kind, pixels, gutter, tmp_path):
    known, encoding = ("png", "srgb") if suffix == ".png" else ("openexr", "linear")
    images = [pixels, np.ascontiguousarray(pixels[::-1, ::-1])]
    for name, image in zip("ab", images, strict=True):
        (tmp_path / (name + suffix)).write_bytes(encode(image, known, kind))
    squares = [(name + suffix, left, (0.2, 0.8)) for left, name in enumerate("ab")]  # with a gutter around
    source = textured_squares(tmp_path / "model.obj", *squares)
    target = tmp_path / "out" / "model.obj"
    target.parent.mkdir()
    report = smooth_file(source, target, gutter=gutter, **FIXED).textures[0]
    mesh = MESH._replace(uv=0.2 + 0.6 * UV)
    result = smooth_textured(mesh, images, texture_of=TEXTURE_OF, encoding=encoding, gutter=gutter, **FIXED)
    for old, new, file in zip(images, result.images, sorted(target.parent.glob("*" + suffix)), strict=True):
        assert np.array_equal(new, read_image(file.read_bytes(), file.name).pixels)
        assert (new.dtype, new.shape) == (old.dtype, old.shape)
        assert (new != old).any()
    assert (result.report.change, result.report.noise) == (report.change, report.noise)


@pytest.mark.parametrize(("origin", "v"), [("lower", UV[:, 1]), ("upper", 1 - UV[:, 1])])
@pytest.mark.parametrize("by_corner", [False, True])
def test_uv_are_of_vertices_or_corners_and_begin_at_either_edge(origin, v, by_corner):
    upper_half = np.stack([UV[:, 0], v / 2 + (0.5 if origin == "lower" else 0)], axis=1)
    mesh = MESH._replace(uv=upper_half[FACES] if by_corner else upper_half)
    texture_of = [0, 0, -1, -1]
    (new,) = smooth_textured(mesh, [BYTES], texture_of=texture_of, origin=origin, gutter=0, **FIXED).images
    assert ((new != BYTES).any(axis=(1, 2)) == (np.arange(32) < 16)).all()


@pytest.mark.parametrize("shape", [(32, 32), (32, 32, 1), (32, 32, 2), (32, 32, 4)])
def test_images_keep_their_shape_and_what_cannot_be_seen(shape):
    image = np.random.default_rng(1).integers(0, 256, shape).astype(np.uint8)
    hidden = slice(16 if shape[2:] in ((2,), (4,)) else 0)  # rows of opacity 0
    image[hidden][..., -1] = 0
    (new,) = smooth_textured(SQUARE, [image], gutter=0, **FIXED).images
    assert new.shape == image.shape
    assert (new[16:] != image[16:]).any()
    assert np.array_equal(new[hidden], image[hidden])


@pytest.mark.parametrize("mode", ["RGB", "P", "L"])
@pytest.mark.parametrize(("kind", "name"), [("SimpleMaterial", "image"), ("PBRMaterial", "baseColorTexture")])
def test_a_textured_mesh_of_trimesh_has_all_that_is_needed(mode, kind, name):
    image = Image.fromarray(BYTES).convert(mode)
    pixels = np.asarray(image.convert("RGB") if mode == "P" else image)
    material = getattr(trimesh.visual.material, kind)(**{name: image})
    visual = trimesh.visual.TextureVisuals(uv=UV[:4], material=material)
    mesh = trimesh.Trimesh(POSITIONS[:4], FACES[:2], visual=visual, process=False)
    expected = smooth_textured(SQUARE, [pixels], **FIXED).images
    assert np.array_equal(smooth_textured(mesh, **FIXED).images, expected)
    with pytest.raises(UsageError, match="smooth_textured"):
        smooth(mesh)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"mesh": MeshArrays(POSITIONS, FACES)}, "no texture coordinates"),
        ({"mesh": POSITIONS}, "no texture coordinates"),
        ({"mesh": MESH._replace(uv=UV[:3])}, r"uv must be numbers of shape \(8, 2\)"),
        ({"mesh": MESH._replace(uv=UV[FACES][:1])}, r"\(4, 3, 2\)"),
        ({"mesh": MESH._replace(uv=np.where(UV, np.nan, UV))}, "uv of face 0 is not finite"),
        ({"mesh": MESH._replace(positions=POSITIONS[:, :2])}, r"\(V, 3\)"),
        ({"images": None}, "there are 0 images"), ({"images": [np.zeros((4, 4, 5))]}, "C from 1 to 4"),
        ({"images": [NOISY.astype(np.int64)]}, "uint8"), ({"images": [NOISY + np.inf]}, "not finite"),
        ({"images": [NOISY, NOISY]}, "texture_of must give"),
        ({"texture_of": [0, 0, 0]}, "texture_of must be numbers of shape"),
        ({"origin": "top"}, "origin is top"), ({"guides": ("normal",)}, "no guides"),
        ({"noise": "sigma.png"}, "files of noise"), ({"smooth_geometry": True}, "smooth_geometry"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_refused_by_one_line(change, said):
    with pytest.raises(BeltramiError, match=said) as caught:
        smooth_textured(**{"mesh": MESH, "images": [NOISY], **change})
    assert "\n" not in str(caught.value)
