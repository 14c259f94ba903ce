"""Compare a lightmap of few samples, smoothed in Blender, with one of many samples; `make test-blender` runs it.

The picture of the documentation is drawn into the folder that BELTRAMI_PICTURES names.
"""

import os
from pathlib import Path

from blender.scenes import SIDE, bpy, choose, extension, np, numbers, of_image, psnr, scene, textured, written

# The noise of path tracing varies with the place, so parameters are given instead of estimated.
FOR_BAKES = {"iterations": 5, "beta": 8.0}


def displayed(linear):
    values = np.clip(linear, 0, 1)
    return np.where(values < 0.0031308, 12.92 * values, 1.055 * values ** (1 / 2.4) - 0.055)


def seam_jumps(item, pixels):
    """Return the colour difference across each edge of a seam, at its middle."""
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


def lit_torus(scene):
    """Return a torus below two lamps and a sky, and the image that their light is baked into."""
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
    return item, image


def test_a_bake_of_few_samples_comes_close_to_one_of_many_without_seams(scene):
    item, image = lit_torus(scene)

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
