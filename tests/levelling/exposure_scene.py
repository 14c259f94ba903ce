"""Textures whose charts were given known exposures, and how far colours are from the truth besides one for all."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from beltrami_cli.flow.manifolds.grid.canvas import canvas_colours, on_canvas
from beltrami_cli.formats.image.decoded_image import new_image
from beltrami_cli.formats.image.reading import read_image
from beltrami_cli.formats.image.writing import write_image
from beltrami_cli.formats.registry import open_document
from beltrami_cli.layers.settings import DEFAULTS, LevelSettings, SmoothSettings, TextureSettings
from beltrami_cli.layers.texture_layer import TextureLayer
from beltrami_cli.levelling.correction import level_canvas_in_place
from beltrami_cli.levelling.steps import ChartPlaces, positions_of

GAINS, OFFSET, FALL_OFF = (0.82, 1.12), 10 / 255, 0.15
LIGHT_GAINS = 0.6, 1.6  # of linear light


def stored_colours(layer):
    """Return the colours of the owned cells of textures, shape (T, N)."""
    return layer.all_texel_colours()


@dataclass
class ExposureScene:
    """The texels of a model, in display values, shape (T, N)."""

    samples: TextureLayer
    truth: np.ndarray

    @classmethod
    def of(cls, path):
        return cls.on(open_document(str(path)).textured("baseColor"))

    @classmethod
    def on(cls, surface):
        samples = TextureLayer.read(surface, "baseColor", DEFAULTS)
        return cls(samples, stored_colours(samples).astype(float))

    def as_jpeg(self, colours, quality, subsampling="4:2:0"):
        """Return the scene of other colours that were stored as JPEG, with neighbours' colours in the gutters."""
        surface, textures = self.samples.surface, []
        settings = SmoothSettings(textures=TextureSettings(image_suffix=".png"))
        samples = TextureLayer.read(surface, "baseColor", settings)
        planes = on_canvas(samples.atlas, colours.astype(np.float32))
        images = samples.encode(canvas_colours(samples.atlas, planes)).images
        for texture in surface.textures:
            png = read_image(images["baseColor", texture.key].data, texture.name)
            new = new_image(png.pixels, texture.name)
            new.spec.attribute("jpeg:subsampling", subsampling)
            jpeg = replace(new, format="jpeg", suffix=".jpg")
            file = write_image(jpeg, png.pixels, jpeg_quality=quality)
            textures.append(replace(texture, content=file.data))
        return ExposureScene.on(replace(surface, textures=tuple(textures)))

    def levelled_as_file(self):
        """Return what `beltrami level` makes of the colours of its files, which it writes if they are not the truth."""
        levelled = self.samples.levelled(LevelSettings()).levelled_colours
        return self.truth if levelled is None else levelled.astype(float)

    @property
    def charts(self):
        return self.samples.atlas.chart_of

    def exposed(self, seed, *, fall_off=False, clipped=False, in_light=False):
        """Return the truth, and that with a gain and an offset for each chart and channel, in 8 bits.

        Unless some is to be clipped, the truth is brought into the range in which nothing is.
        """
        truth, expose = self.exposures(seed, fall_off=fall_off, clipped=clipped, in_light=in_light)
        return truth, np.rint(np.clip(expose(truth), 0, 1) * 255) / 255

    def exposures(self, seed, *, fall_off=False, clipped=False, in_light=False):
        """Return the truth, and a function that exposes it."""
        random, atlas = np.random.default_rng(seed), self.samples.atlas
        truth = self.truth if clipped else 0.1 + 0.65 * self.truth
        shape = (atlas.charts, truth.shape[1])
        if in_light:
            gain = np.exp(random.uniform(*np.log(LIGHT_GAINS), shape))[self.charts]
            return 0.8 * truth, lambda colours: from_light(gain * to_light(colours))
        gain, offset = random.uniform(*GAINS, shape), random.uniform(-OFFSET, OFFSET, shape)
        steepest = FALL_OFF if fall_off else 0
        slope = random.uniform(-steepest, steepest, (atlas.charts, 2))
        own = ChartPlaces.of(atlas).at(positions_of(atlas, atlas.owned_cells), self.charts)

        def expose(colours, charts=self.charts, places=own):
            factor = 1 + np.einsum("tk,tk->t", places.clip(-1, 1), slope[charts])[:, None]
            return colours * gain[charts] * factor + offset[charts]

        return truth, expose

    def levelled(self, colours, strength=1.0, fixed=None):
        """Return the colours after levelling, and what was found."""
        atlas = self.samples.atlas
        planes = on_canvas(atlas, colours.astype(np.float32))
        found, _ = level_canvas_in_place(atlas, planes, strength, fixed)
        return planes.reshape(len(planes), -1)[:, atlas.owned_cells].T.astype(float), found


def to_light(shown):
    """Return linear light for display values of sRGB."""
    return np.where(shown <= 0.04045, shown / 12.92, ((np.maximum(shown, 0) + 0.055) / 1.055) ** 2.4)


def from_light(light):
    """Return display values of sRGB for linear light."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 0) ** (1 / 2.4) - 0.055)


def error(colours, truth, groups=None):
    """Return the root mean square difference up to one gain and offset per channel, for all or for each group."""
    groups = np.zeros(len(truth), int) if groups is None else groups
    sizes, total = np.maximum(np.bincount(groups), 1), 0.0
    for shown, wanted in zip(colours.T, truth.T, strict=True):
        shown, wanted = (each - (np.bincount(groups, each) / sizes)[groups] for each in (shown, wanted))
        spread = np.bincount(groups, np.square(shown))
        gain = np.bincount(groups, shown * wanted) / np.maximum(spread, 1e-12)
        total += np.square(gain[groups] * shown - wanted).sum()
    return (total / truth.size) ** 0.5


def fall(before, after, truth, groups=None):
    """Return by how many dB the error falls."""
    return 20 * np.log10(error(before, truth, groups) / error(after, truth, groups))
