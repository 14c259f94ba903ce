"""How good the chosen parameters are where textures went through JPEG after noise came in.

``python benchmarks/bench_jpeg.py`` prints the table of docs/tuning.md. Textured models in the folder that the
environment variable BELTRAMI_EXTRA_MESHES names are judged, too, up to a size. Noise is Gaussian, on texels of the
textures; the truth is what these were before.
"""

from __future__ import annotations

import argparse
import itertools
import tempfile
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import texture_files
import tuning_scene
from bench_textures import scenes
from patch_scenes import PHOTOGRAPHS, photograph_in_charts

import beltrami_cli.flow.parameters as kernel
from beltrami_cli.flow.beltrami_flow import smooth_in_place
from beltrami_cli.flow.decoding import decodes_again, plan_on_canvas
from beltrami_cli.formats.image.jpeg import read_jpeg_tables
from beltrami_cli.formats.registry import open_document
from beltrami_cli.layers.picture_layer import coded_pictures
from beltrami_cli.surface.atlas import build_atlas

SUBSAMPLINGS = {"4:4:4": 0x111111, "4:2:0": 0x221111}
STORED = ((80, "4:4:4"), (80, "4:2:0"), (92, "4:4:4"), (92, "4:2:0"))
SIGMAS = (5, 10, 20)
# Contrasts, growths and numbers of iterations that are tried by the truth; with two regularised iterations and t = 8.
TRIED = ((0.7, 1.4), (1.5, 3.0), (3, 8))


@dataclass(frozen=True)
class Row:
    """PSNR of a texture: as stored, by the fixed rule, as chosen without and with patches, and best by the truth."""

    name: str
    stored: float
    fixed: float
    chosen: float
    default: float
    best: float

    @property
    def values(self):
        """Return the figures."""
        return self.stored, self.fixed, self.chosen, self.default, self.best


def main():
    """Judge all scenes; print a table."""
    parser = argparse.ArgumentParser(description="Judge the choice of parameters on JPEG textures.")
    parser.add_argument("--sigma", type=int, nargs="+", default=SIGMAS, help="of the noise, of 255")
    parser.add_argument("--most", type=int, default=600_000, help="texels of a texture (default: 600000)")
    parser.add_argument("--only", default="", help="names that begin so")
    parser.add_argument(
        "--photographs", action="store_true", help="those of scikit-image around a sphere instead"
    )
    options = parser.parse_args()
    found = map(photograph_in_charts, PHOTOGRAPHS) if options.photographs else scenes(False)
    found = [scene for scene in found if scene.name.startswith(options.only)]
    print(
        "| JPEG | sigma | as stored | `--fast` | `--patches off` | default | best kernel by the truth |\n| --- "
        + "| ---: " * 6
        + "|"
    )
    atlases = {scene.name: atlas_of(scene) for scene in found}
    found = [scene for scene in found if len(atlases[scene.name].owned_texels) <= options.most]
    for (quality, subsampling), sigma in itertools.product(STORED, options.sigma):
        rows = [judge(scene, atlases[scene.name], quality, subsampling, sigma) for scene in found]
        means = " | ".join(f"{value:.2f}" for value in np.mean([row.values for row in rows], axis=0))
        print(f"| {quality}, {subsampling} | {sigma} | {means} |", flush=True)


def atlas_of(scene):
    """Return the atlas of a scene's base colours."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "clean.glb"
        texture_files.write_glb(path, scene, [levels(image) for image in scene.clean])
        surface = open_document(str(path)).textured("baseColor")
    sizes = [(image.shape[1], image.shape[0]) for image in scene.clean]
    return build_atlas(surface, sizes, tuning_scene.MARGIN, 2)


def judge(scene, atlas, quality, subsampling, sigma):
    """Measure a scene with noise, stored as JPEG."""
    noisy = [levels(tuning_scene.with_noise(levels(image) / 255, sigma / 255, 5)) for image in scene.clean]
    clean = texels([levels(image) for image in scene.clean], atlas)
    files = [jpeg(image, quality, SUBSAMPLINGS[subsampling]) for image in noisy]
    pixels = [cv2.imdecode(file, cv2.IMREAD_COLOR)[..., ::-1] for file in files]
    tables, stored = [read_jpeg_tables(file.tobytes()) for file in files], texels(pixels, atlas)

    def reached(**parameters):
        own = kernel.KernelParameters(**parameters)

        canvas = tuning_scene.canvas_of(atlas, stored, own)
        coded = coded_pictures(atlas, list(zip(pixels, tables, strict=True))) if decodes_again(own) else ()
        plan = plan_on_canvas(canvas, coded)
        return tuning_scene.psnr(smooth_in_place(plan).manifold.new_colours().table(), clean)

    best = max(
        reached(iterations=count, t=8.0, beta=255 * contrast / sigma, beta_growth=growth, metric_steps=2)
        for contrast, growth, count in itertools.product(*TRIED)
    )
    free = kernel.TUNABLE
    found = [reached(free=free, **more) for more in ({"fast": True}, {"patches": "off"}, {})]
    return Row(scene.name, tuning_scene.psnr(stored, clean), *found, best)


def levels(image):
    """Return an image in 8 bit."""
    return np.rint(255 * np.asarray(image)).astype(np.uint8)


def jpeg(pixels, quality, subsampling):
    """Return RGB pixels as a JPEG file."""
    options = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, subsampling]
    return cv2.imencode(".jpg", pixels[..., ::-1], options)[1]


def texels(images, atlas):
    """Return the colours of the owned texels, in [0, 1]."""
    return (np.concatenate([image.reshape(-1, 3) for image in images])[atlas.owned_texels] / 255).astype(
        np.float32
    )


if __name__ == "__main__":
    main()
