"""Training of the network that reads noise."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import cache
from multiprocessing import Pool
from pathlib import Path
from typing import Any

import numpy as np

import grids
import surfaces
from backpropagation import Adam, Node, Tape, initial_layer, shuffled
from batches import Arrays, Batch
from beltrami_cli.flow.noise import network
from beltrami_cli.flow.noise.network import Weights, forward
from crops import clean_crops
from losses import losses
from observations import Observation, observation_of
from recipes import draw_recipe

OBSERVATIONS = {"grid": 140_000, "cluster": 60_000, "validation": 4_000}  # maximum number for validation
CHUNK = 2_000  # observations that are made together
FIRST_SEED = 300  # of training; lower seeds served to choose features and layers
EPOCHS, BATCH, RATE = 12, 96, 2e-3  # of Adam; the rate is its maximum
SEED = 49
CHANNELS = {"grid": grids.random_channels, "cluster": surfaces.random_channels}
RECIPES = {"grid": grids.draw_recipe_of_grids, "cluster": draw_recipe}
WARM_UP = 500  # steps until the rate is at its height


@cache
def crops_of(roots: tuple[Path, ...], part: str) -> list[np.ndarray]:
    return clean_crops(list(roots), part, SEED)


def make_observations(kind: str, part: str, seed: int, count: int, roots: list[Path]) -> Batch:
    """Make observations of a kind of neighbourhoods, on a part of the images in folders."""
    crops = crops_of(tuple(roots), part)
    rng = np.random.default_rng([SEED, seed, part == "training"])
    observations: list[Observation] = []
    while len(observations) < count:
        drawn = CHANNELS[kind](rng, crops, RECIPES[kind])
        observation = None if drawn is None else observation_of(drawn)
        if observation is not None:
            observations.append(observation)
    return Batch.of(observations)


def initial_layers(rng: np.random.Generator, columns: dict[str, int], width: dict[str, int]) -> Arrays:
    """Draw weights, by the number of features of each kind and the units of layers."""
    inner, context = width["local 2"], width["whole 2"]
    inputs = {
        "local 1": columns["local"], "local 2": width["local 1"], "whole 1": 3 * inner + columns["even"],
        "whole 2": width["whole 1"], "place 1": inner + context, "place 2": width["place 1"],
        "total": context, "deviations": context,
        "correlations": context,
    }  # fmt: skip
    layers: Arrays = {}
    for name, size in inputs.items():
        layers |= initial_layer(rng, name, size, width.get(name) or network.OUTPUTS[name])
    return layers


def losses_and_gradients(
    chosen: np.ndarray, data: Batch, weights: Weights
) -> tuple[dict[str, float], Arrays]:
    """Return the losses of some observations, and the gradients of the weights."""
    given, truths, candidates = data.take(chosen, weights)
    tape = Tape(weights.layers)
    nodes = forward(tape, Node(given["local"]), given["counts"], Node(given["even"]))
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
    weights = Weights(initial_layers(rng, columns, network.WIDTHS[kind]), means, scales)
    for data in (training, validation):
        data.standardise_in_place(weights)
    adam = Adam(weights.layers, RATE, epochs * (len(training.counts) // BATCH), WARM_UP)
    began = time.monotonic()
    for epoch in range(epochs):
        sums = []
        for chosen in shuffled(rng, len(training.counts), BATCH):
            values, gradients = losses_and_gradients(chosen, training, weights)
            sums.append(values)
            adam.step(gradients)
        if epoch % 5 == 4 or epoch == epochs - 1:
            valued, _ = losses_and_gradients(np.arange(len(validation.counts)), validation, weights)
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
    arrays: dict[str, Any] = {
        f"layer/{name}": values.astype(np.float16) for name, values in weights.layers.items()
    }
    for kind, parts in (("mean", weights.means), ("scale", weights.scales)):
        arrays |= {f"{kind}/{name}": values.astype(np.float32) for name, values in parts.items()}
    np.savez_compressed(path, **arrays)


def train_kind(
    kind: str, roots: list[Path], folder: Path, *, count: int | None, epochs: int, processes: int
) -> None:
    """Write the weights of a kind to a folder; `count`: of observations, by default `OBSERVATIONS`."""
    began, count = time.monotonic(), count or OBSERVATIONS[kind]
    size = min(CHUNK, count)
    jobs = [(kind, "training", FIRST_SEED + number, size, roots) for number in range(count // size)]
    jobs.append((kind, "validation", 0, min(count, OBSERVATIONS["validation"]), roots))
    with Pool(processes) as pool:
        *parts, validation = pool.starmap(make_observations, jobs, chunksize=1)
    training = Batch.joined(parts)
    made = f"{len(training.counts)} observations, {training.starts[-1]} neighbourhoods"
    print(f"{kind}: {made}: {time.monotonic() - began:.0f} s", flush=True)
    del parts
    path = folder / f"{kind}_weights.npz"
    save(rounded(train(kind, training, validation, epochs)), path)
    print(f"{path.stat().st_size / 1024:.0f} KB written after {time.monotonic() - began:.0f} s", flush=True)
