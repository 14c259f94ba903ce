"""Other programs on the same meshes. Each raises `PeerError` where it is not installed or cannot be loaded."""

import subprocess
import tempfile
from pathlib import Path

import numpy as np
from scene import psnr


class PeerError(Exception):
    """The peer cannot be used here; the message says why."""


def pymeshlab_smoothing(scene, most):
    """Return the best PSNR of PyMeshLab's Laplacian colour smoothing over 1 to `most` iterations, and which."""
    try:
        import pymeshlab
    except ImportError as error:
        raise PeerError(reason(error)) from error
    opaque = np.column_stack([np.clip(scene.noisy, 0, 1), np.ones(len(scene.noisy))]).astype(np.float64)
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(scene.positions, scene.faces, v_color_matrix=opaque))
    found = []
    for _ in range(most):
        meshes.apply_color_laplacian_smoothing_per_vertex(iteration=1)
        found.append(psnr(scene.clean, meshes.current_mesh().vertex_color_matrix()[:, :3]))
    return max(found), int(np.argmax(found)) + 1


def open3d_smoothing(kind, scene, most):
    """Return the best PSNR of an Open3D filter over 1 to `most` iterations on the colours, and which."""
    try:
        import open3d
    except (ImportError, OSError) as error:
        raise PeerError(reason(error)) from error
    geometry = open3d.geometry
    mesh = geometry.TriangleMesh(
        open3d.utility.Vector3dVector(scene.positions), open3d.utility.Vector3iVector(scene.faces)
    )
    mesh.vertex_colors = open3d.utility.Vector3dVector(scene.noisy.astype(np.float64))
    scope = {"filter_scope": geometry.FilterScope.Color}
    found = []
    for _ in range(most):
        mesh = getattr(mesh, f"filter_smooth_{kind}")(number_of_iterations=1, **scope)
        found.append(psnr(scene.clean, np.asarray(mesh.vertex_colors)))
    return max(found), int(np.argmax(found)) + 1


GDIST = """
import sys, time
import gdist, numpy
mesh = numpy.load(sys.argv[1])
start = time.process_time()
found = gdist.local_gdist_matrix(mesh["positions"], mesh["faces"], max_distance=float(mesh["radius"]))
seconds = time.process_time() - start
print(seconds / len(mesh["positions"]), found.nnz / len(mesh["positions"]) + 1)
"""


def gdist_distances(scene, radius, count, python):
    """Return CPU seconds per source of gdist's distances within `radius`, and the vertices that it reaches.

    Parameters
    ----------
    scene : Scene
        A sphere; a cap of it with about `count` vertices is used, because gdist's time per source grows with
        the mesh.
    radius : float
        In the unit of the positions.
    count : int
        Vertices of the cap.
    python : str
        Interpreter that has gdist. Its wheels are built for NumPy 1, so it may have to be another one.
    """
    kept = scene.positions[:, 2] >= np.sort(scene.positions[:, 2])[-count]
    used, corners = np.unique(scene.faces[kept[scene.faces].all(axis=1)], return_inverse=True)
    cap = {
        "positions": scene.positions[used],
        "faces": corners.reshape(-1, 3).astype(np.int32),
        "radius": radius,
    }
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "cap.npz"
        np.savez(path, **cap)
        done = subprocess.run([python, "-c", GDIST, path], capture_output=True, text=True, check=False)
    if done.returncode:
        raise PeerError(done.stderr.strip().splitlines()[-1] + " (try --gdist-python)")
    seconds, reached = map(float, done.stdout.split())
    return seconds, reached


def reason(error):
    """Return why an import failed, in one line; a module that a peer itself lacks is named."""
    if getattr(error, "name", None) in ("open3d", "pymeshlab"):
        return "not installed"
    return f"cannot be loaded: {error}".splitlines()[0]
