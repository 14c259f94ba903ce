"""Train the network that reads noise, print how well it reads, and write its weights.

``python noise_model/train.py FOLDER...`` takes clean pictures from folders of unpacked packages; `make noise-model`
fetches them. Training needs NumPy, SciPy and Pillow. This command made the weights in the package.

Pictures (`pictures`) are drawn from crops of files (`crops`), and noise is added to them (`noises`) by random recipes
(`recipes`). They are cut into squares (`observations`) or sampled on flat meshes (`surfaces`). Batches of these
(`batches`) train the network by its losses (`losses`, `backpropagation`), and `table` judges it by kind of noise.
`train_sizes` trains the second network, on further kinds (`size_kinds`). `configuration` lists the code that training
runs, with which `stamp` marks the weights.
"""

from __future__ import annotations

import argparse
import os
import time
from dataclasses import replace
from functools import cache
from multiprocessing import Pool
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

import surfaces
import table
from backpropagation import Adam, Node, Tape, initial_layer, shuffled
from batches import Batch
from beltrami_cli.flow.noise import network
from beltrami_cli.flow.noise.network import Weights, forward
from configuration import WEIGHTS
from crops import Crop, clean_crops, folders_of_packages
from losses import losses
from observations import draw_recipe_of_grids, observation_of, random_samples
from recipes import draw_recipe

OBSERVATIONS = {"grid": 140_000, "cluster": 60_000, "validation": 4_000}  # maximum number for validation
CHUNK = 2_000  # observations that are made together
FIRST_SEED = 300  # of training; lower seeds served to choose features and layers
EPOCHS, BATCH, RATE = 12, 96, 2e-3  # of Adam; the rate is its maximum
SEED = 49
SAMPLES = {"grid": random_samples, "cluster": surfaces.random_samples}
RECIPES = {"grid": draw_recipe_of_grids, "cluster": draw_recipe}
WARM_UP = 500  # steps until the rate is at its height


@cache
def crops_of(roots: tuple[Path, ...], part: str) -> list[Crop]:
    return clean_crops(list(roots), part, SEED)


def make_observations(kind: str, part: str, seed: int, count: int, roots: list[Path]) -> Batch:
    """Make observations of a kind of neighbourhoods, on a part of the pictures in folders."""
    crops = crops_of(tuple(roots), part)
    rng, observations = np.random.default_rng([SEED, seed, part == "training"]), []
    while len(observations) < count:
        drawn = SAMPLES[kind](rng, crops, RECIPES[kind])
        observation = None if drawn is None else observation_of(drawn)
        if observation is not None:
            observations.append(observation)
    return Batch.of(observations)


def initial(
    rng: np.random.Generator, columns: dict[str, int], width: dict[str, int]
) -> dict[str, np.ndarray]:
    """Draw weights, by the number of features of each kind and the units of layers."""
    inner, context = width["square 2"], width["whole 2"]
    inputs = {
        "square 1": columns["squares"], "square 2": width["square 1"], "whole 1": 3 * inner + columns["even"],
        "whole 2": width["whole 1"], "place 1": inner + context, "place 2": width["place 1"],
        "total": context, "deviations": context,
        "correlations": context,
    }  # fmt: skip
    layers = {}
    for name, size in inputs.items():
        layers |= initial_layer(rng, name, size, width.get(name) or network.OUTPUTS[name])
    return layers


def slopes_of(
    chosen: np.ndarray, data: Batch, weights: Weights
) -> tuple[dict[str, float], dict[str, np.ndarray]]:
    """Return the losses of some observations, and the gradients of the weights."""
    (squares, counts, even), truths, candidates = data.take(chosen, weights)
    tape = Tape(weights.layers)
    nodes = forward(tape, Node(squares), counts, Node(even))
    del nodes["context"]  # an intermediate value without a loss
    outputs = {name: node.value for name, node in nodes.items()}
    values, gradients = losses(outputs, truths, candidates)
    for name, node in nodes.items():
        node.gradient = gradients[name]
    tape.go_back()
    return values, tape.gradients


