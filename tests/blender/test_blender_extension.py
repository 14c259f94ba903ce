"""The extension in Blender itself, without a window: `make test-blender`, which gets Blender as a Python module.

The command is named by BELTRAMI, since it lives in an environment of its own.
"""

import os
import subprocess
import sys
import tempfile
import time
import zipfile
from pathlib import Path
from types import SimpleNamespace

import pytest

os.environ.setdefault(
    "BLENDER_USER_RESOURCES", tempfile.mkdtemp(prefix="beltrami-blender-")
)  # not the user's own
bpy = pytest.importorskip("bpy", reason="Blender as a module (bpy) is not installed: run make test-blender")
np = pytest.importorskip("numpy")

SIDE = 128
# Path-traced noise differs from place to place, so the strength is given and not chosen.
FOR_BAKES = {"iterations": 5, "beta": 8.0}
SMALL_STEPS = {"iterations": 3, "beta": 8.0}


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """The extension as the command writes it."""
    target = tmp_path_factory.mktemp("extension") / "beltrami.zip"
    subprocess.run([os.environ.get("BELTRAMI", "beltrami"), "blender-extension", target], check=True)
    return target


@pytest.fixture(scope="module")
def extension(written):
    """Its modules, imported."""
    zipfile.ZipFile(written).extractall(written.parent / "beltrami_extension")
    sys.path.insert(0, str(written.parent))
    import beltrami_extension

    return beltrami_extension


@pytest.fixture
def scene(extension):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    extension.register()
    yield bpy.context.scene
    extension.unregister()


def choose(scene, target, **values):
    scene.beltrami.target = target
    for name, value in values.items():
        setattr(scene.beltrami, f"gives_{name}", True)
        setattr(scene.beltrami, name, value)


def numbers(items, name, width, kind="f4"):
    found = np.empty(len(items) * width, kind)
    items.foreach_get(name, found)
    return found.reshape(-1, width)


def psnr(one, two):
    return float(-10 * np.log10(np.mean((np.asarray(one, float) - two) ** 2)))


def displayed(linear):
    values = np.clip(linear, 0, 1)
    return np.where(values < 0.0031308, 12.92 * values, 1.055 * values ** (1 / 2.4) - 0.055)


def sphere():
    bpy.ops.mesh.primitive_uv_sphere_add(segments=48, ring_count=32)
    return bpy.context.active_object


def two_colours(places):
    return np.where(places[:, 2:] > 0, [[0.8, 0.3, 0.2]], [[0.2, 0.4, 0.7]])


@pytest.mark.parametrize("kind", ["BYTE_COLOR", "FLOAT_COLOR"])
@pytest.mark.parametrize("domain", ["POINT", "CORNER"])
def test_a_colour_attribute_is_smoothed_with_undo_and_redo(scene, domain, kind):
    item = sphere()
    attribute = item.data.color_attributes.new("paint", kind, domain)
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
    bpy.ops.ed.undo_push(message="painted")
    choose(scene, "COLOURS", **SMALL_STEPS)
    assert bpy.ops.object.beltrami_smooth() == {"FINISHED"}
    bpy.ops.ed.undo_push(message="smoothed")

    def current():
        return numbers(bpy.context.active_object.data.color_attributes["paint"].data, "color_srgb", 4)

    after = current()
    assert psnr(after[:, :3], clean[vertex_of]) > psnr(before[:, :3], clean[vertex_of]) + 6
    np.testing.assert_array_equal(after[:, 3], before[:, 3])
    bpy.ops.ed.undo()
    np.testing.assert_array_equal(current(), before)
    bpy.ops.ed.redo()
    np.testing.assert_array_equal(current(), after)


def textured(item, image):
    """Show an image on an object."""
    material = bpy.data.materials.new("skin")
    material.use_nodes = True
    node = material.node_tree.nodes.new("ShaderNodeTexImage")
    node.image = image
    material.node_tree.nodes.active = node
    item.data.materials.append(material)


