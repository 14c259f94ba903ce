"""The extension in Blender itself, and scenes to smooth.

The command is named by BELTRAMI, since it lives in an environment of its own.
"""

import os
import subprocess
import sys
import tempfile
import zipfile

import pytest

os.environ.setdefault(
    "BLENDER_USER_RESOURCES", tempfile.mkdtemp(prefix="beltrami-blender-")
)  # not the user's own
bpy = pytest.importorskip("bpy", reason="Blender as a module (bpy) is not installed: run make test-blender")
np = pytest.importorskip("numpy")

SIDE = 128
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


def sphere():
    bpy.ops.mesh.primitive_uv_sphere_add(segments=48, ring_count=32)
    return bpy.context.active_object


def textured(item, image):
    """Show an image on an object."""
    material = bpy.data.materials.new("skin")
    material.use_nodes = True
    node = material.node_tree.nodes.new("ShaderNodeTexImage")
    node.image = image
    material.node_tree.nodes.active = node
    item.data.materials.append(material)


def of_image(image):
    found = np.empty(image.size[0] * image.size[1] * image.channels, "f4")
    image.pixels.foreach_get(found)
    return found.reshape(image.size[1], image.size[0], image.channels)


def coloured_sphere():
    item = sphere()
    attribute = item.data.color_attributes.new("colour", "BYTE_COLOR", "POINT")
    attribute.data.foreach_set("color_srgb", np.random.default_rng(0).random(len(attribute.data) * 4, "f4"))
    item.data.color_attributes.active_color = attribute
    return item
