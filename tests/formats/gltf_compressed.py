"""Models of the tests compressed with Draco and with meshoptimizer, by the encoders of these libraries."""

import json

import DracoPy
import meshoptimizer
import numpy as np

from formats.gltf_files import Textured, numbers
from oracles.surfaces import plane

SIDE = 6
GRID, FACES = plane(SIDE, SIDE)
GRID[:, 2] = GRID[:, 0] * GRID[:, 1] % 3
GRID = GRID.astype("<f4")
UV = GRID[:, :2].astype("f8") / (SIDE - 1)
CORNERS = FACES.astype("<u4")
DRACO = "KHR_draco_mesh_compression"


def draco_bytes(colours, *, in_order=False):
    """Encode the grid; positions and texture coordinates are kept well enough to be recovered by rounding."""
    return DracoPy.encode(
        GRID,
        CORNERS,
        colors=colours,
        tex_coord=UV,
        quantization_bits=16,
        tex_coord_quantization_bits=16,
        preserve_order=in_order,
    )


def draco_primitive(model, colours, *, in_order=False, view=None, **more):
    """Add a compressed primitive; what decoders give is asked of the library, as an exporter does."""
    data = draco_bytes(colours, in_order=in_order)
    mesh = DracoPy.decode(data)
    kinds = {"POSITION": 0, "COLOR_0": 2, "TEXCOORD_0": 3}
    found = {name: mesh.get_attribute_by_type(kind) for name, kind in kinds.items()}
    attributes = {
        "POSITION": model.accessor(found["POSITION"]["data"].astype("<f4"), bounds=True),
        "COLOR_0": model.accessor(found["COLOR_0"]["data"].astype("<u1"), normalized=True, bounds=True),
        "TEXCOORD_0": model.accessor(found["TEXCOORD_0"]["data"].astype("<f4")),
    }
    extension = {
        "bufferView": model.view(data) if view is None else view,
        "attributes": {name: attribute["unique_id"] for name, attribute in found.items()},
    }
    indices = model.accessor(mesh.faces.astype("<u4").reshape(-1, 1))
    model.tree["extensionsUsed"] = model.tree["extensionsRequired"] = [DRACO]
    return {"attributes": attributes, "indices": indices, "extensions": {DRACO: extension}, **more}


def draco_model(colours, **more):
    model = Textured()
    model.mesh(draco_primitive(model, colours, **more))
    return model


def packed_view(model, octets, stride, mode, *, extension="EXT_meshopt_compression", fallback=None, **more):
    """Add a compressed view.

    Parameters
    ----------
    octets : bytes
        What it means, or with a filter what the filter is applied to.
    fallback : bytes, optional
        What it means, for the buffer of those who cannot decode; without it that buffer has no bytes.
    """
    array = np.frombuffer(octets, np.uint8)
    count = len(array) // stride
    if mode == "ATTRIBUTES":
        meshoptimizer.encode_vertex_version(0)
        data = meshoptimizer.encode_vertex_buffer(array.reshape(count, stride), count, stride)
    else:
        indices = array.view(f"<u{stride}").astype(np.uint32)
        encode = meshoptimizer.encode_index_buffer
        encode = encode if mode == "TRIANGLES" else meshoptimizer.encode_index_sequence
        data = encode(indices, count, int(indices.max()) + 1)
    tree = model.tree
    if len(tree["buffers"]) == 1:
        tree["buffers"].append({"byteLength": 0, "extensions": {extension: {"fallback": True}}})
        tree["extensionsUsed"] = tree["extensionsRequired"] = [extension]
        model.fallback = bytearray()
    index = model.view(data)
    place = tree["bufferViews"][index]
    start = tree["buffers"][1]["byteLength"]
    start += -start % 16
    packed = {
        "buffer": 0, "byteOffset": place["byteOffset"], "byteLength": place["byteLength"],
        "byteStride": stride, "count": count, "mode": mode, **more,
    }  # fmt: skip
    tree["bufferViews"][index] = {
        "buffer": 1, "byteOffset": start, "byteLength": len(octets),
        **({"byteStride": stride, "target": 34962} if mode == "ATTRIBUTES" else {"target": 34963}),
        "extensions": {extension: packed},
    }  # fmt: skip
    tree["buffers"][1]["byteLength"] = start + len(octets)
    model.fallback += bytes(start - len(model.fallback)) + (fallback or bytes(len(octets)))
    return index


def packed_attribute(
    model, array, *, filtered=None, filter_name=None, extension="EXT_meshopt_compression", **more
):
    """Add a compressed accessor of vertex data, each element padded to four bytes."""
    array = np.ascontiguousarray(array)
    octets = padded(array if filtered is None else filtered)
    chosen = {} if filter_name is None else {"filter": filter_name}
    view = packed_view(
        model, octets.tobytes(), octets.shape[1], "ATTRIBUTES",
        extension=extension, fallback=padded(array).tobytes(), **chosen,
    )  # fmt: skip
    return model.accessor(array, view, **more)


def padded(array):
    octets = np.ascontiguousarray(array).view(np.uint8).reshape(len(array), -1)
    return np.pad(octets, ((0, 0), (0, -octets.shape[1] % 4)))


def decompressed(tree, buffers):
    """Return the stored numbers of all accessors, whose views are compressed without filters, by the library itself."""
    tree, buffers = json.loads(json.dumps(tree)), list(buffers)
    for view in tree["bufferViews"]:
        for packed in view.get("extensions", {}).values():
            start, count, stride = packed["byteOffset"], packed["count"], packed["byteStride"]
            data = bytes(buffers[packed["buffer"]][start : start + packed["byteLength"]])
            if packed["mode"] == "ATTRIBUTES":
                octets = meshoptimizer.decode_vertex_buffer(
                    count, stride, data, np.dtype(f"V{stride}")
                ).tobytes()
            else:
                octets = meshoptimizer.decode_index_buffer(count, 4, data).astype(f"<u{stride}").tobytes()
            view |= {"buffer": len(buffers), "byteOffset": 0}
            buffers.append(octets)
    return [numbers(tree, buffers, index) for index in range(len(tree["accessors"]))]


def meshopt_model(colours, *, indices="<u2", mode="TRIANGLES", **more):
    """Return a grid with all of its views compressed, its texture too large to be."""
    model = Textured()
    attributes = {
        "POSITION": packed_attribute(model, GRID, bounds=True, **more),
        "COLOR_0": packed_attribute(model, colours, normalized=True, bounds=True, **more),
        "TEXCOORD_0": packed_attribute(model, np.rint(UV * 65535).astype("<u2"), normalized=True, **more),
    }
    corners = CORNERS.astype(indices).reshape(-1, 1)
    view = packed_view(model, corners.tobytes(), corners.itemsize, mode, fallback=corners.tobytes(), **more)
    model.mesh({"attributes": attributes, "indices": model.accessor(corners, view)})
    return model
