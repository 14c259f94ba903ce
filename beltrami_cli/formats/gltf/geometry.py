"""Where meshes stand and what their primitives draw: nodes followed to one place for each mesh, and triangles."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Bools, Float64s, Int64s
from beltrami_cli.formats.gltf.accessors import Accessors
from beltrami_cli.formats.gltf.compression import draco_extension
from beltrami_cli.formats.gltf.json_tree import Entry
from beltrami_cli.surface.geometry import unit_vectors, unrolled

TRIANGLES, STRIP, FAN = 4, 5, 6  # drawing modes with faces; 0 to 3 are points and lines


@dataclass(frozen=True)
class Placement:
    """Where a mesh is taken to be."""

    matrix: Float64s  # (4, 4), from the mesh's own space to the common one; acts on columns
    # 0: the default scene (all scenes, if none is); each other scene and unplaced mesh has its own.
    space: int
    nodes: int  # how many nodes show the mesh, in all scenes


def placements(root: Entry) -> list[Placement]:
    """Return the place of every mesh: its first node, depth first, the default scene before the others."""
    scenes = root.entries("scenes")
    default = root.integer("scene", below=len(scenes)) if "scene" in root else None
    order = sorted(range(len(scenes)), key=lambda scene: scene != default)
    shown: dict[int, list[tuple[Float64s, int]]] = {}
    for rank, mesh, place, _ in _shown(root, [scenes[scene] for scene in order]):
        shown.setdefault(mesh, []).append((place, 0 if default is None else rank))
    found = []
    for mesh in range(len(root.entries("meshes"))):
        places = shown.get(mesh) or [(np.eye(4), len(scenes) + mesh)]
        found.append(Placement(*places[0], nodes=len(places)))
    return found


def instances(root: Entry) -> list[tuple[int, Placement, str]]:
    """Return every mesh that a node of the default scene shows (of all scenes, if none is), its place and its name."""
    meshes, scenes = root.entries("meshes"), root.entries("scenes")
    chosen = [scenes[root.integer("scene", below=len(scenes))]] if "scene" in root else scenes
    return [
        (mesh, Placement(place, 0, 1), node.text("name") or meshes[mesh].text("name") or "")
        for _, mesh, place, node in _shown(root, chosen)
    ]


def _shown(root: Entry, scenes: Sequence[Entry]) -> Iterator[tuple[int, int, Float64s, Entry]]:
    """Give the number of a scene, the mesh that a node of it shows, where, and the node."""
    # A node with a skin counts as untransformed: joints place the mesh, and its stored positions are the bind pose.
    nodes, meshes = root.entries("nodes"), root.entries("meshes")
    children, seen = _children(nodes), set[int]()
    for number, scene in enumerate(scenes):
        for index, matrix in _walk(scene, nodes, children, seen):
            node = nodes[index]
            if "mesh" in node:
                mesh = node.integer("mesh", below=len(meshes))
                yield number, mesh, np.eye(4) if "skin" in node else matrix, node


def _children(nodes: list[Entry]) -> list[list[int]]:
    parent: dict[int, int] = {}
    children = []
    for index, node in enumerate(nodes):
        children.append(node.integers("children", below=len(nodes)))
        for child in children[-1]:
            if child in parent:
                raise node.fault("children", f"nodes[{child}] has another parent, nodes[{parent[child]}]")
            parent[child] = index
    return children


def _walk(
    scene: Entry, nodes: list[Entry], children: list[list[int]], seen: set[int]
) -> list[tuple[int, Float64s]]:
    """Return the nodes of a scene that are not seen yet, depth first, each with its matrix; they are then seen."""
    found: list[tuple[int, Float64s]] = []
    stack = [(node, np.eye(4)) for node in reversed(scene.integers("nodes", below=len(nodes)))]
    met: set[int] = set()
    while stack:
        node, above = stack.pop()
        if node in met:
            raise scene.fault("nodes", f"nodes[{node}] is reached twice: the nodes are not a tree")
        met.add(node)
        if node in seen:
            continue
        seen.add(node)
        with np.errstate(over="ignore", invalid="ignore"):
            matrix = above @ _local(nodes[node])
        if not np.isfinite(matrix).all():
            raise nodes[node].fault("", "its transform is too large to compute with")
        found.append((node, matrix))
        stack += [(child, matrix) for child in reversed(children[node])]
    return found


def _local(node: Entry) -> Float64s:
    """Return a node's own transform: its matrix, or translation times rotation times scale."""
    columns = node.numbers("matrix", 16)
    if columns is not None:
        return np.array(columns).reshape(4, 4).T
    matrix = np.eye(4)
    matrix[:3, :3] = _rotation(node) * np.array(node.numbers("scale", 3) or [1.0, 1.0, 1.0])
    matrix[:3, 3] = node.numbers("translation", 3) or [0.0, 0.0, 0.0]
    return matrix


def _rotation(node: Entry) -> Float64s:
    quaternion = node.numbers("rotation", 4)
    if quaternion is None:
        return np.eye(3)
    largest = max(abs(value) for value in quaternion)
    if largest == 0:
        raise node.fault("rotation", "is a quaternion of length zero")
    scaled = np.array(quaternion) / largest
    x, y, z, w = scaled / np.linalg.norm(scaled)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def in_world(
    placement: Placement, accessors: Accessors, index: int, used: slice | Bools = slice(None)
) -> Float64s:
    """Return all or the used positions of an accessor, shape (n, 3), in the common space."""
    positions, matrix = accessors.values(index)[used], placement.matrix
    with np.errstate(over="ignore", invalid="ignore"):
        moved: Float64s = positions @ matrix[:3, :3].T + matrix[:3, 3]
    if not np.isfinite(moved).all():
        raise accessors[index].entry.fault("", "positions overflow in world space")
    return moved


