"""Meshes and images to files that beltrami reads, and their new colours back.

A model goes out as PLY with colours of its vertices, or with image files and the texture coordinates of its corners;
byte images as PNG and float images as EXR, which keep every value.
"""

import re
from pathlib import Path

import bpy
import numpy as np

_FACES = [("corners", "u1"), ("vertex", "<i4", 3)]
_TEXTURED = [*_FACES, ("numbers", "u1"), ("uv", "<f4", 6), ("texture", "<i4")]
_FACE_LINES = ["property list uchar int vertex_indices"]
_UV_LINES = ["property list uchar float texcoord", "property int texnumber"]
_TEXTURE_COMMENT = re.compile(rb"comment TextureFile ([^\r\n]+)")
_FIRST_TILE, _TILES_A_ROW = 1001, 10
_USUAL_SHARE = 0.99  # of the light other than 0: single spikes of a renderer say nothing of the range


class ExchangeError(Exception):
    """The request cannot be fulfilled, for the reason in the text."""


def _full_scale(colours):
    """Return what few of the colours exceed, but 1 at least."""
    light = colours[colours > 0]
    return max(1.0, float(np.quantile(light, _USUAL_SHARE, method="higher"))) if light.size else 1.0


def _numbers(items, name, width, kind):
    values = np.empty(len(items) * width, kind)
    items.foreach_get(name, values)
    return values.reshape(-1, width) if width > 1 else values


def _positions(mesh, matrix):
    """Return positions in world space, so that object scale counts."""
    places = _numbers(mesh.vertices, "co", 3, np.float32).astype(np.float64)
    matrix = np.array(matrix)
    return (places @ matrix[:3, :3].T + matrix[:3, 3]).astype("<f4")


def _triangles(mesh):
    mesh.calc_loop_triangles()
    triangles = mesh.loop_triangles
    return (
        _numbers(triangles, "vertices", 3, np.int32),
        _numbers(triangles, "loops", 3, np.int32),
        _numbers(triangles, "material_index", 1, np.int32),
    )


def _write_ply(path, positions, colours, faces, textures=()):
    """Write a binary PLY file; `colours` are uint8 or float, RGBA, or None."""
    rows = [("place", "<f4", 3)]
    lines = ["ply", "format binary_little_endian 1.0", *(f"comment TextureFile {name}" for name in textures)]
    lines += [f"element vertex {len(positions)}", *(f"property float {axis}" for axis in "xyz")]
    if colours is not None:
        kind, word = ("u1", "uchar") if colours.dtype == np.uint8 else ("<f4", "float")
        rows.append(("colour", kind, 4))
        lines += [f"property {word} {name}" for name in ("red", "green", "blue", "alpha")]
    table = np.zeros(len(positions), rows)
    table["place"] = positions
    if colours is not None:
        table["colour"] = colours
    lines += [f"element face {len(faces)}", *_FACE_LINES, *(_UV_LINES if textures else ()), "end_header\n"]
    path.write_bytes("\n".join(lines).encode() + table.tobytes() + faces.tobytes())


class ColourAttribute:
    """The active colour attribute of a mesh, of vertices or of corners, as vertex colours of a PLY file."""

    def __init__(self, item, folder):
        mesh, attribute = item.data, item.data.color_attributes.active_color
        if attribute is None:
            raise ExchangeError(f"{item.name} has no colour attribute")
        self._mesh, self._name, self.is_data, self.images = mesh.name, attribute.name, False, []
        stored = _numbers(attribute.data, "color_srgb", 4, np.float32)
        self._is_byte = attribute.data_type == "BYTE_COLOR"
        vertices, loops, _ = _triangles(mesh)
        of_row = np.arange(len(mesh.vertices))
        corners = vertices
        self._row_of = None
        if attribute.domain == "CORNER":
            # A vertex of one colour is one row of the file; where its corners differ, each colour has a row.
            owner = _numbers(mesh.loops, "vertex_index", 1, np.int32)
            keys = np.column_stack([owner.astype(np.float32).view(np.int32), stored.view(np.int32)])
            keys[:, 0] = owner
            _, first, self._row_of = np.unique(keys, axis=0, return_index=True, return_inverse=True)
            self._row_of = self._row_of.reshape(-1)
            of_row, stored, corners = owner[first], stored[first], self._row_of[loops]
        self._before = stored
        self._scale = 1.0 if self._is_byte else _full_scale(stored[:, :3])
        scaled = stored / np.array([self._scale] * 3 + [1], np.float32)
        colours = np.rint(scaled * 255).astype(np.uint8) if self._is_byte else scaled
        faces = np.zeros(len(corners), _FACES)
        faces["corners"], faces["vertex"] = 3, corners
        _write_ply(folder / "in.ply", _positions(mesh, item.matrix_world)[of_row], colours, faces)
        self._colours, self._folder = colours, folder

    def take(self):
        """Give the mesh the new colours; unchanged ones keep their bits."""
        data = (self._folder / "out.ply").read_bytes()
        body = data[data.index(b"end_header\n") + len(b"end_header\n") :]
        kind = "u1" if self._is_byte else "<f4"
        table = np.frombuffer(body, [("place", "<f4", 3), ("colour", kind, 4)], len(self._before))
        new = table["colour"].astype(np.float32) / (255 if self._is_byte else 1)
        new[:, :3] *= self._scale
        new = np.where(table["colour"] == self._colours, self._before, new).astype(np.float32)
        if self._row_of is not None:
            new = new[self._row_of]
        mesh = bpy.data.meshes[self._mesh]
        mesh.color_attributes[self._name].data.foreach_set("color_srgb", new.ravel())
        mesh.update()


