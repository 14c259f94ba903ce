"""Measure the noise left in smoothed geometry, in smooth parts and at creases, and how far shapes shrink.

Shapes have edges of about one unit. Errors are distances from the true surface, root mean square, in edge lengths.
"plain" is the kernel without normals in the metric (``--normal-beta 0``).
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

import beltrami_cli
from beltrami_cli.arrays import Array
from harness import Row, arguments, rms, show
from oracles import surfaces

SIGMAS = (0.1, 0.2, 0.3)  # edge lengths
SIDE = 40  # edge lengths of the cube


def results(positions: Array, faces: Array, sigma: float) -> Iterator[tuple[str, Any]]:
    """Yield names and positions: noisy ones, and those after smoothing with and without normals in the metric."""
    noisy = positions + np.random.default_rng(3).normal(0, sigma, positions.shape)
    parameters: dict[str, Any] = {"colours": np.full((len(noisy), 1), 0.5), "smooth_geometry": True}
    yield "noisy", noisy
    yield "smoothed", beltrami_cli.smooth(noisy, faces, **parameters).positions
    yield "plain", beltrami_cli.smooth(noisy, faces, **parameters, normal_beta=0).positions


def cube_rows(sigma: float) -> Iterator[Row]:
    cube, faces = surfaces.cube(SIDE)
    from_crease = np.sort(np.minimum(cube, SIDE - cube), axis=1)[:, 1]
    for name, positions in results(cube, faces, sigma):
        error = surfaces.off_cube(positions, SIDE)
        flat, crease = rms(error[from_crease >= 5]), rms(error[from_crease == 0])
        yield f"cube, noise {sigma}", name, f"{flat:.3f}", f"{crease:.3f}", ""


def sphere_rows(sigma: float) -> Iterator[Row]:
    positions, faces = surfaces.icosphere(5)
    positions = positions / surfaces.mean_edge_length(positions, faces)
    radius = np.linalg.norm(positions[0])
    for name, result in results(positions, faces, sigma):
        radii = np.linalg.norm(result, axis=1)
        change = f"{100 * (radii.mean() / radius - 1):.2f} %"
        yield f"sphere of radius {radius:.0f}, noise {sigma}", name, f"{rms(radii - radius):.3f}", "", change


def main() -> None:
    options = arguments(__doc__)
    rows = [row for judge in (cube_rows, sphere_rows) for sigma in SIGMAS for row in judge(sigma)]
    show(rows, options, ("shape", "", "error in smooth parts", "at creases", "change of radius"))


if __name__ == "__main__":
    main()
