"""Compare the defaults with the kernel alone and with denoisers of flat images, on textures and on vertices.

``BELTRAMI_EXTRA_MESHES=FOLDER python benchmarks/bench_patches.py`` judges samples, photographs of scikit-image,
and the models of a folder. Cells have the PSNR over covered texels, within 4 texels of a seam, and the mean CIEDE2000.
The program works on whole surfaces. Peers get a part of larger images, and all methods are judged on this part.

``--sigma`` is the noise, of 255; ``--only TEXT`` takes the models whose names contain it, ``--jobs N`` at a time;
``--no-textures`` and ``--no-vertices`` leave out a table.
"""

import itertools
import os
import sys
import tempfile
import warnings
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
from scipy.ndimage import uniform_filter, zoom

import beltrami_cli
import peers
import textures
from beltrami_cli.arrays import Array, Bools
from beltrami_cli.flow.parameters import parameters_from
from beltrami_cli.formats.registry import open_document
from beltrami_cli.jobs.job import Job
from beltrami_cli.jobs.noise.file import noise_file
from beltrami_cli.jobs.settings import NoiseSettings
from harness import SAMPLES, Row, arguments, extra_models, psnr, show
from pixels import PHOTOGRAPHS, WINDOW, on_sphere, photograph
from textures import TexturedScene
from vertices import Scene, icosphere, write_ply

SUBDIVISIONS = 6  # of the icosphere: 40,962 vertices
MARGIN = 20  # texels around the judged part that peers also get: half of BM3D's window
MAX_COMPARED = 40_000  # maximum number of texels for the mean CIEDE2000
ROUNDING = float(10 * np.log10(12 * 255**2))  # dB: PSNR of colours that are rounded to 8 bit
PEERS = {"bilateral": peers.bilateral, "non-local means": peers.nonlocal_means, "BM3D": peers.bm3d}
OURS = {"`--patches off`": "off", "default": "auto"}

Figures = tuple[float, float, float]  # PSNR, PSNR near seams, CIEDE2000
Judged = tuple[str, dict[str, Figures]]  # the name of an input, and figures by method


def main() -> None:
    options = arguments(
        __doc__, sigma=20, only="", jobs=os.cpu_count() or 1, no_textures=False, no_vertices=False
    )
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    with ProcessPoolExecutor(options.jobs) as pool, tempfile.TemporaryDirectory() as folder:
        if not options.no_textures:
            names = [name for name in textures.scene_names() if options.only in name]
            judged = itertools.chain.from_iterable(pool.map(partial(judge_textures, options.sigma), names))
            show(rows_of(judged, ("input", *PEERS, *OURS)), options, ("model", "input", *PEERS, *OURS))
        if not options.no_vertices:
            paths = [path for path in write_vertices(Path(folder)) if options.only in path.name]
            on_vertices = pool.map(partial(judge_vertices, options.sigma), paths)
            show(rows_of(on_vertices, ("input", *OURS)), options, ("vertices", "input", *OURS))


def rows_of(judged: Iterable[Judged], methods: Sequence[str]) -> list[Row]:
    """Return rows of figures and their means; each row is printed to stderr as soon as it is known."""
    found = []
    for name, figures in judged:
        found.append((name, np.array([figures.get(method, (np.nan,) * 3) for method in methods])))
        print(name, *map(as_cell, found[-1][1]), sep=" | ", file=sys.stderr, flush=True)
    with warnings.catch_warnings(action="ignore"):  # means of peers that are not installed
        found.append(("mean", np.nanmean([values for _, values in found], axis=0)))
    return [(name, *map(as_cell, values)) for name, values in found]


def as_cell(figures: Array) -> str:
    return " / ".join("-" if np.isnan(value) else f"{value:.2f}" for value in figures)


def judge_textures(sigma: float, name: str) -> list[Judged]:
    """Judge the images of a scene with noise of `sigma` of 255; return names and figures by method."""
    scene = textures.scene_of(name)
    if scene is None:
        return []
    noisy = textures.noisy_images(scene, sigma / 255)
    ours = {method: smoothed_images(scene, noisy, patches) for method, patches in OURS.items()}
    judged = []
    for number in textures.judged_images(scene):
        where = textures.part(scene, number, WINDOW)
        clean = scene.clean[number][where]
        masks = scene.covered[number][where], scene.near_seams[number][where]
        results = {
            "input": noisy[number][where],
            **peer_results(noisy[number], where, clean, masks[0], sigma),
        }
        results |= {method: images[number][where] for method, images in ours.items()}
        figures = {method: judge(image, clean, masks) for method, image in results.items()}
        judged.append((f"{Path(name).name.split('.')[0]} {number + 1}", figures))
    return judged


