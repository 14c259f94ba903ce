"""Train the network that reads noise, print how well it reads, and write its weights.

``python noise_model/train.py FOLDER...`` takes clean pictures from folders of unpacked packages; `make noise-model`
fetches them. Training needs NumPy alone. This command made the weights in the package.
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
from backpropagation import Adam, Node, Tape, initial_layer
from beltrami_cli.flow.noise import network
from beltrami_cli.flow.noise.network import (
    QUANTILES,
    TOTAL_QUANTILES,
    Weights,
    candidates_of,
    mixed,
    read,
    split_mixture,
)
from configuration import NETWORK, WEIGHTS, configuration
from crops import Crop, clean_crops, folders_of_packages
from observations import Observation, draw_recipe_of_grids, observed, random_samples
from recipes import draw_recipe

OBSERVATIONS = {"grid": 140_000, "cluster": 60_000, "validation": 4_000}  # maximum number for validation
CHUNK = 2_000  # observations that are made together
FIRST_SEED = 300  # of training; lower seeds served to choose features and layers
EPOCHS, BATCH, RATE = 12, 96, 2e-3  # of Adam; the rate is its maximum
SEED = 49
SAMPLES = {"grid": random_samples, "cluster": surfaces.random_samples}
RECIPES = {"grid": draw_recipe_of_grids, "cluster": draw_recipe}
WARM_UP = 500  # steps until the rate is at its height
ROWS = 100_000  # of features that are standardised at a time
# Weights of the heads in the loss.
COUNTED = {"total": 3.0, "deviations": 2.0, "correlations": 2.0, "places": 0.5}


@cache
def crops_of(roots: tuple[Path, ...], part: str) -> list[Crop]:
    return clean_crops(list(roots), part, SEED)


def make_observations(job: tuple[str, str, int, int, list[Path]]) -> Batches:
    """Make observations; `job`: the kind of neighbourhoods, the part of the pictures, seed, count, folders."""
    kind, part, seed, count, roots = job
    crops = crops_of(tuple(roots), part)
    rng, observations = np.random.default_rng([SEED, seed, part == "training"]), []
    while len(observations) < count:
        drawn = SAMPLES[kind](rng, crops, RECIPES[kind])
        observation = None if drawn is None else observed(*drawn)
        if observation is not None:
            observations.append(observation)
    return Batches(observations)


class Batches:
    """Concatenated observations; the features of squares are in half precision."""

    def __init__(self, observations: list[Observation]) -> None:
        self.counts = np.array([len(each.squares) for each in observations])
        self.starts = np.append(0, np.cumsum(self.counts))
        self.parts = {
            "squares": np.concatenate([each.squares for each in observations]).astype(np.float16),
            "quiet": np.concatenate([each.quiet for each in observations]).astype(np.float16),
            "places": np.concatenate([each.by_square for each in observations]).astype(np.float32)[:, None],
        }
        for name in ("even", "even_deviations", "total", "deviations", "correlations"):
            self.parts[name] = np.stack([getattr(each, name) for each in observations]).astype(np.float32)
        self.parts["total"] = self.parts["total"][:, None]

    def extend(self, others: list[Batches]) -> None:
        """Append the observations of others."""
        all_batches = [self, *others]
        self.counts = np.concatenate([each.counts for each in all_batches])
        self.starts = np.append(0, np.cumsum(self.counts))
        self.parts = {name: np.concatenate([each.parts[name] for each in all_batches]) for name in self.parts}

    def standard(self) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        """Return the means and standard deviations of features."""
        some = self.parts["squares"][:: max(1, len(self.parts["squares"]) // 200_000)].astype(np.float32)
        kinds = {"squares": some, "even": self.parts["even"]}
        means = {name: rows.mean(axis=0) for name, rows in kinds.items()}
        return means, {name: rows.std(axis=0) + 1e-3 for name, rows in kinds.items()}

    def standardise(self, weights: Weights) -> None:
        """Standardise the features of neighbourhoods, in place."""
        squares = self.parts["squares"]
        for first in range(0, len(squares), ROWS):
            block = squares[first : first + ROWS]
            block[:] = weights.standardised("squares", block.astype(np.float32))

    def take(self, chosen: np.ndarray, weights: Weights) -> tuple[tuple, dict, dict]:
        """Return the arguments of `read` for some observations, the truths, and the candidates."""
        rows = np.concatenate([np.arange(self.starts[each], self.starts[each + 1]) for each in chosen])
        counts, even = self.counts[chosen], self.parts["even"][chosen]
        starts = np.append(0, np.cumsum(counts)[:-1])
        given = self.parts["squares"][rows].astype(np.float32), starts, weights.standardised("even", even)
        quiet = self.parts["quiet"][rows].astype(np.float32)
        candidates = candidates_of(self.parts["even_deviations"][chosen], quiet, starts)
        truths = {name: self.parts[name][chosen] for name in ("total", "deviations", "correlations")}
        # Squares are read relative to their mean, since often only the mean is uncertain.
        places = self.parts["places"][rows]
        means = np.add.reduceat(np.nan_to_num(places), starts) / np.maximum(
            np.add.reduceat(np.isfinite(places), starts, dtype=np.float32), 1
        )
        truths["places"] = places - np.repeat(means, counts, axis=0)
        return given, truths, candidates


def losses(
    all_outputs: dict[str, np.ndarray],
    truths: dict[str, np.ndarray],
    candidates: dict[str, np.ndarray],
    counted: dict[str, float],
) -> tuple[dict[str, float], dict[str, np.ndarray]]:
    """Return the loss of each head and its gradient: pinball losses of quantiles, squared errors of correlations."""
    values, gradients = {}, {}
    for name, given in all_outputs.items():
        truth, known = truths[name], np.isfinite(truths[name])
        count, outputs = max(1, known.sum()), given.reshape(*truth.shape, -1)
        if name == "correlations":
            read_as = np.tanh(outputs)
            error = np.where(known[..., None], np.nan_to_num(truth)[..., None] - read_as, 0)
            slope, parts = 2 * error * (1 - read_as**2), 1
            values[name] = float(np.square(error).sum() / count)
        else:
            read_as = mixed(outputs, candidates[name]) if name in candidates else outputs
            error = np.nan_to_num(truth)[..., None] - read_as
            shares = np.array(TOTAL_QUANTILES if name == "total" else QUANTILES, np.float32)
            slope, parts = np.where(error > 0, shares, shares - 1) * known[..., None], len(shares)
            values[name] = float((slope * error).sum() / count / parts)
        gradient = -counted[name] * slope / count / parts
        if name in candidates:
            gradient = _through_mixture(gradient, read_as, outputs, candidates[name])
        gradients[name] = gradient.reshape(given.shape).astype(np.float32)
    return values, gradients


def _through_mixture(gradient, read_as, outputs, candidates):
    """Return the gradient of the outputs from that of the readings, in which they are combined with candidates."""
    readings, weights = split_mixture(outputs, candidates)
    toward = [
        (gradient * (part[..., None] - read_as)).sum(axis=-1) for part in np.moveaxis(candidates, -1, 0)
    ]
    toward.append((gradient * (readings - read_as)).sum(axis=-1))
    return np.concatenate([gradient * weights[..., -1:], weights * np.stack(toward, axis=-1)], axis=-1)


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
    chosen: np.ndarray, data: Batches, weights: Weights
) -> tuple[dict[str, float], dict[str, np.ndarray]]:
    """Return the losses of some observations, and the gradients of the weights."""
    (squares, starts, even), truths, candidates = data.take(chosen, weights)
    tape = Tape(weights.layers)
    nodes = read(tape, Node(squares), starts, Node(even))
    del nodes["context"]  # an intermediate value without a loss
    outputs = {name: node.value for name, node in nodes.items()}
    values, gradients = losses(outputs, truths, candidates, COUNTED)
    for name, node in nodes.items():
        node.gradient = gradients[name]
    tape.go_back()
    return values, tape.gradients


def train(kind: str, training: Batches, validation: Batches, epochs: int) -> Weights:
    rng = np.random.default_rng(SEED)
    means, scales = training.standard()
    columns = {name: len(mean) for name, mean in means.items()}
    weights = Weights(initial(rng, columns, network.WIDTHS[kind]), means, scales, configuration(NETWORK))
    for data in (training, validation):
        data.standardise(weights)
    adam = Adam(weights.layers, RATE, epochs * (len(training.counts) // BATCH), WARM_UP)
    began = time.monotonic()
    for epoch in range(epochs):
        order, sums = rng.permutation(len(training.counts)), []
        for at in range(0, len(order) - BATCH + 1, BATCH):
            values, gradients = slopes_of(order[at : at + BATCH], training, weights)
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
    np.savez_compressed(path, configuration=np.array(weights.configuration), **arrays)


def main() -> None:
    """Make observations, train, judge and write, for grids and for clusters."""
    parser = argparse.ArgumentParser(description="Train the network that reads noise.")
    parser.add_argument("folders", nargs="+", type=Path, help="with pictures")
    parser.add_argument("--kinds", nargs="+", default=list(SAMPLES), choices=list(SAMPLES))
    parser.add_argument("--observations", type=int, help="of each kind")
    parser.add_argument("--epochs", type=int, default=EPOCHS)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument(
        "--judged", default="test", choices=["validation", "test"], help="the part that is judged"
    )
    parser.add_argument("--weights", type=Path, default=WEIGHTS, help="the folder that they are written to")
    options = parser.parse_args()
    roots = [*options.folders, *folders_of_packages()]
    for kind in options.kinds:
        train_kind(kind, roots, options)


def train_kind(kind: str, roots: list[Path], options: argparse.Namespace) -> None:
    """Train the network for one kind of neighbourhoods."""
    began = time.monotonic()
    count = options.observations or OBSERVATIONS[kind]
    size = min(CHUNK, count)
    jobs = [(kind, "training", FIRST_SEED + number, size, roots) for number in range(max(1, count // size))]
    jobs.append((kind, "validation", 0, min(count, OBSERVATIONS["validation"]), roots))
    with Pool(options.processes) as pool:
        training, *parts, validation = pool.imap(make_observations, jobs)
    training.extend(parts)
    size = f"{len(training.counts)} observations, {training.starts[-1]} neighbourhoods"
    print(f"{kind}: {size}: {time.monotonic() - began:.0f} s", flush=True)
    del parts
    path = options.weights / f"{kind}_weights.npz"
    save(rounded(train(kind, training, validation, options.epochs)), path)
    print(f"{path.stat().st_size / 1024:.0f} KB written after {time.monotonic() - began:.0f} s", flush=True)
    table.main(roots, options.judged, kind, Weights.load(path))


if __name__ == "__main__":
    main()