class ImageTextures:
    """The images of the materials of an object, tiles too, as textures of a PLY file."""

    def __init__(self, item, folder):
        mesh, self._folder = item.data, folder
        vertices, loops, material_of = _triangles(mesh)
        shown = [_shown_image(slot.material) for slot in item.material_slots] or [None]
        self.images = list(dict.fromkeys(image for image, _ in filter(None, shown)))
        if not self.images:
            raise ExchangeError(f"no material of {item.name} has an image texture")
        self.is_data = all(image.colorspace_settings.name == "Non-Color" for image in self.images)
        if not self.is_data:
            self.images = [i for i in self.images if i.colorspace_settings.name != "Non-Color"]
        self._files, number_of = [], {}
        for image in self.images:
            for tile, path in _written(image, folder, len(number_of)):
                number_of[image.name, tile] = len(self._files)
                self._files.append((image.name, tile, path.name))
        faces = np.zeros(len(vertices), _TEXTURED)
        faces["corners"], faces["vertex"], faces["numbers"], faces["texture"] = 3, vertices, 6, -1
        for index, use in enumerate(shown):
            if use is None or use[0] not in self.images:
                continue
            chosen = np.flatnonzero(np.clip(material_of, 0, len(shown) - 1) == index)
            uv = _coordinates(mesh, use[1])[loops[chosen]]
            tiles = np.zeros((len(chosen), 1, 2), np.float32)
            numbers = np.full(len(chosen), number_of.get((use[0].name, 0), -1))
            if use[0].source == "TILED":
                tiles = np.floor(uv.mean(axis=1, keepdims=True))
                tile = (_FIRST_TILE + tiles @ [1, _TILES_A_ROW]).astype(int).ravel()
                numbers = np.array([number_of.get((use[0].name, each), -1) for each in tile.tolist()])
            faces["uv"][chosen], faces["texture"][chosen] = (uv - tiles).reshape(-1, 6), numbers
        names = [name for _, _, name in self._files]
        _write_ply(folder / "in.ply", _positions(mesh, item.matrix_world), None, faces, names)

    def take(self):
        """Replace the pixels tile by tile; return the previous pixels of images with a single tile."""
        head = (self._folder / "out.ply").read_bytes().partition(b"end_header")[0]
        names = [name.decode() for name in _TEXTURE_COMMENT.findall(head)]
        new = {(image, tile): name for (image, tile, _), name in zip(self._files, names, strict=True)}
        before = {}
        for (name, tile), file in new.items():
            image = bpy.data.images[name]
            if not tile:
                before[name] = pixels_of(image)
                set_pixels(image, _loaded(self._folder / file))
        for name in dict.fromkeys(name for name, tile in new if tile):
            tiles = {tile: self._folder / file for (each, tile), file in new.items() if each == name}
            _set_tiles(bpy.data.images[name], tiles)
        return before


def _shown_image(material):
    """Return the image of a material and the name of its texture coordinates: the active one, or the base colour's."""
    if material is None or material.node_tree is None:
        return None
    nodes = [node for node in material.node_tree.nodes if node.type == "TEX_IMAGE" and node.image is not None]
    if not nodes:
        return None
    active = material.node_tree.nodes.active
    base = [
        node
        for node in nodes
        if "Base Color" in [link.to_socket.name for link in node.outputs["Color"].links]
    ]
    node = active if active in nodes else next(iter(base), nodes[0])
    sources = [link.from_node for link in node.inputs["Vector"].links]
    layer = next((source.uv_map for source in sources if source.type == "UVMAP"), "")
    return node.image, layer


