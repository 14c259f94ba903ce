"""Textured surfaces whose atlas is known: planes cut in charts, cubes, cylinders."""

import dataclasses

import numpy as np

from beltrami_cli.surface.atlas import HALO, OWNED
from beltrami_cli.surface.records import Texture, TexturedSurface

# The symmetries of the square, as matrices: rotations by 90 degrees, then the same mirrored.
TURNS = [np.linalg.matrix_power(np.array([[0, -1], [1, 0]]), k) for k in range(4)]
SYMMETRIES = [*TURNS, *(turn @ np.diag([-1, 1]) for turn in TURNS)]


def textured(positions, faces, texel_corners, sizes, texture_of=None, wrap=("repeat", "repeat")):
    """A surface from corners in texels, (F, 3, 2), the corner of the image at (0, 0)."""
    faces = np.asarray(faces, np.int32).reshape(-1, 3)
    texture_of = np.zeros(len(faces), np.int32) if texture_of is None else np.asarray(texture_of, np.int32)
    sizes = np.asarray(sizes, float)
    uv = np.asarray(texel_corners, float).reshape(-1, 3, 2) / sizes[texture_of][:, None]
    textures = tuple(Texture(str(i), f"{i}.png", b"", wrap=wrap) for i in range(len(sizes)))
    return TexturedSurface(np.asarray(positions, float).reshape(-1, 3), faces, uv, texture_of, textures)


def quads(columns, rows, side, flips):
    """A plane of square quads, cut along either diagonal: vertices at multiples of `side`, faces by quad."""
    y, x = np.mgrid[: rows + 1, : columns + 1]
    positions = side * np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    faces = []
    for row in range(rows):
        for column in range(columns):
            a = row * (columns + 1) + column
            b, c, d = a + 1, a + columns + 1, a + columns + 2
            faces += [[a, b, d], [a, d, c]] if flips[row, column] else [[a, b, c], [b, d, c]]
    return positions.astype(float), np.array(faces, np.int32)


def strips(spans, size, height=8):
    """A plane cut in upright strips, each a chart from x to x in space, and from u to u in the image, in texels."""
    positions, faces, corners = [], [], []
    for (left, right), (first, last) in spans:
        start = len(positions)
        positions += [[left, 0, 0], [right, 0, 0], [right, height, 0], [left, height, 0]]
        quad = np.array([[first, 4], [last, 4], [last, 4 + height], [first, 4 + height]], float)
        faces += [[start, start + 1, start + 2], [start, start + 2, start + 3]]
        corners += [quad[[0, 1, 2]], quad[[0, 2, 3]]]
    return textured(positions, faces, corners, [size])


def shown_texels(atlas):
    """The texel that each cell of the canvas shows, for a halo cell the one that weighs most; -1 where it is empty."""
    texel = np.full(atlas.kind.size, -1)
    texel[atlas.owned_cells] = atlas.owned_texels
    texel[atlas.halo.cells] = texel[atlas.halo.nearest]
    return texel.reshape(atlas.kind.shape)


def assert_sound(atlas, margin):
    """Each covered texel is owned once, lists are those of the canvas, and its border is free of owned cells."""
    flat = atlas.kind.reshape(-1)
    assert np.array_equal(np.flatnonzero(flat == OWNED), atlas.owned_cells)
    assert np.array_equal(np.flatnonzero(flat == HALO), atlas.halo.cells)
    assert len(np.unique(atlas.owned_texels)) == len(atlas.owned_texels) == atlas.covered >= atlas.overlapped
    outer = np.ones_like(atlas.kind, bool)
    outer[margin:-margin, margin:-margin] = False
    assert not (atlas.kind[outer] == OWNED).any()


def assert_equal(one, other):
    """Two atlases have the same cells, numbers and lengths."""
    assert np.array_equal(one.squared_lengths, other.squared_lengths)
    assert np.array_equal(one.owned_cells, other.owned_cells)
    for this, that in ((one, other), (one.halo, other.halo), (one.gutter, other.gutter)):
        for name in vars(this).keys() - {"lengths", "owned", "halo", "gutter"}:
            assert np.array_equal(getattr(this, name), getattr(that, name)), name


