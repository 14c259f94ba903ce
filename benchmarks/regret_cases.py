"""The cases of `bench_regret`: kinds of noise on images, vertices, clouds and light, and clean images.

Noise is drawn by other code than that of `noise_model`, so that the network is not judged on its own training noise.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
from numpy.random import Generator
from scipy.ndimage import gaussian_filter

import beltrami_cli
from beltrami_cli.arrays import Array
from beltrami_cli.jobs.noise.kinds import jpeg_file
from beltrami_cli.surface.colour_values import linear_to_srgb
from harness import rms
from pixels import PHOTOGRAPHS, Smoothed, colours_of, on_sphere, photograph, smoothed, stored, with_noise
from regret_images import CROP, crops_of, halved, label, paint, pixel_art, plaster, rendered, weave
from vertices import icosphere, mosaic

SIGMAS = tuple(sigma / 255 for sigma in (6, 12, 20))
PHOTONS = 25  # per texel at full scale
RAYS = 16  # per texel of a lightmap
SQUARES = 8, 12, 16  # of a chequer around the sphere
SUBDIVISIONS = 5  # of the sphere: 10,242 vertices
EXACT = 1e-5  # minimum RMS error, which limits the PSNR to 100 dB
Images = Mapping[str, Array]
Noise = Callable[[Array, float, Generator], Array]  # noise on an image, of a strength
OF_FOLDER = {"noisy": 2, "clean": 12}  # number of images


def clipped(colours: Array) -> Array:
    return np.clip(colours, 0, 1)


@dataclass(frozen=True)
class Case:
    """An input, its truth and noise; how it is smoothed, and which of its samples are judged."""

    name: str
    given: Array | bytes  # colours, or the bytes of a JPEG file
    truth: Array
    rms: float = 0.0  # of the noise before clipping
    smooth: Callable[..., Smoothed] = smoothed
    counted: Any = ...
    display: Callable[[Array], Array] = clipped

    def psnr(self, colours: Array | bytes) -> float:
        """Return the PSNR of displayed colours, which may be the bytes of a file."""
        error = self.display(colours_of(colours)).astype(np.float64) - self.display(self.truth)
        return -20 * float(np.log10(max(rms(error[self.counted]), EXACT)))


def kinds(folders: Sequence[Path]) -> dict[str, Iterator[Case]]:
    noisy, clean = (
        {f"{folder.name}/{name}": crop for folder in folders for name, crop in crops_of(folder, count)}
        for count in OF_FOLDER.values()
    )
    photographs = {name: halved(photograph(name)) for name in PHOTOGRAPHS}
    bases = dict(interleaved(photographs, {"paint": paint(), "label": label(0)}, noisy))
    found = {kind: on_images(kind, noise, bases) for kind, noise in NOISES.items()}
    found |= {kind: of_cameras(kind, bases, **camera) for kind, camera in CAMERAS.items()}
    found["chequers on vertices"] = chequers()
    found["vertices"] = noisy_spheres("vertices", photographs, faces=True)
    found["cloud"] = noisy_spheres("cloud", photographs, faces=False)
    found |= {"light": light("light", 0), "light with fireflies": light("light with fireflies", 0.002)}
    found["clean: photographs"] = untouched(photographs)
    found["clean: textures"] = untouched({"weave": weave(), "plaster": plaster(), **clean})
    found["clean: labels"] = untouched({str(seed): label(seed) for seed in range(4)})
    found["clean: pixel art"] = untouched({str(seed): pixel_art(seed) for seed in range(4)})
    found["clean: paint"] = untouched({"grid": paint()})
    found["clean: vertices"] = (of_sphere(name, colours) for name, colours in spheres(photographs))
    found["clean: light"] = (of_light(str(seed), *2 * [rendered(seed)]) for seed in range(3))
    return found


def interleaved(*tables: Images) -> Iterator[tuple[str, Array]]:
    """Yield the first entry of each table, then the second ones."""
    for rank in range(max(map(len, tables))):
        for table in tables:
            yield from islice(table.items(), rank, rank + 1)


def seeded(kind: str, name: object) -> np.random.Generator:
    """Return a generator that does not depend on which other cases are judged."""
    return np.random.default_rng(crc32(f"{kind} {name}".encode()))


def strength(number: int) -> float:
    """Return the strength of noise of a case.

    Strengths alternate in an order that shifts, since kinds of images alternate, too.
    """
    return SIGMAS[(number + number // 3) % 3]


def untouched(clean: Images) -> Iterator[Case]:
    return (Case(name, stored(image), stored(image)) for name, image in clean.items())


def on_images(kind: str, noise: Noise, bases: Images) -> Iterator[Case]:
    for number, (name, clean) in enumerate(bases.items()):
        drawn = noise(clean, strength(number), seeded(kind, name))
        drawn = np.broadcast_to(drawn, clean.shape)
        yield Case(name, stored(clean + drawn), stored(clean), rms(drawn))


def of_cameras(
    kind: str, bases: Images, *, shot: float, read: float, blur: Any, quality: int
) -> Iterator[Case]:
    """Yield JPEG files of a camera that counts photons on a mosaic, and blurs the noise."""
    for number, (name, clean) in enumerate(bases.items()):
        noisy, truth = (
            gaussian_filter(
                with_noise(clean, "camera", shot=scale * shot, read=scale * read, seed=number), blur
            )
            for scale in (1.0, 0.0)
        )
        file = jpeg_file(noisy, quality)
        yield Case(name, file, stored(truth), rms(colours_of(file) - truth))


CAMERAS: dict[str, dict[str, Any]] = {
    "camera JPEG 92": {"shot": 0.01, "read": 0.01, "blur": 0, "quality": 92},
    "camera with denoising JPEG 85": {"shot": 0.02, "read": 0.02, "blur": (0.7, 0.7, 0), "quality": 85},
}


def mixed(share: float, clean: Array, random: Generator) -> Array:
    """Draw noise of variance 1, with a share that is equal in all channels."""
    equal = random.standard_normal((*clean.shape[:2], 1))
    return np.sqrt(share) * equal + np.sqrt(1 - share) * random.standard_normal(clean.shape)


def with_share(share: float) -> Noise:
    return lambda clean, sigma, random: np.asarray(sigma * mixed(share, clean, random))


def photon(clean: Array, sigma: float, random: Generator) -> Array:
    del sigma
    return random.poisson(PHOTONS * clean) / PHOTONS - clean


def by_level(power: float, clean: Array, sigma: float, random: Generator) -> Array:
    """Draw noise in proportion to a power of the level, of `sigma` at half of full scale, equal in channels or not."""
    return sigma * (2 * clean) ** power * mixed(float(random.integers(2)), clean, random)


def heavy_tailed(clean: Array, sigma: float, random: Generator) -> Array:
    return sigma * random.standard_t(3, clean.shape) / np.sqrt(3)


def chroma(clean: Array, sigma: float, random: Generator) -> Array:
    drawn = random.standard_normal(clean.shape)
    return np.sqrt(1.5) * sigma * (drawn - drawn.mean(axis=2, keepdims=True))


def opposite(clean: Array, sigma: float, random: Generator) -> Array:
    return sigma * random.standard_normal((*clean.shape[:2], 1)) * np.array([1, -1, 0])


def monochrome(clean: Array, sigma: float, random: Generator) -> Array:
    """Draw grain that is equal in all channels, and three times as strong at one corner as at the other."""
    down, across = (np.linspace(0, 0.5, size) for size in clean.shape[:2])
    grain = gaussian_filter(random.standard_normal(clean.shape[:2]), 0.5)
    return (sigma * (0.5 + down[:, None] + across) * grain / grain.std())[..., None]


def in_part(clean: Array, sigma: float, random: Generator) -> Array:
    """Draw noise of 1.5 `sigma` in a tenth of the image, in a quarter, or in some tiles, by the strength."""
    rows, columns = clean.shape[:2]
    where: Array = np.zeros((rows, columns, 1))
    if sigma == SIGMAS[2]:
        where[: rows // 2, : columns // 5] = 1
    elif sigma == SIGMAS[1]:
        where[: rows // 2, : columns // 2] = 1
    else:
        tiles = random.random((rows // 32 + 1, columns // 32 + 1)) < 0.25
        where = np.kron(tiles, np.ones((32, 32)))[:rows, :columns, None]
    return 1.5 * sigma * where * random.standard_normal(clean.shape)


def ramp(clean: Array, sigma: float, random: Generator) -> Array:
    return 2 * sigma * np.linspace(0, 1, clean.shape[1])[:, None] * random.standard_normal(clean.shape)


def filtered(clean: Array, sigma: float, random: Generator) -> Array:
    grain = gaussian_filter(random.standard_normal(clean.shape), (0.8, 0.8, 0))
    return sigma * grain / grain.std()


NOISES: dict[str, Noise] = {
    "white independent": with_share(0), "white equal": with_share(1), "white mostly grey": with_share(0.7),
    "photon": photon, "proportional": partial(by_level, 1), "root": partial(by_level, 0.5),
    "heavy-tailed": heavy_tailed, "chroma": chroma, "opposite": opposite, "monochrome by place": monochrome,
    "part": in_part, "ramp": ramp, "filtered": filtered,
}  # fmt: skip


def of_sphere(name: str, clean: Array, noise: Array | float = 0.0, *, faces: bool = True) -> Case:
    sphere = icosphere(SUBDIVISIONS)

    def smooth(colours: Array, **parameters: Any) -> Smoothed:
        result = beltrami_cli.smooth(sphere.positions, sphere.faces if faces else None, colours, **parameters)
        interval = result.choice.interval if result.choice else None
        return Smoothed(result.colours, np.array([*result.noise.values()]), interval)

    return Case(name, stored(clean + noise), stored(clean), rms(noise), smooth)


def chequered(squares: int) -> Array:
    x, y, z = icosphere(SUBDIVISIONS).positions.T
    angles = np.arctan2(y, x) + np.pi, np.arccos(z.clip(-1, 1))
    odd = sum(np.floor(angle * squares / (2 * np.pi)) for angle in angles) % 2
    return np.where(odd[:, None] > 0, [0.75, 0.6, 0.35], [0.2, 0.25, 0.4])


def spheres(photographs: Images) -> Iterator[tuple[str, Array]]:
    positions = icosphere(SUBDIVISIONS).positions
    yield "paint", mosaic(positions)
    for name, image in photographs.items():
        yield name, on_sphere(halved(image), positions)  # about a pixel a vertex
    for squares in SQUARES:
        yield f"{squares} squares", chequered(squares)


def chequers() -> Iterator[Case]:
    for number in range(len(SQUARES) * len(SIGMAS)):
        squares = SQUARES[number // 3]
        clean = chequered(squares)
        noise = strength(number) * seeded("chequers", number).standard_normal(clean.shape)
        yield of_sphere(f"{squares} squares", clean, noise)


def noisy_spheres(kind: str, photographs: Images, *, faces: bool) -> Iterator[Case]:
    for number, (name, clean) in enumerate(islice(spheres(photographs), 1 + len(photographs))):
        noise = strength(number) * seeded(kind, name).standard_normal(clean.shape)
        yield of_sphere(name, clean, noise, faces=faces)


def of_light(name: str, given: Array, truth: Array, counted: Any = ...) -> Case:
    """Return a case of linear light in half precision, which is judged as sRGB."""
    given, truth = (each.astype(np.float16).astype(np.float32) for each in (given, truth))
    noise = rms((linear_to_srgb(given) - linear_to_srgb(truth))[counted])
    return Case(name, given, truth, noise, partial(smoothed, encoding="linear"), counted, linear_to_srgb)


def light(kind: str, fireflies: float) -> Iterator[Case]:
    """Yield light of few rays per texel with a relative noise of a half; a share of fireflies is not judged."""
    for seed in range(4):
        random, truth = seeded(kind, seed), rendered(seed)
        # One ray has a relative noise of 2, as the gamma distribution of shape 1/4 has.
        size = (CROP, CROP, 3) if seed % 2 else (CROP, CROP, 1)
        noisy = truth * random.gamma(RAYS / 4, 4 / RAYS, size)
        hit = random.random((CROP, CROP)) < fireflies
        noisy[hit] = random.uniform(10, 100, (hit.sum(), 1))
        yield of_light(f"{seed}, {'independent' if seed % 2 else 'equal'}", noisy, truth, ~hit)
