"""The head with its colours in a texture: two dozen charts, turned and shuffled, with gutters."""

from __future__ import annotations

import numpy as np

import head
from baking import baked
from charts import segmented
from packing import unwrapped
from samples import normalised
from textured import Texture, TexturedSample

FREQUENCY = 13
CHARTS = 24
SIZE, SCALE, GUTTER = 416, 178.0, 8
SEED = 17


def make() -> TexturedSample:
    """Return the head with fewer vertices, for its features are in the image now."""
    random = np.random.Generator(np.random.PCG64(SEED))
    sphere, polygons = head.geodesic_sphere(FREQUENCY)
    faces = np.array(polygons)
    positions = normalised(head.surface(head.gathered(sphere)))
    chart_of = segmented(positions, faces, CHARTS, random, ragged=0.25, delay=0.15)
    coordinates, corners = unwrapped(positions, faces, chart_of, SIZE, SCALE, GUTTER, random)
    pixels, filled = baked(head.pattern, positions[faces], coordinates[corners], (SIZE, SIZE), GUTTER)
    texture = Texture("skin", pixels, filled, "png8")
    return TexturedSample(positions, coordinates, faces, corners, np.zeros(len(faces), np.int64), (texture,))