def noisy(side=SIDE, channels=4, seed=2):
    """Return a clean picture with an edge, and the same with noise."""
    rows, columns = np.mgrid[:side, :side] / side
    clean = np.stack([rows * 0.5, np.where(columns > 0.4, 0.7, 0.2), 0.3 + 0 * rows, 1 + 0 * rows], -1)[
        ..., :channels
    ]
    dirty = clean.copy()
    dirty[..., :3] += np.random.default_rng(seed).normal(0, 0.05, (side, side, 3))
    return clean, np.clip(np.rint(dirty * 255) / 255, 0, 1).astype("f4")


def of_image(image):
    found = np.empty(image.size[0] * image.size[1] * image.channels, "f4")
    image.pixels.foreach_get(found)
    return found.reshape(image.size[1], image.size[0], image.channels)


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


def seam_jumps(item, pixels):
    """Return how far the colours on both sides of each seam are apart, at the middle of its edges."""
    mesh, places = item.data, {}
    uv = numbers(mesh.uv_layers[0].uv, "vector", 2)
    for polygon in mesh.polygons:
        loops = list(polygon.loop_indices)
        centre = uv[loops].mean(axis=0)
        for one, two in zip(loops, loops[1:] + loops[:1], strict=True):
            ends = mesh.loops[one].vertex_index, mesh.loops[two].vertex_index
            middle = (uv[one] + uv[two]) / 2
            inward = centre - middle
            inside = middle + inward / max(np.linalg.norm(inward), 1e-9) * 0.75 / len(pixels)
            angle = polygon.normal
            places.setdefault(frozenset(ends), []).append((middle, inside, angle))
    jumps = []
    for sides in places.values():
        if (
            len(sides) == 2
            and np.linalg.norm(sides[0][0] - sides[1][0]) > 1e-4
            and sides[0][2].dot(sides[1][2]) > 0.97
        ):
            cells = [(np.clip(inside, 0, 1 - 1e-6) * len(pixels)).astype(int) for _, inside, _ in sides]
            jumps.append(np.abs(pixels[cells[0][1], cells[0][0]] - pixels[cells[1][1], cells[1][0]]).mean())
    return np.array(jumps)


def draw_side_by_side(scene, item, image, lightmaps, path):
    """Draw an object with one lightmap after another, for the page of the documentation."""
    tree = item.data.materials[0].node_tree
    shader, shown = tree.nodes.new("ShaderNodeEmission"), []
    tree.links.new(next(node for node in tree.nodes if node.type == "TEX_IMAGE").outputs[0], shader.inputs[0])
    tree.links.new(shader.outputs[0], tree.nodes["Material Output"].inputs[0])
    bpy.ops.object.camera_add(location=(2.2, -2.6, 2.4), rotation=(0.95, 0, 0.7))
    bpy.data.objects["Plane"].hide_render = True
    scene.camera, scene.cycles.samples = bpy.context.active_object, 16
    scene.render.resolution_x = scene.render.resolution_y = 400
    scene.view_settings.view_transform = "Standard"
    scene.render.filepath = str(path.with_name("part.png"))
    for pixels in lightmaps:
        image.pixels.foreach_set(pixels.ravel())
        image.update()
        bpy.ops.render.render(write_still=True)
        part = bpy.data.images.load(scene.render.filepath, check_existing=False)
        shown.append(of_image(part))
        bpy.data.images.remove(part)
    Path(scene.render.filepath).unlink()
    joined = np.concatenate(shown, axis=1)
    made = bpy.data.images.new("joined", joined.shape[1], joined.shape[0], alpha=False)
    made.pixels.foreach_set(joined.ravel())
    made.filepath_raw, made.file_format = str(path), "PNG"
    made.save()


