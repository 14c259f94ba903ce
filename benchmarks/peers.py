"""Other programs, tuned on the truth."""

import importlib
import itertools
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from beltrami_cli.arrays import Array
from harness import SIGMA, psnr
from vertices import Scene

Score = Callable[[Array], Any]  # the PSNR of an image, or a tuple that begins with it

MAX_ITERATIONS = 8  # of the bilateral filter


class PeerError(SystemExit):
    """A program is not installed or cannot be loaded. Unless this is caught, a scenario ends with the message."""


def needed(name: str) -> Any:
    """Import a module that may be missing."""
    try:
        return importlib.import_module(name)
    except (ImportError, OSError) as error:
        why = "not installed" if getattr(error, "name", None) == name else f"cannot be loaded: {error}"
        raise PeerError(f"{name}: {why}".splitlines()[0]) from error


def pymeshlab_smoothing(scene: Scene, most: int) -> tuple[float, int]:
    """Return the best PSNR of PyMeshLab's Laplacian colour smoothing over 1 to `most` iterations, and their number."""
    pymeshlab = needed("pymeshlab")
    opaque = np.column_stack([np.clip(scene.noisy, 0, 1), np.ones(len(scene.noisy))]).astype(np.float64)
    meshes, found = pymeshlab.MeshSet(), []
    meshes.add_mesh(pymeshlab.Mesh(scene.positions, scene.faces, v_color_matrix=opaque))
    for _ in range(most):
        meshes.apply_color_laplacian_smoothing_per_vertex(iteration=1)
        found.append(psnr(meshes.current_mesh().vertex_color_matrix()[:, :3], scene.clean))
    return max(found), int(np.argmax(found)) + 1


def open3d_smoothing(kind: str, scene: Scene, most: int) -> tuple[float, int]:
    """Return the best PSNR of an Open3D filter over 1 to `most` iterations on the colours, and their number."""
    open3d = needed("open3d")
    vectors = open3d.utility.Vector3dVector
    mesh = open3d.geometry.TriangleMesh(vectors(scene.positions), open3d.utility.Vector3iVector(scene.faces))
    mesh.vertex_colors = vectors(scene.noisy.astype(np.float64))
    scope, found = {"filter_scope": open3d.geometry.FilterScope.Color}, []
    for _ in range(most):
        mesh = getattr(mesh, f"filter_smooth_{kind}")(number_of_iterations=1, **scope)
        found.append(psnr(np.asarray(mesh.vertex_colors), scene.clean))
    return max(found), int(np.argmax(found)) + 1


def bilateral(noisy: Array, score: Score, *, window: int = 7, sigma: float = SIGMA) -> Any:
    """Return the best scores of OpenCV's bilateral filter, iterated.

    `noisy` is uint8, shape (H, W, 3); `score` returns a tuple for an image in [0, 1], whose first number is maximised.
    """
    cv2, found = opencv(), []
    image = noisy.astype(np.float32) / 255
    for colour, space in itertools.product((1, 1.5, 2, 2.7, 4), (1.2, 1.8, 3, 5)):
        smoothed = image
        for _ in range(MAX_ITERATIONS):
            smoothed = cv2.bilateralFilter(smoothed, window, colour * sigma, space)
            found.append(score(smoothed))
    return max(found, key=lambda scores: scores[0])


def nonlocal_means(noisy: Array, score: Score, *, sigma: float = SIGMA) -> Any:
    """Return the best scores of scikit-image's fast non-local means, as `bilateral` does."""
    run = needed("skimage.restoration").denoise_nl_means
    image = noisy.astype(np.float32) / 255
    options = {"patch_distance": 6, "fast_mode": True, "channel_axis": -1, "sigma": sigma}
    settings = itertools.product((0.4, 0.6, 0.8), (3, 5))
    found = [score(run(image, h=h * sigma, patch_size=patch, **options)) for h, patch in settings]
    return max(found, key=lambda scores: scores[0])


def bm3d(noisy: Array, score: Score, *, sigma: float = SIGMA) -> Any:
    """Return the scores of BM3D with its own settings, given the true sigma."""
    module = needed("bm3d")
    settings = module.BM3DProfile()
    settings.num_threads = 1
    return score(module.bm3d_rgb(noisy / 255, sigma, settings))


def bilateral_seconds(noisy: Array) -> float:
    """Return the CPU seconds of one pass of OpenCV's bilateral filter (d = 7, float32, one thread)."""
    cv2 = opencv()
    image = noisy.astype(np.float32) / 255
    start = time.process_time()
    cv2.bilateralFilter(image, 7, 2 * SIGMA, 1.8)
    return time.process_time() - start


def opencv() -> Any:
    """Return OpenCV's module, set to use one thread."""
    cv2 = needed("cv2")
    cv2.setNumThreads(1)
    return cv2