def train(kind: str, training: Batch, validation: Batch, epochs: int) -> Weights:
    rng = np.random.default_rng(SEED)
    means, scales = training.standard()
    columns = {name: len(mean) for name, mean in means.items()}
    weights = Weights(initial(rng, columns, network.WIDTHS[kind]), means, scales)
    for data in (training, validation):
        data.standardise_in_place(weights)
    adam = Adam(weights.layers, RATE, epochs * (len(training.counts) // BATCH), WARM_UP)
    began = time.monotonic()
    for epoch in range(epochs):
        sums = []
        for chosen in shuffled(rng, len(training.counts), BATCH):
            values, gradients = slopes_of(chosen, training, weights)
            sums.append(values)
            adam.step(gradients)
        if epoch % 5 == 4 or epoch == epochs - 1:
            valued, _ = slopes_of(np.arange(len(validation.counts)), validation, weights)
            line = ", ".join(
                f"{name} {np.mean([values[name] for values in sums]):.4f} / {value:.4f}"
                for name, value in valued.items()
            )
            print(f"epoch {epoch + 1}, {time.monotonic() - began:.0f} s: {line}", flush=True)
    return weights


def rounded(weights: Weights) -> Weights:
    """Round layers to eight significant bits, which compress better."""
    layers = {}
    for name, values in weights.layers.items():
        digits, exponents = np.frexp(values)
        layers[name] = np.ldexp(np.rint(digits * 256) / 256, exponents)
    return replace(weights, layers=layers)


def save(weights: Weights, path: Path) -> None:
    arrays = {f"layer/{name}": values.astype(np.float16) for name, values in weights.layers.items()}
    for kind, parts in (("mean", weights.means), ("scale", weights.scales)):
        arrays |= {f"{kind}/{name}": values.astype(np.float32) for name, values in parts.items()}
    np.savez_compressed(path, **arrays)


def parser_of(description: str) -> argparse.ArgumentParser:
    """Return the options that the training of both networks has."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("folders", nargs="+", type=Path, help="with pictures")
    parser.add_argument("--kinds", nargs="+", default=list(SAMPLES), choices=list(SAMPLES))
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--weights", type=Path, default=WEIGHTS, help="the folder that they are written to")
    return parser


def train_kind(kind: str, roots: list[Path], options: argparse.Namespace) -> None:
    began = time.monotonic()
    count = options.observations or OBSERVATIONS[kind]
    size = min(CHUNK, count)
    jobs = [(kind, "training", FIRST_SEED + number, size, roots) for number in range(max(1, count // size))]
    jobs.append((kind, "validation", 0, min(count, OBSERVATIONS["validation"]), roots))
    with Pool(options.processes) as pool:
        *parts, validation = pool.starmap(make_observations, jobs, chunksize=1)
    training = Batch.joined(parts)
    size = f"{len(training.counts)} observations, {training.starts[-1]} neighbourhoods"
    print(f"{kind}: {size}: {time.monotonic() - began:.0f} s", flush=True)
    del parts
    path = options.weights / f"{kind}_weights.npz"
    save(rounded(train(kind, training, validation, options.epochs)), path)
    print(f"{path.stat().st_size / 1024:.0f} KB written after {time.monotonic() - began:.0f} s", flush=True)
    table.main(roots, options.judged, kind, Weights.load(path))


if __name__ == "__main__":
    parser = parser_of("Train the network that reads noise.")
    parser.add_argument("--observations", type=int, help="of each kind")
    parser.add_argument("--epochs", type=int, default=EPOCHS)
    parser.add_argument(
        "--judged", default="test", choices=["validation", "test"], help="the part that is judged"
    )
    options = parser.parse_args()
    for kind in options.kinds:
        train_kind(kind, [*options.folders, *folders_of_packages()], options)
