"""A glTF model with nearly everything that the format knows: what must come out as it went in."""

import numpy as np

from formats.gltf_files import Textured
from formats.image_files import encode, noise
from oracles.surfaces import plane

SIDE = 5
GRID, FACES = plane(SIDE, SIDE)
GRID[:, 2] = np.sin(GRID[:, 0])
GRID = GRID.astype("<f4")
UV = np.ascontiguousarray(GRID[:, :2] / (SIDE - 1))
CORNERS = FACES.astype("<u2")
STRIP = np.concatenate(
    [[first, first + SIDE] for first in range(SIDE)] + [[2 * SIDE - 1, SIDE]]
    + [[first + SIDE, first + 2 * SIDE] for first in range(SIDE)]
).astype("<u2")  # fmt: skip
TRANSFORM = {"KHR_texture_transform": {"offset": [0.25, 0.5], "rotation": 0.5, "scale": [0.5, 0.25]}}
NOTE = {"author": "tests", "numbers": [1.50, 2e-3], "text": "a\u2028b", "deep": {"er": [None, True]}}


def photo(number, size=16):
    return encode(noise("uint8", 3, size, size, number), "png")


def noisy(kind, width, number):
    """Return random colours; opaque, if they have an opacity."""
    rng = np.random.default_rng(number)
    colours = rng.random((SIDE * SIDE, width)).astype("<f4")
    colours[:, 3:] = 1
    return colours if kind == "f4" else np.rint(colours * np.iinfo(kind).max).astype(f"<{kind}")


def showcase(place="view"):
    """Return a model; `place` says where its images are, as for `Textured`."""
    model = Textured(place)
    tree = model.tree
    materials(model)
    deformed(model)
    quantised(model)
    others(model)
    around(model)
    tree["extensionsUsed"] = [
        "KHR_texture_transform", "KHR_materials_unlit", "KHR_materials_pbrSpecularGlossiness",
        "KHR_mesh_quantization", "KHR_lights_punctual", "ACME_notes",
    ]  # fmt: skip
    tree["extensionsRequired"] = ["KHR_mesh_quantization"]
    for key in ("nodes", "meshes", "materials", "textures", "images", "samplers", "accessors", "bufferViews"):
        for index, entry in enumerate(tree[key]):
            entry["extras"] = {"number": index, **NOTE}
    return model


def materials(model):
    """Make five materials, and images; the first is shown in two slots and by two textures."""
    photos = [model.image(photo(number), f"photo {number}.png") for number in range(4)]
    base = model.texture(photos[0], wrap=(33071, 33648))
    again, normal, gloss = (model.texture(photos[n]) for n in (0, 1, 2))
    data = model.texture(photos[3])
    model.material(
        "skin",
        baseColor={"index": base, "extensions": TRANSFORM},
        normal={"index": normal, "scale": 0.5},
        occlusion={"index": data, "strength": 0.5},
        metallicRoughness=data,
    )
    model.material("second set", baseColor={"index": again, "texCoord": 1}, emissive=base)
    unlit = model.material("unlit", baseColor=again)
    model.tree["materials"][unlit]["extensions"] = {"KHR_materials_unlit": {}}
    model.material("gloss", diffuse=gloss)
    model.material("plain")
    model.tree["materials"][0] |= {"alphaMode": "BLEND", "doubleSided": True}


def deformed(model):
    """Make a skinned mesh with morph targets, and its animation."""
    count = SIDE * SIDE
    joints = np.zeros((count, 4), "<u1")
    joints[:, 1] = 1
    weights = np.tile(np.array([0.25, 0.75, 0, 0], "<f4"), (count, 1))
    moved = np.zeros((count, 3), "<f4")
    moved[[3, 7]] = 0.5
    attributes = {
        "POSITION": model.packed(GRID, bounds=True),
        "TEXCOORD_0": model.packed(UV),
        "TEXCOORD_1": model.packed(np.rint(UV[:, ::-1] * 65535).astype("<u2"), normalized=True),
        "COLOR_0": model.packed(noisy("u2", 4, 0), normalized=True, bounds=True),
        "COLOR_1": model.packed(noisy("u1", 4, 9), normalized=True),
        "JOINTS_0": model.packed(joints),
        "WEIGHTS_0": model.packed(weights),
        "_TEMPERATURE": model.packed(GRID[:, :1]),
    }
    targets = [
        {"POSITION": model.sparse(moved, [3, 7], None, bounds=True)},
        {"POSITION": model.packed(GRID / 8, bounds=True)},
    ]
    primitive = {"attributes": attributes, "targets": targets, "indices": model.indices(CORNERS)}
    mesh = model.mesh(primitive | {"material": 0}, primitive | {"material": 1}, node=False)
    model.tree["meshes"][mesh] |= {"weights": [0.5, 0.25], "name": "body"}
    inverse = model.view(np.tile(np.eye(4, dtype="<f4"), (2, 1, 1)).tobytes())
    model.tree["accessors"].append({"bufferView": inverse, "componentType": 5126, "count": 2, "type": "MAT4"})
    joint = len(model.tree["nodes"])
    model.tree["nodes"] += [
        {"name": "hip", "children": [joint + 1]},
        {"name": "knee", "translation": [0, 1, 0]},
        {"name": "body", "mesh": mesh, "skin": 0},
    ]
    model.tree["skins"] = [
        {"joints": [joint, joint + 1], "inverseBindMatrices": len(model.tree["accessors"]) - 1}
    ]
    model.tree["scenes"][0]["nodes"] += [joint, joint + 2]
    model.tree["animations"] = [animation(model, joint + 1, joint + 2)]


