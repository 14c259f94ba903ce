"""Images and meshes with noise, and readings of it."""

import numpy as np

from beltrami_cli.flow.estimation import estimate_on_mesh
from beltrami_cli.flow.manifolds.mesh.manifold import ColouredMesh, mesh_manifold
from beltrami_cli.flow.noise.grid_squares import GridSquares
from beltrami_cli.flow.noise.reading import read_noise
from beltrami_cli.flow.parameters import parameters_from
from beltrami_cli.jobs.noise.kinds import NumberedSamples, add_grain, seen_by_camera
from beltrami_cli.jobs.settings import NoiseSettings
from beltrami_cli.surface.records import Cells, SampledSurface


def noise_of_image(image, **options):
    """Return the noise model of an image of shape (R, C, N)."""
    planes = np.ascontiguousarray(np.moveaxis(image, 2, 0), np.float32)
    return read_noise(planes, GridSquares.of(np.ones(planes.shape[1:], bool)), **options)


def manifold_of(positions, faces, colours, parameters=None):
    """Return the manifold of a mesh, on which parameters are chosen unless some are given."""
    walls = np.zeros((0, 3), np.int32)
    surface = SampledSurface(positions, faces.astype(np.int32), walls, colours.astype(np.float32))
    mesh = ColouredMesh.of(surface, parameters or parameters_from({"threads": 1}))
    return mesh_manifold(mesh, estimate_on_mesh(mesh))


def in_8_bits(colours):
    """Return colours as an 8-bit file keeps them."""
    return (np.rint(np.clip(colours, 0, 1) * 255) / 255).astype(np.float32)


def by_camera(image, shot=0.01, read=0.01):
    """Return what a camera makes of an image of shape (R, C, 3)."""
    row, column = np.indices(image.shape[:2]).reshape(2, -1)
    cells = Cells([image.shape[:2]], np.zeros_like(row), row, column, np.zeros_like(row))
    targets = NumberedSamples(image.reshape(-1, 3), np.arange(row.size))
    settings = NoiseSettings(kind="camera", shot=shot, read=read)
    return seen_by_camera(targets, cells, settings).reshape(image.shape)


def with_grain(positions, clean, sigma):
    """Return colours of vertices of a unit sphere with noise that they share over two spacings."""
    spacing = np.full(len(positions), np.sqrt(4 * np.pi / len(positions)))
    targets = NumberedSamples(clean.astype(np.float32), np.arange(len(positions)))
    settings = NoiseSettings(kind="grain", sigma=sigma, grain_size=2.0)
    return add_grain(targets, positions, spacing, settings).astype(np.float32)
