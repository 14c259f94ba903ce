"""The extension in Blender itself, without a window: `make test-blender`, which gets Blender as a Python module."""

import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from blender.scenes import (
    SIDE,
    SMALL_STEPS,
    bpy,
    choose,
    coloured_sphere,
    extension,
    np,
    numbers,
    of_image,
    psnr,
    scene,
    sphere,
    textured,
    written,
)


def two_colours(places):
    return np.where(places[:, 2:] > 0, [[0.8, 0.3, 0.2]], [[0.2, 0.4, 0.7]])


@pytest.mark.parametrize("kind", ["BYTE_COLOR", "FLOAT_COLOR"])
@pytest.mark.parametrize("domain", ["POINT", "CORNER"])
def test_a_colour_attribute_is_smoothed_with_undo_and_redo(scene, domain, kind):
    item = sphere()
    attribute = item.data.color_attributes.new("colour", kind, domain)
    item.data.color_attributes.active_color = attribute
    places = numbers(item.data.vertices, "co", 3)
    noise = np.random.default_rng(1).normal(0, 0.05, places.shape)
    vertex_of = np.arange(len(places))
    if domain == "CORNER":
        vertex_of = numbers(item.data.loops, "vertex_index", 1, "i4").ravel()
    clean, colours = two_colours(places), np.full((len(vertex_of), 4), 0.5, "f4")
    colours[:, :3] = np.clip(clean + noise, 0, 1)[vertex_of]
    attribute.data.foreach_set("color_srgb", colours.ravel())
    before = numbers(attribute.data, "color_srgb", 4)
    bpy.ops.ed.undo_push(message="coloured")
    choose(scene, "COLOURS", **SMALL_STEPS)
    assert bpy.ops.object.beltrami_smooth() == {"FINISHED"}
    bpy.ops.ed.undo_push(message="smoothed")

    def current():
        return numbers(bpy.context.active_object.data.color_attributes["colour"].data, "color_srgb", 4)

    after = current()
    assert psnr(after[:, :3], clean[vertex_of]) > psnr(before[:, :3], clean[vertex_of]) + 6
    np.testing.assert_array_equal(after[:, 3], before[:, 3])
    bpy.ops.ed.undo()
    np.testing.assert_array_equal(current(), before)
    bpy.ops.ed.redo()
    np.testing.assert_array_equal(current(), after)


def test_what_cannot_be_done_is_said_and_changes_nothing(scene):
    item = sphere()
    for target, cause in (("COLOURS", "no colour attribute"), ("IMAGES", "no material")):
        choose(scene, target)
        with pytest.raises(RuntimeError, match=cause):
            bpy.ops.object.beltrami_smooth()
    image = bpy.data.images.new("skin", 8, 8)
    textured(item, image)
    choose(scene, "IMAGES")
    scene.beltrami.channels = "ultraviolet"
    before = of_image(image)
    with pytest.raises(RuntimeError, match="ultraviolet"):
        bpy.ops.object.beltrami_smooth()
    np.testing.assert_array_equal(of_image(image), before)


def test_what_is_gone_when_the_result_comes_is_said(scene, extension):
    item = coloured_sphere()
    choose(scene, "COLOURS", **SMALL_STEPS)
    run = extension.Run(bpy.context)
    item.data.color_attributes.remove(item.data.color_attributes["colour"])
    run.process.wait()
    with pytest.raises(extension.ExtensionError, match="was changed meanwhile"):
        run.finish()
    assert not Path(run._temporary.name).exists()
    bpy.ops.object.mode_set(mode="EDIT")
    assert not bpy.ops.object.beltrami_smooth.poll()


def test_blender_installs_it_and_it_names_what_cannot_be_started(written):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.preferences.addon_enable(module="bl_pkg")
    bpy.ops.extensions.package_install_files(
        filepath=str(written), repo="user_default", enable_on_install=True
    )
    name = "bl_ext.user_default.beltrami"
    preferences = bpy.context.preferences.addons[name].preferences
    try:
        coloured_sphere()
        choose(bpy.context.scene, "COLOURS", **SMALL_STEPS)
        assert bpy.ops.object.beltrami_smooth() == {"FINISHED"}
        assert bpy.context.scene.beltrami_said.startswith(f"{bpy.context.active_object.name}: ")
        preferences.command = str(written.parent / "nowhere")
        with pytest.raises(RuntimeError, match="nowhere cannot be started"):
            bpy.ops.object.beltrami_smooth()
    finally:
        bpy.ops.preferences.addon_disable(module=name)


