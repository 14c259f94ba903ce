"""The colour attribute of a mesh to a file, and its new colours back."""

import bpy
import numpy as np

from . import meshes
from .errors import ExtensionError

_USUAL_SHARE = 0.99  # of the light other than 0: single spikes of a renderer say nothing of the range


class ColourAttribute:
    """The active colour attribute of a mesh, of vertices or of corners, as vertex colours of a PLY file."""

    def __init__(self, item, folder):
        mesh, attribute = item.data, item.data.color_attributes.active_color
        if attribute is None:
            raise ExtensionError(f"{item.name} has no colour attribute")
        self._mesh, self._name, self.is_data, self.images = mesh.name, attribute.name, False, []
        stored = meshes.numbers(attribute.data, "color_srgb", 4, np.float32)
        self._is_byte = attribute.data_type == "BYTE_COLOR"
        vertices, loops, _ = meshes.triangles_of(mesh)
        of_row = np.arange(len(mesh.vertices))
        corners = vertices
        self._row_of = None
        if attribute.domain == "CORNER":
            # A vertex of one colour is one row of the file; where its corners differ, each colour has a row.
            owner = meshes.numbers(mesh.loops, "vertex_index", 1, np.int32)
            keys = np.column_stack([owner.astype(np.float32).view(np.int32), stored.view(np.int32)])
            keys[:, 0] = owner
            _, first, self._row_of = np.unique(keys, axis=0, return_index=True, return_inverse=True)
            self._row_of = self._row_of.reshape(-1)
            of_row, stored, corners = owner[first], stored[first], self._row_of[loops]
        self._before = stored
        self._scale = 1.0 if self._is_byte else _full_scale(stored[:, :3])
        scaled = stored / np.array([self._scale] * 3 + [1], np.float32)
        colours = np.rint(scaled * 255).astype(np.uint8) if self._is_byte else scaled
        faces = np.zeros(len(corners), meshes.FACE)
        faces["corners"], faces["vertex"] = 3, corners
        meshes.write_ply(
            folder / "in.ply", meshes.positions_of(mesh, item.matrix_world)[of_row], colours, faces
        )
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


def _full_scale(colours):
    """Return what few of the colours exceed, but 1 at least."""
    light = colours[colours > 0]
    return max(1.0, float(np.quantile(light, _USUAL_SHARE, method="higher"))) if light.size else 1.0
