"""Where the meshes stand: the node hierarchy of every scene, followed down to one place for each mesh."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.formats.gltf.tree import Entry


@dataclass(frozen=True)
class Placement:
    """Where a mesh is taken to be.

    Attributes
    ----------
    matrix : ndarray of float64, shape (4, 4)
        From the mesh's own space to the common one; acts on columns.
    space : int
        Meshes share a space only if this agrees: 0 is the default scene (all scenes, if none is the
        default), other scenes and each mesh outside all scenes have their own.
    nodes : int
        How many nodes show the mesh, in all scenes.
    """

    matrix: NDArray[np.float64]
    space: int
    nodes: int


def placements(root: Entry) -> list[Placement]:
    """Return the place of every mesh: its first node, depth first, the default scene before the others.

    A node with a skin counts as untransformed: the skin's joints place the mesh, and its stored positions
    are the bind pose.

    Raises
    ------
    InputError
        If nodes form a cycle or share children, indices are out of range, or transforms are not finite.
    """
    nodes, meshes = root.entries("nodes"), root.entries("meshes")
    children = _children(nodes)
    scenes = root.entries("scenes")
    default = root.integer("scene", below=len(scenes)) if "scene" in root else None
    order = sorted(range(len(scenes)), key=lambda scene: scene != default)
    shown: dict[int, list[tuple[NDArray[np.float64], int]]] = {}
    seen: set[int] = set()
    for rank, scene in enumerate(order):
        for node, matrix in _walk(scenes[scene], nodes, children, seen):
            if "mesh" in nodes[node]:
                mesh = nodes[node].integer("mesh", below=len(meshes))
                place = np.eye(4) if "skin" in nodes[node] else matrix
                shown.setdefault(mesh, []).append((place, 0 if default is None else rank))
    found = []
    for mesh in range(len(meshes)):
        places = shown.get(mesh) or [(np.eye(4), len(scenes) + mesh)]
        found.append(Placement(*places[0], nodes=len(places)))
    return found


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
) -> list[tuple[int, NDArray[np.float64]]]:
    """Return the nodes of a scene that no scene before has, depth first, each with its matrix to the scene's space.

    They are added to those seen. What hangs below a node that was seen was seen as well.
    """
    found: list[tuple[int, NDArray[np.float64]]] = []
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


def _local(node: Entry) -> NDArray[np.float64]:
    """Return a node's own transform: its matrix, or translation times rotation times scale."""
    columns = node.numbers("matrix", 16)
    if columns is not None:
        return np.array(columns).reshape(4, 4).T
    matrix = np.eye(4)
    matrix[:3, :3] = _rotation(node) * np.array(node.numbers("scale", 3) or [1.0, 1.0, 1.0])
    matrix[:3, 3] = node.numbers("translation", 3) or [0.0, 0.0, 0.0]
    return matrix


def _rotation(node: Entry) -> NDArray[np.float64]:
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
