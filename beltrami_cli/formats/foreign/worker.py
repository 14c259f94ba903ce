"""The process that runs the readers of others: a file comes in by standard input, polygons go out by standard output.

They are not made for files that mean harm, so they get a process that can be ended.
`beltrami_cli.formats.foreign.asking` starts it.
"""

from __future__ import annotations

import io
import signal
import sys
from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.formats.foreign.painting import PaintedPolygons

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

MISSING = 77
"""What it exits with if a package is not installed."""

_PROGRAM = 512 << 20  # bytes that its libraries take


def main() -> None:
    """Read a file from standard input, write its polygons to standard output."""
    kind, seconds, memory = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    _limit(seconds, memory)
    data = sys.stdin.buffer.read()
    try:
        found = read_collada(data) if kind == "dae" else read_by_trimesh(data, kind)
    except ImportError as error:
        sys.stderr.write(f"to read {kind} files, the package {error.name} is needed\n")
        sys.exit(MISSING)
    except MemoryError:
        sys.exit("it needs more memory than it may take")
    except Exception as error:  # whatever the library makes of a damaged file
        sys.exit(
            f"it is damaged, or not understood ({' '.join(f'{type(error).__name__}: {error}'.split())[:150]})"
        )
    answer = io.BytesIO()
    np.savez(
        answer, positions=found.positions, corners=found.corners, sizes=found.sizes, colours=found.colours,
        stored=found.stored, left_out=np.array(found.left_out, "U"),
    )  # fmt: skip
    sys.stdout.buffer.write(answer.getvalue())


def _limit(seconds: int, memory: int) -> None:
    if hasattr(signal, "alarm"):  # so that it ends even where the process that waits for it was killed
        signal.alarm(seconds + 10)
    if memory:
        try:
            import resource
        except ImportError:
            return
        most = resource.getrlimit(resource.RLIMIT_DATA)[1]
        wanted = memory + _PROGRAM
        resource.setrlimit(resource.RLIMIT_DATA, (wanted if most < 0 else min(wanted, most), most))


def read_collada(data: bytes) -> PaintedPolygons:
    """Read the vertex colours of a COLLADA file, every mesh where its nodes place it."""
    import collada

    document = collada.Collada(io.BytesIO(data), ignore=[collada.common.DaeError])
    positions, colours, left = [], [], set()
    for geometry, matrix in _placed(document.scene) if document.scene is not None else ():
        for primitive in geometry.primitives:
            if isinstance(primitive, (collada.polylist.Polylist, collada.polygons.Polygons)):
                primitive = primitive.triangleset()
            if not isinstance(primitive, collada.triangleset.TriangleSet):
                left.add("lines")
                continue
            if primitive.vertex is None or not len(primitive.index):
                continue
            places = primitive.vertex[primitive.vertex_index].reshape(-1, 3).astype(np.float64)
            positions.append(places @ matrix[:3, :3].T + matrix[:3, 3])
            colours.append(_colours_of(primitive))
    if document.errors and not positions:
        raise document.errors[0]
    corners = np.arange(sum(map(len, positions)))
    left |= {"what could not be read"} if document.errors else set()
    left |= {"skins"} if document.controllers else set()
    left |= {"materials"} if document.materials else set()
    left |= {"textures"} if document.images else set()
    return PaintedPolygons(
        np.concatenate([np.empty((0, 3)), *positions]),
        corners,
        np.full(len(corners) // 3, 3),
        np.concatenate([np.empty((0, 4), np.float32), *colours]),
        "float32",
        tuple(sorted(left)),
    )


def _placed(scene: Any) -> Iterator[tuple[Any, NDArray[np.float64]]]:
    """Give every geometry with its matrix: of its node or, with a skin, of where it was bound to the joints."""
    for bound in scene.objects("geometry"):
        yield bound.original, bound.matrix
    for bound in scene.objects("controller"):
        if hasattr(bound, "skin"):
            yield bound.skin.geometry, bound.skin.bind_shape_matrix


def _colours_of(primitive: Any) -> Any:
    """Return colours of all corners of triangles, shape (3 F, 4)."""
    result = np.full((3 * len(primitive.index), 4), np.nan, np.float32)
    sources = primitive.sources.get("COLOR")
    if sources:
        offset, source = sources[0][0], sources[0][4].data
        values = source[primitive.index[:, :, offset]].reshape(len(result), -1)[:, :4]
        result[:, : values.shape[1]] = values
        if values.shape[1] == 3:
            result[:, 3] = 1
    return result


def read_by_trimesh(data: bytes, kind: str) -> PaintedPolygons:
    """Read the colours of vertices or faces that trimesh finds in a file."""
    import trimesh

    scene = trimesh.load_scene(io.BytesIO(data), file_type=kind)
    positions, colours, left = [], [], set()
    for mesh in scene.dump():
        if not isinstance(mesh, trimesh.Trimesh):
            left.add("lines and points")
            continue
        painted = np.full((len(mesh.faces), 3, 4), np.nan, np.float32)
        visual: Any = mesh.visual
        if visual.kind == "face":
            painted[:] = visual.face_colors[:, None] / np.float32(255)
        elif visual.kind == "vertex":
            painted[:] = visual.vertex_colors[mesh.faces] / np.float32(255)
        elif visual.kind == "texture":
            left.add("textures")
        positions.append(mesh.vertices[mesh.faces].reshape(-1, 3))
        colours.append(painted.reshape(-1, 4))
    corners = np.arange(sum(map(len, positions)))
    return PaintedPolygons(
        np.concatenate([np.empty((0, 3)), *positions]),
        corners,
        np.full(len(corners) // 3, 3),
        np.concatenate([np.empty((0, 4), np.float32), *colours]),
        "uint8",
        (*sorted(left), "names and structure"),
    )


if __name__ == "__main__":
    main()