class CutPlane:
    """A plane of texels at unit distance; quads with the same label keep together in the image.

    Attributes
    ----------
    surface : TexturedSurface
    sizes : list of one (width, height)
    place_of : ndarray of int, shape (height, width, 2)
        The place (x, y) on the plane of each texel of the image.
    turn : ndarray of int, shape (height, width, 2, 2)
        Matrix from steps in the image to steps on the plane.
    """

    def __init__(self, labels, flips, symmetries, order, side=4, gap=0):
        rows, columns = labels.shape
        positions, faces = quads(columns, rows, side, flips)
        self.width, self.height = columns * side, rows * side
        # Room enough for a part however it is turned about its corner.
        cell = 2 * max(self.width, self.height) + gap
        count = len(order)
        self.sizes = [(cell * count, cell)]
        corners = np.empty((len(faces), 3, 2))
        self.place_of = np.full((cell, cell * count, 2), -1)
        self.turn = np.zeros((cell, cell * count, 2, 2), int)
        y, x = np.mgrid[: self.height, : self.width]
        plane = np.stack([x, y], axis=-1).reshape(-1, 2)
        plane_label = labels[plane[:, 1] // side, plane[:, 0] // side]
        label_of_face = np.repeat(labels.ravel(), 2)
        for label in range(count):
            matrix = SYMMETRIES[symmetries[label]]
            centre = np.array([order[label] * cell + cell // 2, cell // 2])
            mine = label_of_face == label
            corners[mine] = positions[faces[mine]][..., :2] @ matrix.T + centre
            places = plane[plane_label == label]
            texels = np.floor((places + 0.5) @ matrix.T + centre).astype(int)
            self.place_of[texels[:, 1], texels[:, 0]] = places
            self.turn[texels[:, 1], texels[:, 0]] = np.linalg.inv(matrix).round().astype(int)
        self.surface = textured(positions, faces, corners, self.sizes)


def cube(texels=16, gap=4):
    """A cube of one chart a side."""
    positions, faces, corners = [], [], []
    for number in range(6):
        axis, sign = number // 2, 1 - 2 * (number % 2)
        square = np.zeros((4, 3))
        square[:, axis] = sign
        square[:, [(axis + 1) % 3, (axis + 2) % 3]] = [[-1, -1], [1, -1], [1, 1], [-1, 1]]
        left = number * (texels + gap) + gap
        right, bottom = left + texels, gap + texels
        image = np.array([[left, gap], [right, gap], [right, bottom], [left, bottom]])
        faces += [[4 * number, 4 * number + 1, 4 * number + 2], [4 * number, 4 * number + 2, 4 * number + 3]]
        corners += [image[[0, 1, 2]], image[[0, 2, 3]]]
        positions.append(square * texels / 2)
    return textured(np.concatenate(positions), faces, corners, [(6 * (texels + gap) + gap, texels + 2 * gap)])


def slit(surface, start, end, through=(False, False), gap=2**-10):
    """Cut a flat surface open along a straight line of edges, and lift one of its sides by more than rounding.

    Parameters
    ----------
    start, end : (float, float)
        Vertices, by x and y. They stay joined, but for those that the cut goes through, because the surface ends there.
    """
    start, end = np.asarray(start, float), np.asarray(end, float)
    along = end - start
    offset = surface.positions[:, :2] - start
    beside = offset @ [-along[1], along[0]]
    share = offset @ along / (along @ along)
    inner = (share > 0 if not through[0] else share >= 0) & (share < 1 if not through[1] else share <= 1)
    doubled = np.flatnonzero(inner & (beside == 0))
    middles = offset[surface.faces].mean(axis=1) @ [-along[1], along[0]]
    new = np.arange(len(surface.positions))
    new[doubled] = len(surface.positions) + np.arange(len(doubled))
    faces = np.where((middles > 0)[:, None], new[surface.faces], surface.faces)
    copies = surface.positions[doubled] + [0, 0, gap]
    positions = np.concatenate([surface.positions, copies])
    return dataclasses.replace(surface, positions=positions, faces=faces.astype(np.int32))
