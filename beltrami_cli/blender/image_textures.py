"""The image textures of an object to files, and their new pixels back."""

import re

import bpy
import numpy as np

from . import images, meshes
from .errors import ExtensionError

_TEXTURE_COMMENT = re.compile(rb"comment TextureFile ([^\r\n]+)")
_FIRST_TILE, _TILES_A_ROW = 1001, 10


class ImageTextures:
    """The images of the materials of an object, tiles too, as textures of a PLY file."""

    def __init__(self, item, folder):
        mesh, self._folder = item.data, folder
        vertices, loops, material_of = meshes.triangles_of(mesh)
        shown = [_shown_image(slot.material) for slot in item.material_slots] or [None]
        self.images = list(dict.fromkeys(image for image, _ in filter(None, shown)))
        if not self.images:
            raise ExtensionError(f"no material of {item.name} has an image texture")
        self.is_data = all(image.colorspace_settings.name == "Non-Color" for image in self.images)
        if not self.is_data:
            self.images = [i for i in self.images if i.colorspace_settings.name != "Non-Color"]
        self._files, number_of = [], {}
        for image in self.images:
            for tile, path in images.write_tiles(image, folder, len(number_of)):
                number_of[image.name, tile] = len(self._files)
                self._files.append((image.name, tile, path.name))
        faces = np.zeros(len(vertices), meshes.TEXTURED_FACE)
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
        meshes.write_ply(folder / "in.ply", meshes.positions_of(mesh, item.matrix_world), None, faces, names)

    def take(self):
        """Replace the pixels tile by tile; return the previous pixels of images with a single tile."""
        head = (self._folder / "out.ply").read_bytes().partition(b"end_header")[0]
        names = [name.decode() for name in _TEXTURE_COMMENT.findall(head)]
        new = {(image, tile): name for (image, tile, _), name in zip(self._files, names, strict=True)}
        before = {}
        for (name, tile), file in new.items():
            image = bpy.data.images[name]
            if not tile:
                before[name] = images.pixels_of(image)
                images.set_pixels(image, images.load_pixels(self._folder / file))
        for name in dict.fromkeys(name for name, tile in new if tile):
            tiles = {tile: self._folder / file for (each, tile), file in new.items() if each == name}
            images.set_tiles(bpy.data.images[name], tiles)
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
        raise ExtensionError(f"{mesh.name} has no UV map")
    return meshes.numbers(found.uv, "vector", 2, np.float32)