def test_arguments_are_what_differs_from_the_defaults(scene, extension):
    assert extension.parameters.arguments(scene.beltrami) == []
    choose(scene, "COLOURS", beta=7.5)
    scene.beltrami.space, scene.beltrami.fast, scene.beltrami.gutter = "linear", True, "4"
    assert sorted(extension.parameters.arguments(scene.beltrami)) == sorted(
        ["--beta", "7.5", "--space", "linear", "--fast"]
    )
    scene.beltrami.target = "IMAGES"
    assert {"--gutter", "4"} <= {*extension.parameters.arguments(scene.beltrami)}


class Layout:
    """What a panel draws on; keeps the names of the properties."""

    def __init__(self, values, drawn):
        self.values, self.drawn, self.active = values, drawn, True

    def column(self, **_):
        return self

    row = column

    def label(self, text):
        assert text

    def prop(self, values, name, **_):
        assert hasattr(values, name)
        self.drawn.append(name)


def test_every_parameter_of_the_program_is_on_the_panel_once(scene, extension):
    drawn = []
    for daily in (True, False):
        extension.parameters.draw(Layout(scene.beltrami, drawn), scene.beltrami, daily=daily)
    declared = extension.parameters.DECLARED["parameters"]
    assert len(drawn) == len(set(drawn))
    assert {each["name"] for each in declared} <= set(drawn)
    assert all(each["help"] for each in declared)


class Modal:
    """The operator while it runs, without the window that sends it events."""

    def __init__(self, extension, context):
        self._kind, self._run, self._timer, self.said = extension.OBJECT_OT_beltrami_smooth, None, None, []
        self._run = extension.Run(context)
        self.shown = []
        manager = SimpleNamespace(
            event_timer_remove=lambda timer: None,
            progress_end=lambda: None,
            progress_update=self.shown.append,
        )
        workspace = SimpleNamespace(status_text_set=lambda text: None)
        self.context = SimpleNamespace(
            window_manager=manager, workspace=workspace, scene=context.scene, screen=None
        )

    def report(self, kind, text):
        self.said.append((kind, text))

    def _leave(self, context):
        self._kind._leave(self, context)

    def _finish(self, context):
        return self._kind._finish(self, context)

    def event(self, kind):
        return self._kind.modal(self, self.context, SimpleNamespace(type=kind))


@pytest.mark.parametrize("stopped", [False, True])
def test_blender_stays_usable_meanwhile_and_escape_stops_it(scene, extension, stopped):
    attribute = coloured_sphere().data.color_attributes["colour"]
    before = numbers(attribute.data, "color_srgb", 4)
    choose(scene, "COLOURS", **SMALL_STEPS)
    modal = Modal(extension, bpy.context)
    assert modal.event("MOUSEMOVE") == {"PASS_THROUGH"}
    assert modal.event("TIMER") == {"RUNNING_MODAL"}
    if stopped:
        assert modal.event("ESC") == {"CANCELLED"}
        assert modal._run.process.poll() is not None
    else:
        while modal.event("TIMER") == {"RUNNING_MODAL"}:
            time.sleep(0.05)
        assert modal.shown == sorted(modal.shown)
        assert modal.said[-1][0] == {"INFO"}
    same = np.array_equal(numbers(attribute.data, "color_srgb", 4), before)
    assert same == stopped
    assert not Path(modal._run._temporary.name).exists()


def test_progress_is_read_from_the_program(scene, extension):
    coloured_sphere()
    choose(scene, "COLOURS", **SMALL_STEPS)
    run = extension.Run(bpy.context)
    run.process.wait()
    label, percent = run.progress()
    assert label
    assert percent == 100
    run.finish()
    assert not Path(run._temporary.name).exists()


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
        extension.images.save_pixels(dirty, path, "OPEN_EXR" if is_float else "PNG", is_float=is_float)
        image = bpy.data.images.load(str(path))
    bpy.ops.mesh.primitive_plane_add()
    textured(bpy.context.active_object, image)
    before = of_image(image)
    bpy.ops.ed.undo_push(message="coloured")
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
    extension.images.save_copy(image, out / "skin.<UDIM>.png")
    for number, (clean, dirty) in pictures.items():
        found = bpy.data.images.load(str(out / f"skin.{number}.png"))
        assert psnr(of_image(found)[..., :3], clean[..., :3]) > psnr(dirty[..., :3], clean[..., :3]) + 5
        assert ((tmp_path / f"skin.{number}.png").read_bytes() == files[number]) == packed
        bpy.data.images.remove(found)