def _coordinates(mesh, layer):
    found = mesh.uv_layers.get(layer) if layer else None
    found = found or next((each for each in mesh.uv_layers if each.active_render), None)
    if found is None:
        raise ExchangeError(f"{mesh.name} has no UV map")
    return _numbers(found.uv, "vector", 2, np.float32)


def pixels_of(image):
    """Return the pixels as they are kept, shape (H, W, C), the lowest row first."""
    width, height = image.size
    values = np.empty(width * height * image.channels, np.float32)
    if not len(values):
        raise ExchangeError(f"the image {image.name} cannot be read")
    image.pixels.foreach_get(values)
    return values.reshape(height, width, image.channels)


def set_pixels(image, pixels):
    """Give an image new pixels; a packed one is packed again, without loss."""
    values = pixels_of(image)
    values[...] = pixels[..., : image.channels]
    image.pixels.foreach_set(values.ravel())
    image.update()
    if image.packed_file is not None:
        image.pack()


def _take_as_they_are(image):
    image.colorspace_settings.name = "Non-Color"
    image.alpha_mode = "CHANNEL_PACKED"


def _save(pixels, path, form, *, is_float):
    height, width, channels = pixels.shape
    filled = np.ones((height, width, 4), np.float32)
    filled[..., :channels] = pixels
    made = bpy.data.images.new("beltrami", width, height, alpha=True, float_buffer=is_float)
    _take_as_they_are(made)
    try:
        made.pixels.foreach_set(filled.ravel())
        made.filepath_raw, made.file_format = str(path), form
        made.save()
    finally:
        bpy.data.images.remove(made)


def _loaded(path):
    image = bpy.data.images.load(str(path))
    try:
        _take_as_they_are(image)
        return pixels_of(image)
    finally:
        bpy.data.images.remove(image)


def _written(image, folder, number):
    """Write an image, or every tile of it, to files; give the number of the tile, 0 for none, and the path."""
    if image.source != "TILED":
        path = folder / f"{number}{'.exr' if image.is_float else '.png'}"
        _save(pixels_of(image), path, "OPEN_EXR" if image.is_float else "PNG", is_float=image.is_float)
        yield 0, path
        return
    # Only the first tile can be reached by its pixels; a copy of all on disk has the new pixels, too.
    tiles = folder / f"tiles{number}"
    tiles.mkdir()
    suffix = Path(bpy.path.abspath(image.filepath_raw)).suffix or (".exr" if image.is_float else ".png")
    save_copy(image, tiles / f"tile.<UDIM>{suffix}")
    for source in sorted(tiles.iterdir()):
        tile = int(source.name.split(".")[1])
        path = folder / f"{number}-{tile}{'.exr' if image.is_float else '.png'}"
        _save(_loaded(source), path, "OPEN_EXR" if image.is_float else "PNG", is_float=image.is_float)
        yield tile, path


def save(image):
    """Save an image that lies on disk where it lies."""
    if image.is_float and image.file_format == "OPEN_EXR":  # which Blender 4.2 would encode as sRGB
        _save(pixels_of(image), bpy.path.abspath(image.filepath), "OPEN_EXR", is_float=True)
        image.reload()
    else:
        image.save()


def save_copy(image, path):
    """Write an image, all tiles of it, and let it mean the file that it meant before."""
    stored_path = image.filepath_raw
    try:
        image.save(filepath=str(path), save_copy=True)
    except TypeError:  # before Blender 4.3
        image.save(filepath=str(path))
        image.filepath_raw = stored_path


def _set_tiles(image, tiles):
    """Write new tiles to the files of an image and read them again; packed ones stay packed."""
    stored_path, is_packed = image.filepath_raw, bool(image.packed_files)
    place = bpy.path.abspath(stored_path)
    if is_packed or "<UDIM>" not in place:
        place = str(next(iter(tiles.values())).parent / f"new.<UDIM>{'.exr' if image.is_float else '.png'}")
    form = image.file_format if not is_packed else ("OPEN_EXR" if image.is_float else "PNG")
    for tile, path in tiles.items():
        _save(_loaded(path), place.replace("<UDIM>", str(tile)), form, is_float=image.is_float)
    if is_packed:
        image.unpack(method="REMOVE")
    image.filepath_raw = stored_path if place == bpy.path.abspath(stored_path) else place
    image.reload()
    if is_packed:
        image.pack()
        image.filepath_raw = stored_path
