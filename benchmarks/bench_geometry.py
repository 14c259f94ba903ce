"""Judge smoothed geometry: what is left of noise in smooth parts and at creases, and how far shapes shrink.

Shapes have edges of about one unit. Errors are distances from the true surface, root mean square, in edge lengths.
Plain is the kernel without normals in the metric (``--normal-beta 0``).
"""

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import beltrami_cli
from oracles import surfaces

SIGMAS = (0.1, 0.2, 0.3)
SIDE = 40


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def results(positions, faces, sigma):
    noisy = positions + np.random.default_rng(3).normal(0, sigma, positions.shape)
    parameters = {"colours": np.full((len(noisy), 1), 0.5), "smooth_geometry": True}
    return {
        "noisy": noisy,
        "smoothed": beltrami_cli.smooth(noisy, faces, **parameters).positions,
        "plain": beltrami_cli.smooth(noisy, faces, **parameters, normal_beta=0).positions,
    }


def judge_cube(sigma):
    cube, faces = surfaces.cube(SIDE)
    from_crease = np.sort(np.minimum(cube, SIDE - cube), axis=1)[:, 1]
    for name, positions in results(cube, faces, sigma).items():
        error = surfaces.off_cube(positions, SIDE)
        flat, crease = rms(error[from_crease >= 5]), rms(error[from_crease == 0])
        print(f"| cube, noise {sigma} | {name} | {flat:.3f} | {crease:.3f} | |")


def judge_sphere(sigma):
    positions, faces = surfaces.icosphere(5)
    positions = positions / surfaces.mean_edge_length(positions, faces)
    radius = np.linalg.norm(positions[0])
    for name, result in results(positions, faces, sigma).items():
        radii = np.linalg.norm(result, axis=1)
        print(
            f"| sphere of radius {radius:.0f}, noise {sigma} | {name} | {rms(radii - radius):.3f} | "
            f"| {100 * (radii.mean() / radius - 1):.2f} % |"
        )


def main():
    print(
        "| shape | | error in smooth parts | at creases | change of radius |\n| --- | --- | --- | --- | --- |"
    )
    for sigma in SIGMAS:
        judge_cube(sigma)
    for sigma in SIGMAS:
        judge_sphere(sigma)


if __name__ == "__main__":
    main()
