"""The arrays of meshes of trimesh, PyVista and Open3D."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from beltrami_cli.arrays import Array
from beltrami_cli.errors import UsageError
from beltrami_cli.jobs.arrays.arguments import image_array

# Positions, triangles and colours of a TriangleMesh and a PointCloud of Open3D, and where tensor-based ones have them.
_OPEN3D = (("vertices", "triangles", "vertex_colors"), ("points", "", "colors"))
_OPEN3D_TENSORS = (("vertex", "triangle"), ("point", ""))


class MeshArrays(NamedTuple):
    """A mesh, or a cloud of points, as arrays.

    Attributes
    ----------
    positions : array_like, shape (V, 3)
    faces : array_like of int, shape (F, 3), or None
        Triangles as vertex indices; None: points.
    colours : array_like, shape (V, 3) or (V, 4), or None
        Colours of vertices; the fourth channel is opacity.
    uv : array_like, shape (V, 2) or (F, 3, 2), or None
        Texture coordinates of vertices, or of the corners of faces.
    image : array_like, shape (H, W) or (H, W, C), or None
        The texture, row 0 the upper one.
    """

    positions: ArrayLike
    faces: ArrayLike | None = None
    colours: ArrayLike | None = None
    uv: ArrayLike | None = None
    image: ArrayLike | None = None


def mesh_arrays(mesh: Any) -> MeshArrays | None:
    """Return the arrays of a mesh of trimesh, PyVista or Open3D, by its attributes; None if it is none of these."""
    if isinstance(mesh, MeshArrays):
        return mesh
    if hasattr(mesh, "visual") or hasattr(mesh, "geometry"):
        return _of_trimesh(mesh)
    return _of_pyvista(mesh) if hasattr(mesh, "point_data") else _of_open3d(mesh)


def _of_trimesh(mesh: Any) -> MeshArrays:
    """Return the arrays of a Trimesh or PointCloud: colours of vertices, or texture coordinates and the base colour."""
    visual, faces = getattr(mesh, "visual", None), getattr(mesh, "faces", None)
    if visual is None:
        kind = type(mesh).__name__
        raise UsageError(
            f"{kind} is neither a Trimesh nor a PointCloud; give the meshes of a scene one by one"
        )
    if visual.kind == "face":
        raise UsageError("the mesh has colours of faces; set mesh.visual.vertex_colors")
    arrays = MeshArrays(np.asarray(mesh.vertices), None if faces is None else np.asarray(faces))
    if visual.kind != "texture":
        is_coloured = visual.kind == "vertex" and len(visual.vertex_colors)
        return arrays._replace(colours=np.asarray(visual.vertex_colors) if is_coloured else None)
    if hasattr(visual.material, "materials"):
        raise UsageError("the mesh has several materials; give smooth_textured images and texture_of")
    image = getattr(visual.material, "baseColorTexture", getattr(visual.material, "image", None))
    return arrays._replace(uv=visual.uv, image=None if image is None else image_array(image, "image"))


def _of_pyvista(mesh: Any) -> MeshArrays:
    padded = np.asarray(getattr(mesh, "faces", [0]))  # each face: its number of corners, and these
    if len(padded) % 4 or (padded[::4] != 3).any() or mesh.n_strips:
        raise UsageError("the mesh is not a PolyData of triangles; call extract_surface().triangulate()")
    active_first = sorted(mesh.point_data.keys(), key=lambda name: name != mesh.active_scalars_name)
    tables = (np.asarray(mesh.point_data[name]) for name in active_first)
    shades = (table for table in tables if table.dtype == np.uint8 and table.shape[1:] in ((3,), (4,)))
    faces = padded.reshape(-1, 4)[:, 1:] if len(padded) else None
    return MeshArrays(np.asarray(mesh.points), faces, next(shades, None))


def _of_open3d(mesh: Any) -> MeshArrays | None:
    for names in _OPEN3D:
        if hasattr(mesh, names[0]) and hasattr(mesh, names[2]):
            places, faces, colours = (np.asarray(getattr(mesh, name, [])) for name in names)
            return MeshArrays(places, faces if len(faces) else None, colours if len(colours) else None)
    for of_vertices, of_faces in _OPEN3D_TENSORS:
        vertices, triangles = getattr(mesh, of_vertices, {}), getattr(mesh, of_faces, {})
        if "positions" in vertices:
            return MeshArrays(
                positions=vertices["positions"].cpu().numpy(), faces=_from_tensor(triangles, "indices"),
                colours=_from_tensor(vertices, "colors"), uv=_from_tensor(triangles, "texture_uvs"),
            )  # fmt: skip
    return None


def _from_tensor(table: Any, key: str) -> Array | None:
    """Return a tensor of Open3D, which may be on a graphics card, as an array; None if it is not there."""
    return table[key].cpu().numpy() if key in table else None