def smoothed_images(scene: TexturedScene, noisy: list[Array], patches: str) -> list[Array]:
    """Return the 8-bit images of a scene after ``beltrami smooth IN OUT``."""
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "noisy.obj", Path(folder) / "smooth.obj"
        textures.write_obj(source, scene, noisy)
        smooth(source, target, patches)
        return [to_8_bit(image) for image in textures.read_images(target)]


def smooth(source: Path, target: Path, patches: str) -> None:
    """Smooth a file on one thread by default parameters, except for `patches`."""
    settings = beltrami_cli.SmoothSettings(parameters_from({"patches": patches, "threads": 1}))
    beltrami_cli.smooth_file(source, target, settings, job=Job(overwrite=True))


def peer_results(
    noisy: Array, where: tuple[slice, slice], clean: Array, covered: Bools, sigma: float
) -> dict[str, Array]:
    around = tuple(slice(max(0, each.start - MARGIN), each.stop + MARGIN) for each in where)
    inner = tuple(slice(w.start - a.start, w.stop - a.start) for w, a in zip(where, around, strict=True))
    results = {}
    for name, run in PEERS.items():
        tried: list[Array] = []

        def score(image: Array, tried: list[Array] = tried) -> tuple[float, int]:
            tried.append(to_8_bit(image)[inner])
            return psnr_within(covered, tried[-1], clean), len(tried) - 1

        try:
            _, best = run(np.ascontiguousarray(noisy[around]), score, sigma=sigma / 255)
        except peers.PeerError as missing:
            print(missing, file=sys.stderr)
            continue
        results[name] = tried[best]
    return results


def to_8_bit(image: Array) -> Array:
    """Return an image as it is stored: clipped and rounded for all methods."""
    return np.rint(np.clip(image, 0, 1) * 255).astype(np.uint8)


def psnr_within(mask: Bools, image: Array, clean: Array) -> float:
    """Return the PSNR over a mask, at most that of rounding to 8 bit."""
    return min(psnr(image / 255, clean, mask), ROUNDING) if mask.any() else np.nan


def judge(image: Array, clean: Array, masks: tuple[Bools, Bools]) -> Figures:
    """Return the PSNR over covered texels, near seams, and the mean CIEDE2000 over evenly chosen texels."""
    color = peers.needed("skimage.color")
    chosen = slice(None, None, max(1, int(masks[0].sum()) // MAX_COMPARED))
    shown = (color.rgb2lab(colours[masks[0]][chosen]) for colours in (image / 255, clean))
    covered, near_seams = (psnr_within(mask, image, clean) for mask in masks)
    return covered, near_seams, float(color.deltaE_ciede2000(*shown).mean())


def judge_vertices(sigma: float, path: Path) -> Judged:
    figures = {}
    with tempfile.TemporaryDirectory() as folder:
        noisy, target = Path(folder) / "noisy.ply", Path(folder) / "smooth.ply"
        noise_file(path, noisy, NoiseSettings(sigma=sigma / 255), job=Job(overwrite=True))
        clean = vertex_colours(path)
        masks = np.ones(len(clean), bool), np.zeros(len(clean), bool)
        figures["input"] = judge(to_8_bit(vertex_colours(noisy)), clean, masks)
        for method, patches in OURS.items():
            smooth(noisy, target, patches)
            figures[method] = judge(to_8_bit(vertex_colours(target)), clean, masks)
    return path.name.split("-clean")[0], figures


def vertex_colours(path: Path) -> Array:
    return np.asarray(open_document(str(path)).coloured_vertices().colours)[:, :3]


def write_vertices(folder: Path) -> Iterator[Path]:
    """Yield PLY files with coloured vertices: photographs on an icosphere, samples, and models of the extra folder."""
    for name in PHOTOGRAPHS:
        image, sphere = photograph(name), icosphere(SUBDIVISIONS)
        wanted = 2 * np.sqrt(len(sphere.positions) / 2 / np.pi)  # pixels across a hemisphere
        factor = wanted / min(image.shape[:2])
        # Averages over the area of a vertex, which prevents aliasing.
        blurred = uniform_filter(image, (round(1 / factor), round(1 / factor), 1))
        colours = on_sphere(np.clip(zoom(blurred, (factor, factor, 1), order=1), 0, 1), sphere.positions)
        write_ply(folder / f"{name}.ply", Scene(sphere.positions, sphere.faces, colours, colours))
        yield folder / f"{name}.ply"
    for path in [*sorted(SAMPLES.glob("*-clean.ply")), *extra_models({".ply"})]:
        document = open_document(str(path))
        if document.has_vertex_colours() and not document.slots():
            yield path


if __name__ == "__main__":
    main()
