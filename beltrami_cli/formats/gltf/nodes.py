"""The placements of meshes by the nodes of a glTF file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Bools, Float64s, Int64s
from beltrami_cli.formats.gltf.accessors import Accessor
from beltrami_cli.formats.gltf.entries import Entry
from beltrami_cli.surface.geometry import unit_vectors


@dataclass(frozen=True)
class Placement:
    """The placement of a mesh."""

    matrix: Float64s  # (4, 4), from the mesh's own space to the common one; acts on columns
    # 0: the default scene (all scenes, if none is); each other scene and unplaced mesh has its own.
    space: int
    nodes: int  # how many nodes show the mesh, in all scenes

    def facing(self, faces: Int64s) -> Int64s:
        """Return triangles facing outwards: a mirrored node turns them inside out."""
        return faces[:, ::-1] if np.linalg.det(self.matrix[:3, :3]) < 0 else faces

    def positions(self, accessor: Accessor, used: slice | Bools = slice(None)) -> Float64s:
        """Return all or the used positions of an accessor, shape (n, 3), in the common space."""
        positions = accessor.values()[used]
        with np.errstate(over="ignore", invalid="ignore"):
            moved: Float64s = positions @ self.matrix[:3, :3].T + self.matrix[:3, 3]
        if not np.isfinite(moved).all():
            raise accessor.entry.fault("", "positions overflow in world space")
        return moved

    def normals(self, accessor: Accessor) -> Float64s:
        """Return the unit normals of an accessor, shape (n, 3), in the common space; zero vectors stay zero."""
        a, b, c = self.matrix[:3, :3].T
        # The cofactor matrix is the inverse transpose times the determinant, and exists for flat scales too.
        cofactors = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)
        sign = -1.0 if a @ cofactors[:, 0] < 0 else 1.0
        return unit_vectors(accessor.values() @ (sign * cofactors).T)


def placements(root: Entry) -> list[Placement]:
    """Return the place of every mesh: its first node, depth first, the default scene before the others."""
    scenes = root.entries("scenes")
    default = root.integer("scene", below=len(scenes)) if "scene" in root else None
    order = sorted(range(len(scenes)), key=lambda scene: scene != default)
    shown: dict[int, list[tuple[Float64s, int]]] = {}
    for rank, mesh, place, _ in _shown(root, [scenes[scene] for scene in order]):
        shown.setdefault(mesh, []).append((place, 0 if default is None else rank))
    placed = []
    for mesh in range(len(root.entries("meshes"))):
        places = shown.get(mesh) or [(np.eye(4), len(scenes) + mesh)]
        placed.append(Placement(*places[0], nodes=len(places)))
    return placed


def instances(root: Entry) -> list[tuple[int, Placement, str]]:
    """Return every mesh that a node of the default scene shows (of all scenes, if none is), its place and its name."""
    meshes, scenes = root.entries("meshes"), root.entries("scenes")
    chosen = [scenes[root.integer("scene", below=len(scenes))]] if "scene" in root else scenes
    return [
        (mesh, Placement(place, 0, 1), node.text("name") or meshes[mesh].text("name") or "")
        for _, mesh, place, node in _shown(root, chosen)
    ]


def _shown(root: Entry, scenes: Sequence[Entry]) -> Iterator[tuple[int, int, Float64s, Entry]]:
    """Yield the nodes with a mesh, depth first: the number of the scene, the mesh, its matrix and the node."""
    nodes, meshes = root.entries("nodes"), root.entries("meshes")
    children = [node.integers("children", below=len(nodes)) for node in nodes]
    parent: dict[int, int] = {}
    for index, child in ((index, child) for index, named in enumerate(children) for child in named):
        if child in parent:
            raise nodes[index].fault("children", f"nodes[{child}] has another parent, nodes[{parent[child]}]")
        parent[child] = index
    scene_of: dict[int, int] = {}  # the first that shows a node
    for number, scene in enumerate(scenes):
        stack = [(index, np.eye(4)) for index in reversed(scene.integers("nodes", below=len(nodes)))]
        while stack:
            index, above = stack.pop()
            if scene_of.get(index) == number:
                raise scene.fault("nodes", f"nodes[{index}] is reached twice: the nodes are not a tree")
            if index in scene_of:
                continue
            scene_of[index], node = number, nodes[index]
            with np.errstate(over="ignore", invalid="ignore"):
                matrix = above @ _local(node)
            if not np.isfinite(matrix).all():
                raise node.fault("", "its transform is too large to compute with")
            stack += [(child, matrix) for child in reversed(children[index])]
            if "mesh" in node:
                # A skin's joints place the mesh, and its stored positions are the bind pose.
                mesh = node.integer("mesh", below=len(meshes))
                yield number, mesh, np.eye(4) if "skin" in node else matrix, node


def _local(node: Entry) -> Float64s:
    """Return a node's own transform: its matrix, or translation times rotation times scale."""
    columns = node.numbers("matrix", 16)
    if columns is not None:
        return np.array(columns).reshape(4, 4).T
    quaternion = np.array(node.numbers("rotation", 4) or [0.0, 0.0, 0.0, 1.0])
    if not quaternion.any():
        raise node.fault("rotation", "is a quaternion of length zero")
    scaled = quaternion / np.abs(quaternion).max()
    x, y, z, w = scaled / np.linalg.norm(scaled)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    rotation = np.eye(3) + 2 * (w * cross + cross @ cross)
    matrix = np.eye(4)
    matrix[:3, :3] = rotation * np.array(node.numbers("scale", 3) or [1.0, 1.0, 1.0])
    matrix[:3, 3] = node.numbers("translation", 3) or [0.0, 0.0, 0.0]
    return matrix
