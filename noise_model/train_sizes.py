"""Training of the network that reads the size of noise, whose evidence is the reading of the first network."""

from __future__ import annotations

import time
from collections.abc import Iterable
from multiprocessing import Pool
from pathlib import Path

import numpy as np
from scipy.special import ndtr

import observations
from backpropagation import Adam, Node, Tape, initial_layer, shuffled
from beltrami_cli.flow.noise.components import OFFSET
from beltrami_cli.flow.noise.neighbourhoods import ThreeChannels
from beltrami_cli.flow.noise.network import NetworkReading, Weights
from beltrami_cli.flow.noise.size import EDGES, LAYERS, WIDTHS, evidence, sizes_of
from families import FAMILIES
from train import CHANNELS, crops_of, save

TEST_ROWS = 1_000  # maximum per family
CHUNK = 500  # rows that are made together
EPOCHS, BATCH, RATE = 40, 128, 2e-3  # of Adam; the rate is its maximum
WARM_UP = 200  # steps until the rate is at its height
SEED = 77
DROPPED = 0.1  # share of the units of a layer, in training
WIDTH = 0.12  # standard deviation of the labels, in log2 of the strength
# Noise up to which there is certainly none, and from which there is certainly some, in 8-bit steps. Rounding has 0.29.
NONE, SOME = 0.2, 0.8


def make_rows(
    kind: str, part: str, number: int, seed: int, count: int, roots: list[Path], weights: Weights
) -> list[np.ndarray]:
    """Draw noisy colours of a family; return evidence, first readings, and the true RMS noise in 8-bit steps."""
    family = FAMILIES[kind][number]
    crops = crops_of(tuple(roots), part)
    rng = np.random.default_rng([SEED, seed, part == "training", number])
    rows: list[tuple[np.ndarray, float, float]] = []
    while len(rows) < count:
        drawn = CHANNELS[kind](rng, crops, family.draw, family.make_image)
        if drawn is None or drawn.noisy.scales[0].freedom.sum() < observations.MIN_DETAILS:
            continue
        truth = np.sqrt(max(0.0, _mean_square(drawn.noise) - _mean_square(drawn.loss)))
        rows.append((*evidence(drawn.noisy, NetworkReading.of(drawn.noisy, weights)), truth))
    return [np.stack(column) for column in zip(*rows, strict=True)]


def _mean_square(channels: ThreeChannels | None) -> float:
    return 0.0 if channels is None else float(np.mean(np.square(channels.colours, dtype=np.float64)))


def labels_of(truth: np.ndarray, first: np.ndarray) -> np.ndarray:
    logs = np.log2((truth + OFFSET) / (first + OFFSET)).clip(EDGES[0] + WIDTH, EDGES[-1] - WIDTH)
    shares = np.diff(ndtr((EDGES - logs[:, None]) / WIDTH), axis=1)
    none = np.clip((SOME - truth) / (SOME - NONE), 0, 1)[:, None]
    some = (1 - none) * shares / shares.sum(axis=1, keepdims=True)
    return np.concatenate([none, some], axis=1).astype(np.float32)