def turned(normals: Float64s, matrix: Float64s) -> Float64s:
    """Return unit normals, shape (n, 3), in the common space; zero vectors stay zero."""
    a, b, c = matrix[:3, :3].T
    # The cofactor matrix is the inverse transpose times the determinant, and exists for flat scales too.
    cofactors = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)
    sign = -1.0 if a @ cofactors[:, 0] < 0 else 1.0
    return unit_vectors(normals @ (sign * cofactors).T)


def attribute_accessor(primitive: Entry, name: str, accessors: Accessors) -> int:
    """Return the accessor of an attribute, the decoded one if the primitive is compressed."""
    index = primitive.entry("attributes").integer(name, below=len(accessors))
    packed = draco_extension(primitive)
    if packed is None or name not in packed.entry("attributes"):
        return index
    return accessors.decoded_attribute(packed, name, index)


def fitting_accessor(primitive: Entry, name: str, accessors: Accessors, shape: str, count: int) -> int:
    """Return the accessor of an attribute, which must have so many elements of a shape, and no large integers."""
    index = attribute_accessor(primitive, name, accessors)
    accessor = accessors[index]
    if (accessor.shape, accessor.count) != (shape, count) or accessor.component.name == "uint32":
        cause = f"is {accessor.count} {accessor.shape} of {accessor.component.name}, not {count} {shape}"
        raise primitive.entry("attributes").fault(name, cause)
    return index


def position_accessor(primitive: Entry, accessors: Accessors) -> int:
    """Return the accessor of positions, whose bytes are there."""
    index = attribute_accessor(primitive, "POSITION", accessors)
    accessor = accessors[index]
    if accessor.shape != "VEC3" or accessor.component.name == "uint32":
        cause = f"is {accessor.shape} of {accessor.component.name}, not a position"
        raise primitive.entry("attributes").fault("POSITION", cause)
    accessors.require_bytes(index)
    return index


def drawing_mode(primitive: Entry) -> int:
    """Return the drawing mode of the indices: triangles if it is not said, or if strips were decoded."""
    mode = primitive.integer("mode", below=7, default=TRIANGLES)
    return mode if draco_extension(primitive) is None else TRIANGLES


def drawing(primitive: Entry, accessors: Accessors) -> Hashable:
    """Return the same for primitives that draw their vertices in the same way."""
    index = _index_accessor(primitive, accessors)
    return drawing_mode(primitive), None if index is None else accessors.identity(index)


def drawn(primitive: Entry, accessors: Accessors, count: int, placement: Placement) -> Int64s:
    """Return the triangles of a primitive as vertex indices in [0, count), shape (F, 3), facing outwards."""
    index = _index_accessor(primitive, accessors)
    accessors.count_drawn(primitive, count if index is None else accessors[index].count)
    corners = np.arange(count) if index is None else _indices(primitive, accessors, index, count)
    faces = _triangles(drawing_mode(primitive), corners)
    if np.linalg.det(placement.matrix[:3, :3]) < 0:
        faces = faces[:, ::-1]  # a mirrored node turns its triangles inside out
    return faces


def textured_triangles(
    primitive: Entry, accessors: Accessors, placement: Placement
) -> tuple[int, int, Int64s] | None:
    """Return the accessor of positions, their number, and the triangles; None if none are drawn."""
    if drawing_mode(primitive) < TRIANGLES or "POSITION" not in primitive.entry("attributes"):
        return None
    position = position_accessor(primitive, accessors)
    count = accessors[position].count
    faces = drawn(primitive, accessors, count, placement)
    return (position, count, faces) if len(faces) else None


def _index_accessor(primitive: Entry, accessors: Accessors) -> int | None:
    packed = draco_extension(primitive)
    if packed is not None:
        return accessors.decoded_indices(packed, primitive.integer("indices", below=len(accessors)))
    return primitive.integer("indices", below=len(accessors)) if "indices" in primitive else None


def _indices(primitive: Entry, accessors: Accessors, index: int, count: int) -> Int64s:
    accessor = accessors[index]
    if accessor.shape != "SCALAR" or accessor.component.kind != "u":
        raise primitive.fault("indices", f"is {accessor.shape} of {accessor.component.name}, not indices")
    corners = accessors.stored(index)[:, 0].astype(np.int64)
    if corners.max() >= count:
        raise primitive.fault("indices", f"names vertex {corners.max()}, but there are only {count}")
    return corners


def _triangles(mode: int, corners: Int64s) -> Int64s:
    """Return the triangles (F, 3) that a sequence of corners draws, with the winding that glTF defines."""
    if mode == TRIANGLES:
        return corners[: len(corners) // 3 * 3].reshape(-1, 3)
    if mode == STRIP:
        return unrolled(corners, np.array([0, len(corners)]))
    if mode != FAN or len(corners) < 3:
        return np.empty((0, 3), np.int64)
    first = np.arange(len(corners) - 2)
    return corners[np.stack([first + 1, first + 2, np.zeros_like(first)], axis=1)]
