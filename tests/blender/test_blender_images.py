"""Images in Blender, smoothed where they lie: `make test-blender`."""

import pytest

from blender.scenes import (
    SIDE,
    SMALL_STEPS,
    bpy,
    choose,
    extension,
    np,
    numbers,
    of_image,
    psnr,
    scene,
    textured,
    written,
)


def noisy(side=SIDE, channels=4, seed=2):
    """Return a clean picture with an edge, and the same with noise."""
    rows, columns = np.mgrid[:side, :side] / side
    clean = np.stack([rows * 0.5, np.where(columns > 0.4, 0.7, 0.2), 0.3 + 0 * rows, 1 + 0 * rows], -1)[
        ..., :channels
    ]
    dirty = clean.copy()
    dirty[..., :3] += np.random.default_rng(seed).normal(0, 0.05, (side, side, 3))
    return clean, np.clip(np.rint(dirty * 255) / 255, 0, 1).astype("f4")


@pytest.mark.parametrize("is_float", [False, True])
@pytest.mark.parametrize("place", ["generated", "packed", "on disk"])
def test_an_image_is_smoothed_where_it_lies_with_undo_and_redo(scene, extension, tmp_path, place, is_float):
    clean, dirty = noisy()
    image = bpy.data.images.new("skin", SIDE, SIDE, alpha=True, float_buffer=is_float)
    image.pixels.foreach_set(dirty.ravel())
    path = tmp_path / ("skin.exr" if is_float else "skin.png")
    if place == "packed":
        image.pack()
    elif place == "on disk":
        bpy.data.images.remove(image)
        extension.exchange._save(dirty, path, "OPEN_EXR" if is_float else "PNG", is_float=is_float)
        image = bpy.data.images.load(str(path))
    bpy.ops.mesh.primitive_plane_add()
    textured(bpy.context.active_object, image)
    before = of_image(image)
    bpy.ops.ed.undo_push(message="painted")
    choose(scene, "IMAGES", **SMALL_STEPS)
    scene.beltrami.saves = True
    assert bpy.ops.object.beltrami_smooth() == {"FINISHED"}
    bpy.ops.ed.undo_push(message="smoothed")
    name = image.name
    after = of_image(bpy.data.images[name])
    assert psnr(after[..., :3], clean[..., :3]) > psnr(before[..., :3], clean[..., :3]) + 6
    np.testing.assert_array_equal(after[..., 3], before[..., 3])
    image = bpy.data.images[name]
    assert image.is_float == is_float
    assert (image.packed_file is not None) == (place == "packed")
    if place == "on disk":
        again = bpy.data.images.load(str(path))
        assert np.abs(of_image(again) - after).max() < 1e-3  # as Blender saves floats, perhaps as halves
        bpy.data.images.remove(again)
    for step, wanted in ((bpy.ops.ed.undo, before), (bpy.ops.ed.redo, after)):
        step()
        np.testing.assert_array_equal(of_image(bpy.data.images[name]), wanted)


def test_an_image_of_another_file_is_no_earlier_step_of_one_with_its_name(scene, extension):
    for smoothed in (True, False):
        image = bpy.data.images.new("skin", SIDE, SIDE, alpha=True)
        image.pixels.foreach_set(noisy(seed=2 + smoothed)[1].ravel())
        image.pack()
        before = of_image(image)
        bpy.ops.mesh.primitive_plane_add()
        textured(bpy.context.active_object, image)
        if smoothed:
            choose(bpy.context.scene, "IMAGES", **SMALL_STEPS)
            assert bpy.ops.object.beltrami_smooth() == {"FINISHED"}
            bpy.ops.wm.read_homefile(use_empty=True)
    extension.follow_undo()
    np.testing.assert_array_equal(of_image(bpy.data.images["skin"]), before)


@pytest.mark.parametrize("packed", [False, True])
def test_all_tiles_of_an_image_are_one_surface(scene, extension, tmp_path, packed):
    pictures = {1001: noisy(64, seed=3), 1002: noisy(64, seed=4)}
    for number, (_, dirty) in pictures.items():
        made = bpy.data.images.new("tile", 64, 64, alpha=True)
        made.pixels.foreach_set(dirty.ravel())
        made.filepath_raw, made.file_format = str(tmp_path / f"skin.{number}.png"), "PNG"
        made.save()
        bpy.data.images.remove(made)
    bpy.ops.image.open(filepath=str(tmp_path / "skin.1001.png"), use_udim_detecting=True)
    image = next(each for each in bpy.data.images if each.source == "TILED")
    assert sorted(tile.number for tile in image.tiles) == [1001, 1002]
    if packed:
        image.pack()
    files = {number: (tmp_path / f"skin.{number}.png").read_bytes() for number in pictures}
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=2, y_subdivisions=1)
    item = bpy.context.active_object
    uv = numbers(item.data.uv_layers[0].uv, "vector", 2)
    item.data.uv_layers[0].uv.foreach_set("vector", (uv * [2, 1]).astype("f4").ravel())
    textured(item, image)
    choose(scene, "IMAGES", **SMALL_STEPS)
    assert bpy.ops.object.beltrami_smooth() == {"FINISHED"}
    image = bpy.data.images[image.name]
    assert image.source == "TILED"
    assert bool(image.packed_files) == packed
    out = tmp_path / "out"
    out.mkdir()
    extension.exchange.save_copy(image, out / "skin.<UDIM>.png")
    for number, (clean, dirty) in pictures.items():
        found = bpy.data.images.load(str(out / f"skin.{number}.png"))
        assert psnr(of_image(found)[..., :3], clean[..., :3]) > psnr(dirty[..., :3], clean[..., :3]) + 5
        assert ((tmp_path / f"skin.{number}.png").read_bytes() == files[number]) == packed
        bpy.data.images.remove(found)