def train(rows: np.ndarray, first: np.ndarray, truth: np.ndarray) -> Weights:
    rng, labels = np.random.default_rng(SEED), labels_of(truth, first)
    sizes = rows.shape[1], *WIDTHS, labels.shape[1]
    layers: dict[str, np.ndarray] = {}
    for name, inputs, outputs in zip(LAYERS, sizes, sizes[1:], strict=False):
        layers |= initial_layer(rng, name, inputs, outputs)
    means, scales = {"evidence": rows.mean(axis=0)}, {"evidence": rows.std(axis=0) + np.float32(1e-3)}
    weights = Weights(layers, means, scales)
    adam = Adam(layers, RATE, EPOCHS * (len(rows) // BATCH), WARM_UP)
    standardised = weights.standardised("evidence", rows)
    for _ in range(EPOCHS):
        for chosen in shuffled(rng, len(rows), BATCH):
            tape, logits = Tape(layers), Node(standardised[chosen])
            for name in LAYERS:
                logits = tape.dense(logits, name, is_last=name == LAYERS[-1])
                if name != LAYERS[-1]:
                    logits = tape.dropped(logits, rng.random(logits.value.shape) < DROPPED)
            shares = np.exp(logits.value - logits.value.max(axis=1, keepdims=True))
            excess = shares / shares.sum(axis=1, keepdims=True) - labels[chosen]
            logits.gradient = excess / np.float32(BATCH)
            tape.go_back()
            adam.step(tape.gradients)
    return weights


# PSNR in dB that is lost if the given noise differs from the true noise by a factor, by log2 of the factor; measured on
# 26 crops of photographs and a game's atlas.
RATIOS = (-6, -2, -1.2, -0.62, -0.23, 0, 0.26, 0.49, 0.77, 1.32, 2.5)
COSTS = (5.4, 4.5, 3.2, 1.8, 0.5, 0.05, 0, 0.6, 1.4, 3, 6)
# Harmless PSNR to a clean input in dB, and the share of the given noise that kernels remove from clean images.
HARMLESS, TAKEN = 42, 0.45


def judge(weights: Weights, rows: np.ndarray, first: np.ndarray, truth: np.ndarray) -> None:
    """Print the PSNR lost by misreadings, and how often noise is missed or found in clean images."""
    sizes = sizes_of(weights, rows, first)
    median, low, high = (np.array([size.quantile(share) for size in sizes]) for share in (0.5, 0.05, 0.95))
    none = np.array([size.none for size in sizes])
    noisy, clean = truth > 1.5, truth < NONE
    for most in (0.1, 0.2, 0.3, 0.5):
        assumed = np.where(none < most, 1.1 * median, 0)
        ratios = np.log2((assumed + 0.1) / (truth + 0.1))
        lost = np.interp(ratios, RATIOS, COSTS) * np.clip(truth / 6, 0.2, 1)  # little noise costs less
        harm = np.maximum(0, HARMLESS - 20 * np.log10(255 / np.maximum(TAKEN * assumed, 1e-3)))
        print(
            f"none above {most}: noisy images lose {lost[noisy].mean():.2f} dB, clean ones {harm[clean].mean():.2f};"
            f" noise above 4 is not found in {np.mean(assumed[truth > 4] == 0):.1%},"
            f" clean is touched in {np.mean(assumed[clean] > 2):.1%}"
        )
    holds = (low - OFFSET <= truth) & (truth <= high + OFFSET)
    near = np.abs(median / np.maximum(truth, 1e-9) - 1) < 0.25
    print(f"90 % interval holds for {holds[noisy].mean():.1%}; within 25 % are {near[truth > 3].mean():.1%}")


def train_kind(kind: str, roots: list[Path], folder: Path, *, count: int | None, processes: int) -> None:
    """Write the weights of a kind to a folder that has those of `train`; `count`: of rows of each family."""
    began, families = time.monotonic(), range(len(FAMILIES[kind]))
    first = Weights.load(folder / f"{kind}_weights.npz")
    jobs = []
    for number in families:
        wanted = count or FAMILIES[kind][number].rows
        for part, rows in (("training", wanted), ("test", min(wanted, TEST_ROWS))):
            size = min(CHUNK, rows)
            jobs += [(kind, part, number, seed, size, roots, first) for seed in range(rows // size)]
    with Pool(processes) as pool:
        made = list(zip(jobs, pool.starmap(make_rows, jobs, chunksize=1), strict=True))

    def rows_of(part: str, numbers: Iterable[int]) -> list[np.ndarray]:
        chosen = [rows for job, rows in made if job[1] == part and job[2] in numbers]
        return [np.concatenate(own) for own in zip(*chosen, strict=True)]

    training = rows_of("training", families)
    print(f"{kind}: {len(training[0])} rows: {time.monotonic() - began:.0f} s", flush=True)
    weights = train(*training)
    for number in families:
        print(FAMILIES[kind][number].draw.__name__)
        judge(weights, *rows_of("test", [number]))
    save(weights, folder / f"{kind}_sizes.npz")
    print(f"written after {time.monotonic() - began:.0f} s", flush=True)
