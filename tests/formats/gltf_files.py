"""glTF files made byte by byte for tests, and a plain reader that shares no code with the package's."""

from __future__ import annotations

import base64
import json
import struct
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote

import numpy as np

from beltrami_cli.formats.changes import Naming
from beltrami_cli.formats.gltf.document import GltfDocument
from hostile.folders import write

CODES = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}


class Model:
    """A glTF model under construction: its JSON, the bytes of its one buffer, and sidecar `files`."""

    def __init__(self):
        self.tree = {
            "asset": {"version": "2.0", "generator": "tests", "copyright": "© ü"},
            "buffers": [{"byteLength": 0}], "bufferViews": [], "accessors": [], "meshes": [], "nodes": [],
            "scenes": [{"nodes": []}], "scene": 0, "extras": {"kept": [1.50, 2e-3, "a\u2028b"]},
        }  # fmt: skip
        self.binary = bytearray()
        self.files = {}

    def view(self, data, **more):
        self.binary += bytes(-len(self.binary) % 4)
        view = {"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(data), **more}
        self.tree["bufferViews"].append(view)
        self.binary += data
        return len(self.tree["bufferViews"]) - 1

    def accessor(self, array, view=None, *, offset=0, bounds=False, **more):
        """Describe an array (n, width) that lies in a view; zeros if the view is None."""
        array = np.asarray(array)
        accessor = {
            "componentType": CODES[array.dtype.str[1:]],
            "count": len(array),
            "type": TYPES[array.shape[1]],
            **more,
        }
        if view is not None:
            accessor |= {"bufferView": view, "byteOffset": offset}
        if bounds:
            accessor |= {"min": array.min(axis=0).tolist(), "max": array.max(axis=0).tolist()}
        self.tree["accessors"].append(accessor)
        return len(self.tree["accessors"]) - 1

    def packed(self, array, **more):
        """Put an array into a view of its own."""
        return self.interleaved(array, **more)[0]

    def indices(self, array):
        return self.accessor(array.reshape(-1, 1), self.view(array.tobytes()))

    def interleaved(self, *arrays, **more):
        """Put arrays side by side into one view; `more` is for the last of them."""
        arrays, offsets, stride = [*map(np.ascontiguousarray, arrays)], [], 0
        for array in arrays:
            offsets.append(stride)
            stride += -(-array.dtype.itemsize * array.shape[1] // 4) * 4
        octets = np.full((len(arrays[0]), stride), 0xEE, np.uint8)
        for array, start in zip(arrays, offsets, strict=True):
            size = array.dtype.itemsize * array.shape[1]
            octets[:, start : start + size] = array.view(np.uint8).reshape(len(array), size)
        view = self.view(octets.tobytes(), byteStride=stride)
        last = len(arrays) - 1
        return [
            self.accessor(array, view, offset=start, **(more if number == last else {}))
            for number, (array, start) in enumerate(zip(arrays, offsets, strict=True))
        ]

    def sparse(self, array, rows, base, *, bounds=False, **more):
        """Store an array as `base` (None: zeros) with some rows replaced."""
        rows = np.asarray(rows, np.uint16)
        index = self.accessor(array, None, **more) if base is None else self.packed(base, **more)
        if bounds:
            low, high = array.min(axis=0).tolist(), array.max(axis=0).tolist()
            self.tree["accessors"][index] |= {"min": low, "max": high}
        self.tree["accessors"][index]["sparse"] = {
            "count": len(rows),
            "indices": {"bufferView": self.view(rows.tobytes()), "componentType": 5123},
            "values": {"bufferView": self.view(np.ascontiguousarray(array[rows]).tobytes())},
        }
        return index

    def mesh(self, *primitives, node=True, **placed):
        self.tree["meshes"].append({"primitives": list(primitives)})
        if node:
            self.tree["nodes"].append({"mesh": len(self.tree["meshes"]) - 1, **placed})
            self.tree["scenes"][0]["nodes"].append(len(self.tree["nodes"]) - 1)
        return len(self.tree["meshes"]) - 1

    def glb(self, *more_chunks, **style):
        self.tree["buffers"][0] = {"byteLength": len(self.binary)}
        text = json.dumps(self.tree, ensure_ascii=False, **style).encode()
        padded = bytes(self.binary) + bytes(-len(self.binary) % 4)
        chunks = [(b"JSON", text + b" " * (-len(text) % 4)), (b"BIN\0", padded), *more_chunks]
        body = b"".join(struct.pack("<I", len(data)) + kind + data for kind, data in chunks)
        return b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body

    def text(self, uri, **style):
        self.tree["buffers"][0] = {"uri": uri, "byteLength": len(self.binary)}
        return json.dumps(self.tree, ensure_ascii=False, **style).encode()

    def data_text(self, **style):
        return self.text(
            "data:application/gltf-buffer;base64," + base64.b64encode(self.binary).decode(), **style
        )

    def written_to(self, folder, form="glb", *more_chunks, **style):
        """Write the model and its files; return the path of the main file."""
        write(folder, self.files)
        path = folder / ("model.glb" if form == "glb" else "model.gltf")
        if form == "gltf":
            (folder / "model.bin").write_bytes(bytes(self.binary))
            path.write_bytes(self.text("model.bin", **style))
        else:
            path.write_bytes(self.glb(*more_chunks, **style) if form == "glb" else self.data_text(**style))
        return path

    def document(self):
        return GltfDocument(self.glb(), "model.glb", None)


@dataclass
class Coloured:
    """A model, the accessor of its colours, and their stored numbers."""

    model: Model
    colour: int
    stored: np.ndarray


def coloured(arrangement, rng, kind="u1", width=4, *, count=24, bounds=True):
    """Return a mesh whose colours are stored in one of the ways of `ARRANGEMENTS`."""

    def colours():
        if kind == "f4":
            return rng.random((count, width)).astype("<f4")
        return rng.integers(0, np.iinfo(kind).max + 1, (count, width)).astype(f"<{kind}")

    model, stored = Model(), colours()
    model.view(b"\x89PNG image, opaque")
    more = {"bounds": bounds} | ({"normalized": True} if kind != "f4" else {})
    places = rng.normal(size=(count, 3)).astype("<f4")
    if arrangement == "interleaved":
        normals = np.tile(np.array([0, 0, 1], "<f4"), (count, 1))
        position, normal, colour = model.interleaved(places, normals, stored, **more)
        attributes = {"POSITION": position, "NORMAL": normal}
    else:
        attributes = {"POSITION": model.packed(places, bounds=True)}
        if arrangement.startswith("sparse"):
            base = None if "zeros" in arrangement else colours()
            rows = np.flatnonzero(rng.random(count) < 0.5)
            rows = rows if len(rows) else np.array([0])
            full = np.zeros_like(stored) if base is None else base.copy()
            full[rows] = stored[rows]
            stored = full
            colour = model.sparse(stored, rows, base, **more)
        elif arrangement == "zeros":
            stored = np.zeros_like(stored)
            colour = model.accessor(stored, None, **more)
        else:
            colour = model.packed(stored, **more)
    attributes["COLOR_0"] = colour
    if arrangement == "shared":
        attributes["_KEPT"] = colour
    accessors = model.tree["accessors"]
    if arrangement == "overlapping":
        part = accessors[colour] | {"count": count - 1}
        accessors.append({key: part[key] for key in part if key not in ("min", "max")})
        attributes["_KEPT"] = len(accessors) - 1
    primitives = [{"attributes": attributes}]
    if arrangement == "twice":  # with an accessor of its own for the same colours
        accessors.append(dict(accessors[colour]))
        primitives.append({"attributes": attributes | {"COLOR_0": len(accessors) - 1}})
    model.mesh(*primitives)
    return Coloured(model, colour, stored)


ARRANGEMENTS = (
    "dense", "interleaved", "sparse", "sparse on zeros", "zeros", "shared", "overlapping", "twice"
)  # fmt: skip


def unpacked(data, files=None):
    """Return the tree and the buffers of a glTF file, GLB or text, the slow and plain way."""
    if data[:4] == b"glTF":
        size = struct.unpack_from("<I", data, 12)[0]
        tree, rest = json.loads(data[20 : 20 + size]), data[20 + size :]
        assert struct.unpack_from("<I", data, 8)[0] == len(data)
        binary = rest[8 : 8 + struct.unpack_from("<I", rest)[0]] if rest else b""
    else:
        tree, binary = json.loads(data.decode("utf-8-sig")), b""
    buffers = []
    for buffer in tree.get("buffers", []):
        uri = buffer.get("uri")
        if uri is None:
            if len(buffers):  # only the first is in the chunk; others stand for compressed data
                buffers.append(None)
                continue
            octets = binary
        elif uri.startswith("data:"):
            octets = base64.b64decode(uri.split(",")[1])
        else:
            octets = bytes((files or {})[uri if uri in (files or {}) else unquote(uri)])
        assert len(octets) >= buffer["byteLength"]
        buffers.append(octets)
    return tree, buffers


def opened(path):
    """Return the tree and the buffers of a file, and its sidecar files by the URIs that may name them."""
    path = Path(path)
    files = {file.relative_to(path.parent).as_posix(): file.read_bytes() for file in path.parent.rglob("*.*")}
    files |= {name.replace(" ", "%20"): data for name, data in files.items()}
    return *unpacked(path.read_bytes(), files), files


def numbers(tree, buffers, index):
    """Return the stored numbers of an accessor, element by element."""
    accessor = tree["accessors"][index]
    kind = "<" + next(name for name, code in CODES.items() if code == accessor["componentType"])
    width = next(width for width, name in TYPES.items() if name == accessor["type"])

    def read(part, kind, width, count):
        view = tree["bufferViews"][part["bufferView"]]
        size = np.dtype(kind).itemsize * width
        start, stride = view.get("byteOffset", 0) + part.get("byteOffset", 0), view.get("byteStride", size)
        data = buffers[view["buffer"]]
        return np.array([np.frombuffer(data, kind, width, start + row * stride) for row in range(count)])

    count = accessor["count"]
    found = read(accessor, kind, width, count) if "bufferView" in accessor else np.zeros((count, width), kind)
    if "sparse" in accessor:
        sparse = accessor["sparse"]
        code = sparse["indices"]["componentType"]
        index_kind = "<" + next(name for name, other in CODES.items() if other == code)
        rows = read(sparse["indices"], index_kind, 1, sparse["count"])[:, 0]
        found[rows] = read(sparse["values"], kind, width, sparse["count"])
    return found


def joined(written):
    """Return the main file of a `Written`."""
    return b"".join(bytes(piece) for piece in written.main)


def patched(document, colours):
    """Return the main file of a document of any format with other colours; None: the present ones."""
    new = None if colours is None else np.asarray(colours, np.float32)
    return joined(document.patch(new, Naming("out")))


PNG, JPEG, WEBP, KTX2 = b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff\xe0", b"RIFF\0\0\0\0WEBP", b"\xabKTX 20\xbb"


def picture(number, head=PNG, size=50):
    """Return what looks like an image file to whoever does not decode it."""
    return head + np.random.default_rng(number).integers(1, 256, size).astype(np.uint8).tobytes()


def data_uri(data, media="image/png"):
    return f"data:{media};base64,{base64.b64encode(data).decode()}"


class Textured(Model):
    """A model with materials under construction; `place` says how images are stored."""

    def __init__(self, place="view"):
        super().__init__()
        self.place = place
        self.tree |= {"images": [], "textures": [], "materials": [], "samplers": []}

    def image(self, data, name="a b.png", media="image/png"):
        image = {"name": name}
        if self.place == "view":
            image |= {"bufferView": self.view(data), "mimeType": media}
        elif self.place == "data":
            image["uri"] = data_uri(data, media)
        else:
            image["uri"] = "maps/" + name.replace(" ", "%20")
            self.files["maps/" + name] = data
        return self._add("images", image)

    def texture(self, image, *, wrap=None, **more):
        texture = {} if image is None else {"source": image}
        if wrap is not None:
            texture["sampler"] = self._add("samplers", {"wrapS": wrap[0], "wrapT": wrap[1]})
        return self._add("textures", texture | more)

    def material(self, name=None, **slots):
        material = {} if name is None else {"name": name}
        for slot, info in slots.items():
            holder = material
            for key in SLOT_PATHS[slot][:-1]:
                holder = holder.setdefault(key, {})
            holder[SLOT_PATHS[slot][-1]] = {"index": info} if isinstance(info, int) else info
        return self._add("materials", material)

    def triangles(self, positions, uv=None, material=None, *, corners=None, mode=None, **placed):
        """Add a mesh of one primitive; `uv` is an array, or a dict of attributes."""
        attributes = {"POSITION": self.packed(np.asarray(positions, "<f4"))}
        if isinstance(uv, dict):
            attributes |= uv
        elif uv is not None:
            attributes["TEXCOORD_0"] = self.packed(np.asarray(uv, "<f4"))
        primitive = {"attributes": attributes}
        primitive |= {} if material is None else {"material": material}
        primitive |= {} if mode is None else {"mode": mode}
        primitive |= {} if corners is None else {"indices": self.indices(np.asarray(corners, "<u2"))}
        return self.mesh(primitive, **placed)

    def _add(self, key, value):
        self.tree[key].append(value)
        return len(self.tree[key]) - 1


SLOT_PATHS = {
    "baseColor": ("pbrMetallicRoughness", "baseColorTexture"),
    "diffuse": ("extensions", "KHR_materials_pbrSpecularGlossiness", "diffuseTexture"),
    "emissive": ("emissiveTexture",),
    "normal": ("normalTexture",),
    "occlusion": ("occlusionTexture",),
    "metallicRoughness": ("pbrMetallicRoughness", "metallicRoughnessTexture"),
    "clearcoat": ("extensions", "KHR_materials_clearcoat", "clearcoatTexture"),
}