def test_a_bake_of_few_samples_comes_close_to_one_of_many_without_seams(scene):
    scene.render.engine = "CYCLES"
    scene.cycles.device, scene.cycles.use_denoising = "CPU", False
    bpy.ops.mesh.primitive_plane_add(size=6, location=(0, 0, -1))
    for place, colour in (((2, -2, 3), (1, 0.6, 0.4)), ((-3, 1, 2), (0.3, 0.5, 1))):
        bpy.ops.object.light_add(type="AREA", location=place)
        light = bpy.context.active_object
        light.rotation_euler = (-light.location).to_track_quat("-Z", "Y").to_euler()
        light.data.energy, light.data.size, light.data.color = 70, 2, colour
    scene.world = bpy.data.worlds.new("sky")
    scene.world.color = (0.2, 0.25, 0.3)
    bpy.ops.mesh.primitive_torus_add(major_segments=48, minor_segments=24)
    item = bpy.context.active_object
    bpy.ops.object.shade_smooth()
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.uv.smart_project(island_margin=0.02)
    bpy.ops.object.mode_set(mode="OBJECT")
    image = bpy.data.images.new("light", 2 * SIDE, 2 * SIDE, alpha=True, float_buffer=True)
    textured(item, image)

    def baked(samples, margin=16):
        scene.cycles.samples, scene.cycles.seed = samples, samples
        bpy.ops.object.bake(type="DIFFUSE", pass_filter={"DIRECT", "INDIRECT"}, margin=margin, use_clear=True)
        return of_image(image)

    covered = baked(1, margin=0)[..., 3] > 0.5
    many, few = baked(512), baked(16)
    choose(scene, "IMAGES", **FOR_BAKES)
    assert bpy.ops.object.beltrami_smooth() == {"FINISHED"}
    after = of_image(image)
    wanted, noisy_one, smooth = (displayed(each[..., :3]) for each in (many, few, after))
    gained = psnr(smooth[covered], wanted[covered]) - psnr(noisy_one[covered], wanted[covered])
    jumps = [float(seam_jumps(item, each).mean()) for each in (noisy_one, smooth, wanted)]
    print(
        f"\nbake: {psnr(noisy_one[covered], wanted[covered]):.2f} dB, smoothed {gained:+.2f} dB; jumps across "
        f"seams, before, after, of many samples: {jumps[0]:.4f}, {jumps[1]:.4f}, {jumps[2]:.4f}"
    )
    if folder := os.environ.get("BELTRAMI_PICTURES"):
        draw_side_by_side(scene, item, image, (few, after, many), Path(folder) / "blender-bake.png")
    assert gained >= 3
    assert jumps[1] < jumps[0] / 2
    assert jumps[1] < jumps[2] + 0.01


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
    item = painted_sphere()
    choose(scene, "COLOURS", **SMALL_STEPS)
    run = extension.Run(bpy.context)
    item.data.color_attributes.remove(item.data.color_attributes["paint"])
    run.process.wait()
    with pytest.raises(extension.exchange.ExchangeError, match="was changed meanwhile"):
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
        painted_sphere()
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
        ["--beta", "7.5", "--space", "linear", "--fast", "--gutter", "4"]
    )


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


def painted_sphere():
    item = sphere()
    attribute = item.data.color_attributes.new("paint", "BYTE_COLOR", "POINT")
    attribute.data.foreach_set("color_srgb", np.random.default_rng(0).random(len(attribute.data) * 4, "f4"))
    item.data.color_attributes.active_color = attribute
    return item


@pytest.mark.parametrize("stopped", [False, True])
def test_blender_stays_usable_meanwhile_and_escape_stops_it(scene, extension, stopped):
    attribute = painted_sphere().data.color_attributes["paint"]
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
    painted_sphere()
    choose(scene, "COLOURS", **SMALL_STEPS)
    run = extension.Run(bpy.context)
    run.process.wait()
    label, percent = run.progress()
    assert label
    assert percent == 100
    run.finish()
    assert not Path(run._temporary.name).exists()