def animation(model, joint, body):
    def tight(array, **more):
        return model.accessor(array, model.view(array.tobytes()), **more)

    time = tight(np.array([[0], [1]], "<f4"), bounds=True)
    turn = tight(np.array([[0, 0, 0, 1], [0, 0, 1, 0]], "<f4"))
    weights = tight(np.array([[0], [1], [1], [0]], "<f4"))
    samplers = [{"input": time, "output": turn}, {"input": time, "output": weights}]
    targets = [{"node": joint, "path": "rotation"}, {"node": body, "path": "weights"}]
    channels = [{"sampler": number, "target": target} for number, target in enumerate(targets)]
    return {"name": "walk", "samplers": samplers, "channels": channels}


def quantised(model):
    """Make a mesh of small integers, interleaved, shown by two nodes."""
    position, uv, colour = model.interleaved(
        np.rint(GRID * 1000).astype("<i2"),
        np.rint(UV * 255).astype("<u1"),
        noisy("u1", 4, 1),
        normalized=True,
    )
    accessors = model.tree["accessors"]
    accessors[position] |= {"min": [0, 0, -757], "max": [4000, 4000, 909]}
    accessors[uv]["normalized"] = True
    accessors[position].pop("normalized", None)
    attributes = {"POSITION": position, "TEXCOORD_0": uv, "COLOR_0": colour}
    primitive = {"attributes": attributes, "indices": model.indices(CORNERS), "material": 2}
    mesh = model.mesh(primitive, translation=[10, 0, 0], scale=[0.001, 0.001, 0.001])
    model.tree["nodes"].append({"mesh": mesh, "translation": [20, 0, 0], "scale": [0.001, -0.001, 0.001]})
    model.tree["scenes"][0]["nodes"].append(len(model.tree["nodes"]) - 1)


def others(model):
    """Make a strip, a fan and points."""

    def primitive(number, **more):
        attributes = {
            "POSITION": model.packed(GRID, bounds=True),
            "TEXCOORD_0": model.packed(UV),
            "COLOR_0": model.packed(noisy("f4", 3, number)),
        }
        return {"attributes": attributes, "material": 3, **more}

    model.mesh(primitive(2, mode=5, indices=model.indices(STRIP)), translation=[0, 10, 0])
    model.mesh(primitive(3, mode=6, indices=model.indices(CORNERS[:8].ravel()[:7])), translation=[0, 20, 0])
    model.mesh(primitive(4, mode=0, material=4), translation=[0, 30, 0])


def around(model):
    """Add a camera, lights, a second scene, and an unknown extension."""
    tree = model.tree
    blob = model.view(b"bytes of an unknown extension")
    tree["cameras"] = [{"type": "perspective", "perspective": {"yfov": 0.7, "znear": 0.01}}]
    lights = [
        {"type": "point", "color": [1, 0.5, 0.25], "intensity": 3},
        {"type": "directional", "name": "sun"},
    ]
    tree["extensions"] = {
        "KHR_lights_punctual": {"lights": lights},
        "ACME_notes": {"bufferView": blob, "notes": NOTE},
    }
    first = len(tree["nodes"])
    tree["nodes"] += [
        {"camera": 0, "translation": [0, 0, 9]},
        {"extensions": {"KHR_lights_punctual": {"light": 0}}},
        {"extensions": {"KHR_lights_punctual": {"light": 1}, "ACME_notes": {"seen": NOTE}}},
    ]
    tree["scenes"][0]["nodes"] += [first, first + 1]
    tree["scenes"].append(
        {"name": "other", "nodes": [first + 2, tree["scenes"][0]["nodes"][0]], "extras": NOTE}
    )
