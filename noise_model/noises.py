"""The steps of a recipe, applied to a clean image."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from PIL import Image
from scipy.ndimage import convolve, gaussian_filter, median_filter, uniform_filter

from beltrami_cli.flow.noise.jpeg_traces import LUMA
from recipes import MEDIAN, Recipe

ONE_CHANNEL = 0.12  # share of the images that have one channel, or are grey

# Kernels of resampling, by number.
KERNELS = (
    Image.Resampling.BILINEAR,
    Image.Resampling.BICUBIC,
    Image.Resampling.LANCZOS,
    Image.Resampling.BOX,
)

# Texels per side of the window of a Wiener filter, and of the window in which the noise that it assumes is measured.
_WIENER_SIDE, _NOISE_SIDE = 5, 25


@dataclass(frozen=True)
class NoisyColours:
    """A noisy image, its noise before clipping, and the error of compression alone."""

    noisy: np.ndarray  # (R, C, 3)
    noise: np.ndarray
    loss: np.ndarray  # error of the same compression without noise

    def mapped(self, change: Callable[[np.ndarray], np.ndarray]) -> NoisyColours:
        return NoisyColours(*map(change, (self.noisy, self.noise, self.loss)))


def to_linear(x: np.ndarray) -> np.ndarray:
    return np.where(x <= 0.04045, x / 12.92, ((np.maximum(x, 0) + 0.055) / 1.055) ** 2.4).astype(np.float32)


def to_srgb(x: np.ndarray) -> np.ndarray:
    """Encode as sRGB; the curve continues below 0 and above 1."""
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 0.0031308) ** (1 / 2.4) - 0.055).astype(
        np.float32
    )


def of_one_channel(clean: np.ndarray, recipe: Recipe) -> tuple[np.ndarray, Recipe]:
    """Replace all channels by the first, with the same noise in all."""
    shared = replace(recipe, correlation=1.0, gains=(1.0, 1.0, 1.0), mosaic="")
    return np.repeat(clean[..., :1], 3, axis=2), shared


def degrade(rng: np.random.Generator, clean: np.ndarray, recipe: Recipe) -> NoisyColours:
    """Apply a recipe to a clean image. The noise is the difference from the same steps without noise."""
    pair = np.stack([clean, clean])  # with noise, without
    is_linear = recipe.is_linear or bool(recipe.mosaic and recipe.power)
    if is_linear:
        pair = to_linear(pair)
    if recipe.saturation:
        pair = _saturated(pair, 1 / (1 + recipe.saturation))
    if recipe.sigma:
        pair[0] += _noise(rng, pair[1], recipe)
    if recipe.impulses:
        _add_impulses_in_place(rng, pair[0], recipe)
    if recipe.mosaic:
        pair = np.stack([_demosaiced(each.clip(0, None), recipe.mosaic) for each in pair])
    if recipe.saturation:
        pair = _saturated(pair, 1 + recipe.saturation)
    if is_linear:
        pair = to_srgb(pair)
    if recipe.contrast:
        pair = pair - np.float32(recipe.contrast / (2 * np.pi)) * np.sin(2 * np.pi * pair.clip(0, 1))
    if recipe.resampled != 1:
        pair = np.stack([_resized(each, recipe.resampled, recipe.kernel) for each in pair])
    if recipe.luma or recipe.chroma:
        pair = _denoised_in_camera(pair, recipe)
    if recipe.denoised == MEDIAN:
        pair = median_filter(pair, (1, 3, 3, 1))
    elif recipe.denoised:
        pair = gaussian_filter(pair, (0, recipe.denoised, recipe.denoised, 0))
    if recipe.sharpened:
        pair = pair + np.float32(recipe.sharpened) * (pair - gaussian_filter(pair, (0, 1, 1, 0)))
    if recipe.transfer:
        pair = (to_linear if recipe.transfer == "to linear" else to_srgb)(pair)
    return _stored(pair, recipe)


def _add_impulses_in_place(rng: np.random.Generator, noisy: np.ndarray, recipe: Recipe) -> None:
    hit = rng.random(noisy.shape[:2]) < recipe.impulses
    if recipe.are_impulses_bright:
        noisy[hit] = np.maximum(noisy[hit], rng.uniform(0.5, 1, hit.sum())[:, None])
    else:
        noisy[hit] = rng.integers(0, 2, hit.sum())[:, None]


def _saturated(pair: np.ndarray, factor: float) -> np.ndarray:
    """Multiply the differences of the channels from their mean."""
    mean = pair.mean(axis=3, keepdims=True)
    return (mean + np.float32(factor) * (pair - mean)).astype(np.float32)


def _denoised_in_camera(pair: np.ndarray, recipe: Recipe) -> np.ndarray:
    """Blur chroma, and apply a Wiener filter to luma, which leaves noise near edges and on texture."""
    luma = pair @ LUMA
    chroma = gaussian_filter(pair - luma[..., None], (0, recipe.chroma, recipe.chroma, 0))
    noise = recipe.luma * uniform_filter(np.square(luma[0] - luma[1]), _NOISE_SIDE)
    mean = uniform_filter(luma, (0, _WIENER_SIDE, _WIENER_SIDE))
    energy = uniform_filter(np.square(luma - mean), (0, _WIENER_SIDE, _WIENER_SIDE))
    kept = np.maximum(0, 1 - noise / np.maximum(energy, 1e-9))
    return (chroma + (mean + kept * (luma - mean))[..., None]).astype(np.float32)


def _stored(pair: np.ndarray, recipe: Recipe) -> NoisyColours:
    """Clip, quantise and compress a pair."""
    stored = pair.clip(0, 1) if recipe.bits else pair.clip(0, None)
    if recipe.bits:
        stored = np.rint(stored * 255).astype(np.float32) / 255
    if not recipe.codec:
        # The noise is taken before clipping and rounding.
        return NoisyColours(stored[0], pair[0] - pair[1], np.zeros_like(pair[0]))
    coded, reference = np.stack([_coded(each, recipe) for each in stored]), stored[1]
    if recipe.second_quality:
        coded, reference = (each[..., recipe.shifted :, recipe.shifted :, :] for each in (coded, reference))
        coded = np.stack([_coded(each, replace(recipe, quality=recipe.second_quality)) for each in coded])
    if recipe.after_codec != 1:
        coded = np.stack([_resized(each, recipe.after_codec, 1).clip(0, 1) for each in coded])
        reference = _resized(reference, recipe.after_codec, 1).clip(0, 1)
        coded = np.rint(coded * 255).astype(np.float32) / 255
    return NoisyColours(coded[0], coded[0] - reference, coded[1] - reference)


def _noise(rng: np.random.Generator, clean: np.ndarray, recipe: Recipe) -> np.ndarray:
    if recipe.tail == "binomial":
        rays = round(2**recipe.shape)
        noise = rng.binomial(rays, clean.clip(0, 1).mean(axis=2, keepdims=True)) / rays
        return (noise - clean.mean(axis=2, keepdims=True)).astype(np.float32).repeat(3, axis=2)
    if recipe.tail == "poisson":
        photons = np.float32(2**recipe.shape)
        return (rng.poisson(photons * clean.clip(0, None)) / photons - clean).astype(np.float32)
    noise = _field(rng, clean.shape, recipe)
    if recipe.places == "blend":  # of two exposures, one of them quieter
        quieter = _field(rng, clean.shape, recipe) * np.float32(recipe.place_gain)
        mask = _mask(rng, clean.shape, "blob")
        noise = mask * noise + (1 - mask) * quieter
    elif recipe.places:
        mask = _mask(rng, clean.shape, recipe.places)
        noise *= recipe.place_gain + (1 - recipe.place_gain) * mask
    if recipe.power:
        level = np.maximum(clean, 0) ** (recipe.power / 2)
        noise *= np.sqrt(
            recipe.floor**2 + (1 - recipe.floor**2) * np.square(level / 0.5 ** (recipe.power / 2))
        )
    return noise * np.array(recipe.gains, np.float32) * np.float32(recipe.sigma)


def _field(rng: np.random.Generator, shape: tuple[int, ...], recipe: Recipe) -> np.ndarray:
    """Draw a field of noise of variance 1, with channels and neighbours correlated."""
    height, width = shape[:2]
    if recipe.grain > 1:
        height, width = (max(2, round(size / recipe.grain)) for size in (height, width))
    size = (height, width, 3)
    if recipe.correlation == 1:
        field = np.repeat(_drawn(rng, (height, width, 1), recipe), 3, axis=2)
    elif recipe.correlation < 0:
        field = _drawn(rng, size, recipe)
        mean = field.mean(axis=2, keepdims=True)
        field = np.sqrt(1 - recipe.correlation) * (field - mean) + np.sqrt(1 + 2 * recipe.correlation) * mean
    else:
        field = np.sqrt(1 - recipe.correlation) * _drawn(rng, size, recipe)
        if recipe.correlation:
            field += np.sqrt(recipe.correlation) * _drawn(rng, (height, width, 1), recipe)
    field = field.astype(np.float32)
    if recipe.grain > 1:
        field = to_size(field, shape[1], shape[0], recipe.kernel)
    elif recipe.cut_off:
        down, across = np.fft.fftfreq(height)[:, None] * 2, np.fft.rfftfreq(width) * 2
        passed = np.exp(-(down**2 + across**2) / (2 * recipe.cut_off**2))
        passed = 1 - passed if recipe.is_high_pass else passed
        field = np.fft.irfft2(
            np.fft.rfft2(field, axes=(0, 1)) * passed[..., None], (height, width), axes=(0, 1)
        )
    return (field / max(1e-6, float(field.std()))).astype(np.float32)


def _drawn(rng: np.random.Generator, size: tuple[int, ...], recipe: Recipe) -> np.ndarray:
    """Draw independent numbers of mean 0 and, nearly, variance 1."""
    if recipe.tail == "student":
        return rng.standard_t(recipe.shape, size) / np.sqrt(recipe.shape / (recipe.shape - 2))
    if recipe.tail == "gamma":
        shape = recipe.shape / 4
        return (rng.standard_gamma(shape, size) - shape) / np.sqrt(shape)
    if recipe.tail == "laplace":
        return rng.laplace(0, np.sqrt(0.5), size)
    return rng.standard_normal(size, np.float32)


def _mask(rng: np.random.Generator, shape: tuple[int, ...], kind: str) -> np.ndarray:
    """Draw a mask of the strength of the noise, from 0 to 1."""
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float32)
    if kind == "chess":
        side = int(rng.integers(24, 128))
        mask = (y // side + x // side) % 2
    elif kind == "halves":
        angle = rng.uniform(0, 2 * np.pi)
        middle = rng.uniform(0.2, 0.8) * shape[0], rng.uniform(0.2, 0.8) * shape[1]
        mask = (y - middle[0]) * np.sin(angle) + (x - middle[1]) * np.cos(angle) > 0
    elif kind == "part":  # a rectangle of 5 to 60 % of the image
        sides = np.sqrt(np.exp(rng.uniform(*np.log((0.05, 0.6))))) * np.exp(
            rng.uniform(-0.7, 0.7) * np.array([1, -1])
        )
        sides = np.minimum(sides, 1)
        first = (rng.uniform(0, 1, 2) * (1 - sides) * shape[:2]).astype(int)
        last = first + np.ceil(sides * shape[:2]).astype(int)
        mask = np.zeros(shape[:2])
        mask[first[0] : last[0], first[1] : last[1]] = 1
    elif kind == "tiles":
        side, share = int(rng.integers(16, 64)), rng.uniform(0.1, 0.6)
        mask = (rng.random((shape[0] // side + 1, shape[1] // side + 1)) < share)[
            y.astype(int) // side, x.astype(int) // side
        ]
    else:
        coarse = rng.uniform(-0.3, 1.3, (3, 3, 1)).astype(np.float32)
        return np.clip(to_size(coarse, shape[1], shape[0], 1), 0, 1)
    return mask.astype(np.float32)[..., None]


# H. Malvar, L. He, R. Cutler, "High-quality linear interpolation for demosaicing of Bayer-patterned images", 2004,
# times 8: green at red or blue; red at green in rows of red; red at blue.
_GREEN = np.array([[0, 0, -1, 0, 0], [0, 0, 2, 0, 0], [-1, 2, 4, 2, -1], [0, 0, 2, 0, 0], [0, 0, -1, 0, 0]])
_ALONG = np.array(
    [[0, 0, 0.5, 0, 0], [0, -1, 0, -1, 0], [-1, 4, 5, 4, -1], [0, -1, 0, -1, 0], [0, 0, 0.5, 0, 0]]
)
_ACROSS = np.array(
    [[0, 0, -1.5, 0, 0], [0, 2, 0, 2, 0], [-1.5, 0, 6, 0, -1.5], [0, 2, 0, 2, 0], [0, 0, -1.5, 0, 0]]
)


def _demosaiced(colours: np.ndarray, method: str) -> np.ndarray:
    """Sample colours with a Bayer mosaic, and interpolate the missing channels."""
    shape = colours.shape[:2]
    seen = np.zeros((3, *shape), bool)
    seen[0, ::2, ::2] = seen[2, 1::2, 1::2] = seen[1, ::2, 1::2] = seen[1, 1::2, ::2] = True
    raw = np.einsum("crk,rkc->rk", seen, colours).astype(np.float32)
    if method == "bilinear":
        cross, square = (
            np.array([[0, 1, 0], [1, 4, 1], [0, 1, 0]]),
            np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]]),
        )
        planes = [
            convolve(raw * each, (square, cross, square)[c] / 4, mode="mirror") for c, each in enumerate(seen)
        ]
        return np.stack(planes, axis=2).astype(np.float32)
    green, along, down, across = (
        convolve(raw, each / 8, mode="mirror") for each in (_GREEN, _ALONG, _ALONG.T, _ACROSS)
    )
    in_red_rows = np.zeros(shape, bool)
    in_red_rows[::2] = True
    red = np.where(seen[0], raw, np.where(seen[2], across, np.where(in_red_rows, along, down)))
    blue = np.where(seen[2], raw, np.where(seen[0], across, np.where(in_red_rows, down, along)))
    return np.stack([red, np.where(seen[1], raw, green), blue], axis=2).astype(np.float32)


def _resized(colours: np.ndarray, factor: float, kernel: int) -> np.ndarray:
    height, width = (max(8, round(size * factor)) for size in colours.shape[:2])
    return to_size(colours, width, height, kernel)


def to_size(colours: np.ndarray, width: int, height: int, kernel: int) -> np.ndarray:
    planes = (Image.fromarray(np.ascontiguousarray(plane)) for plane in np.moveaxis(colours, 2, 0))
    return np.stack([np.asarray(plane.resize((width, height), KERNELS[kernel])) for plane in planes], axis=2)


def _coded(colours: np.ndarray, recipe: Recipe) -> np.ndarray:
    if recipe.codec == "BC1":
        return _in_blocks_of_four(colours)
    file, options = io.BytesIO(), {"subsampling": recipe.subsampling} if recipe.codec == "JPEG" else {}
    Image.fromarray(np.rint(colours.clip(0, 1) * 255).astype(np.uint8)).save(
        file, recipe.codec, quality=recipe.quality, **options
    )
    return np.asarray(Image.open(file).convert("RGB"), np.float32) / 255


def _in_blocks_of_four(colours: np.ndarray) -> np.ndarray:
    """Keep four colours of each block of 4 x 4 texels, on a line between two of 5, 6 and 5 bits, as BC1 does."""
    result, steps = colours.copy(), np.array([31, 63, 31], np.float32)
    height, width = (size // 4 * 4 for size in colours.shape[:2])
    blocks = (
        colours[:height, :width]
        .reshape(height // 4, 4, width // 4, 4, 3)
        .transpose(0, 2, 1, 3, 4)
        .reshape(-1, 16, 3)
    )
    means = blocks.mean(axis=1, keepdims=True)
    centred = blocks - means
    axis = np.einsum("bik,bij->bkj", centred, centred) @ np.array([0.5, 0.6, 0.4], np.float32)
    axis /= np.linalg.norm(axis, axis=1, keepdims=True) + 1e-9
    along = np.einsum("bik,bk->bi", centred, axis)
    ends = [
        np.rint((means[:, 0] + each[:, None] * axis).clip(0, 1) * steps) / steps
        for each in (along.min(1), along.max(1))
    ]
    palette = np.stack(
        [ends[0] + (ends[1] - ends[0]) * np.float32(share) for share in (0, 1 / 3, 2 / 3, 1)], axis=1
    )
    nearest = np.square(blocks[:, :, None] - palette[:, None]).sum(axis=3).argmin(axis=2)
    chosen = np.rint(np.take_along_axis(palette, nearest[..., None], axis=1) * 255) / 255
    squares = chosen.reshape(height // 4, width // 4, 4, 4, 3).transpose(0, 2, 1, 3, 4)
    result[:height, :width] = squares.reshape(height, width, 3)
    return result.astype(np.float32)
