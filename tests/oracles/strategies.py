"""Random small meshes for property tests, with everything that a mesh from the wild may have."""

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from oracles import surfaces

# Multiples of 1/64 shrink well; they are exact in float32 and make coincident points and lines likely.
GRAIN = 64


def general_position(positions, seed):
    """Move distinct places a little, coincident vertices together.

    Right angles and points in line are where an obtuse corner is split in one way or another by the last bit,
    with different distances. Moved, they are decided alike in single and in double precision.
    """
    places, place_of = np.unique(positions, axis=0, return_inverse=True)
    return (places + 0.01 * np.random.default_rng(seed).standard_normal(places.shape))[place_of.reshape(-1)]


@st.composite
def soups(draw, max_vertices=12, max_faces=18, dimensions=(2, 4), general=False):
    """Draw (positions (V, D) float64, faces (F, 3) int32).

    Corners are drawn independently: edges with one to many faces, duplicate faces, faces that repeat a corner,
    faces without area, coincident vertices and isolated vertices all occur; with `general`, the places are
    in general position.
    """
    count = draw(st.integers(1, max_vertices))
    dimension = draw(st.integers(*dimensions))
    grains = draw(arrays(np.int64, (count, dimension), elements=st.integers(-GRAIN, GRAIN)))
    faces = draw(arrays(np.int64, (draw(st.integers(0, max_faces)), 3), elements=st.integers(0, count - 1)))
    if len(faces) and draw(st.booleans()):
        faces = np.concatenate([faces, faces[: draw(st.integers(1, len(faces))), ::-1]])
    positions = (
        general_position(grains / GRAIN, draw(st.integers(0, 2**32 - 1))) if general else grains / GRAIN
    )
    return positions, faces.astype(np.int32)


@st.composite
def patches(draw, max_side=6, dimensions=(2, 4), general=False):
    """Draw (positions (V, D) float64, faces (F, 3) int32): a jittered grid, with some faces torn out or doubled."""
    rows, columns = draw(st.integers(2, max_side)), draw(st.integers(2, max_side))
    dimension = draw(st.integers(*dimensions))
    seed = draw(st.integers(0, 2**32 - 1))
    random = np.random.default_rng(seed)
    flat, cells = surfaces.plane(rows, columns)
    positions = np.zeros((rows * columns, dimension))
    positions[:, :2] = flat[:, :2]
    jitter = draw(st.sampled_from((0.05, 0.2, 1.0) if general else (0.0, 0.2, 1.0)))
    positions += jitter * random.standard_normal(positions.shape)
    # How often each face occurs: mostly once, at times never or twice.
    times = random.choice(3, len(cells), p=draw(st.sampled_from(((0, 1, 0), (0.1, 0.8, 0.1)))))
    return positions, random.permutation(np.repeat(cells, times, axis=0)).astype(np.int32)


def meshes(**options):
    """Draw a soup or a patch."""
    return st.one_of(soups(**options), patches(**options))


@st.composite
def coloured_meshes(draw, mesh=None, channels=(1, 4)):
    """Draw (positions, faces, colours (V, C) float32 in [0, 1])."""
    positions, faces = draw(meshes() if mesh is None else mesh)
    shape = len(positions), draw(st.integers(*channels))
    levels = draw(arrays(np.int64, shape, elements=st.integers(0, 255)))
    return positions, faces, (levels / 255).astype(np.float32)
