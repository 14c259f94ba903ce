"""Gradients of the networks by backpropagation, and the steps of Adam that they drive; NumPy is enough for both."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from beltrami_cli.flow.noise.candidates import starts_of
from beltrami_cli.flow.noise.network import Layers

LARGEST_GRADIENT = 1.0  # maximum norm
DECAY = 0.1  # of the weights, relative to the rate


class Node:
    """A value of the network, and the gradient of the loss with respect to it."""

    def __init__(self, value: np.ndarray) -> None:
        self.value = value
        self.gradient: np.ndarray | None = None

    def add(self, gradient: np.ndarray) -> None:
        self.gradient = gradient if self.gradient is None else self.gradient + gradient


class Tape(Layers):
    """The operations of the network, recorded for backpropagation."""

    def __init__(self, weights: dict[str, np.ndarray]) -> None:
        super().__init__(weights)
        self._steps: list[tuple[Node, Callable[[np.ndarray], None]]] = []
        self.gradients: dict[str, np.ndarray] = {}

    def _record(self, value: np.ndarray, back: Callable[[np.ndarray], None]) -> Node:
        """Return a node, whose gradient `back` will propagate."""
        node = Node(value)
        self._steps.append((node, back))
        return node

    def product(self, rows: np.ndarray, matrix: np.ndarray) -> np.ndarray:
        return rows @ matrix

    def dense(self, rows: Node, name: str, *, is_last: bool = False) -> Node:
        value = super().dense(rows.value, name, is_last=is_last)

        def back(gradient: np.ndarray) -> None:
            gradient = gradient if is_last else gradient * (value > 0)
            self.gradients[f"{name}.matrix"] = rows.value.T @ gradient
            self.gradients[f"{name}.bias"] = gradient.sum(axis=0)
            rows.add(gradient @ self.weights[f"{name}.matrix"].T)

        return self._record(value, back)

    def dropped(self, rows: Node, is_dropped: np.ndarray) -> Node:
        """Apply dropout: set values to 0, and scale the others up to preserve the mean."""
        kept = (~is_dropped / (1 - np.mean(is_dropped))).astype(np.float32)
        return self._record(rows.value * kept, lambda gradient: rows.add(gradient * kept))

    def pool(self, rows: Node, counts: np.ndarray) -> Node:
        value, starts = super().pool(rows.value, counts), starts_of(counts)
        _, most, least = np.split(value, 3, axis=1)

        def back(gradient: np.ndarray) -> None:
            of_mean, of_most, of_least = np.split(gradient, 3, axis=1)
            total = np.repeat(of_mean / counts[:, None], counts, axis=0)
            for extreme, of_extreme in ((most, of_most), (least, of_least)):
                is_extreme = rows.value == np.repeat(extreme, counts, axis=0)
                count = np.maximum(np.add.reduceat(is_extreme, starts, dtype=np.float32), 1)
                total += is_extreme * np.repeat(of_extreme / count, counts, axis=0)
            rows.add(total)

        return self._record(value, back)

    def spread(self, rows: Node, counts: np.ndarray) -> Node:
        value = super().spread(rows.value, counts)
        return self._record(value, lambda gradient: rows.add(np.add.reduceat(gradient, starts_of(counts))))

    def join(self, parts: Sequence[Node]) -> Node:
        ends = np.cumsum([part.value.shape[1] for part in parts])[:-1]

        def back(gradient: np.ndarray) -> None:
            for part, gradient_of_part in zip(parts, np.split(gradient, ends, axis=1), strict=True):
                part.add(gradient_of_part)

        return self._record(super().join([part.value for part in parts]), back)

    def go_back(self) -> None:
        """Propagate the gradients of the outputs back to the weights."""
        for node, back in reversed(self._steps):
            if node.gradient is not None:
                back(node.gradient)


def shuffled(rng: np.random.Generator, count: int, size: int) -> Iterator[np.ndarray]:
    """Yield batches of indices for an epoch; a smaller one at the end is left out."""
    if count < size:
        raise SystemExit(f"{count} rows do not fill a batch of {size}: ask for more")
    order = rng.permutation(count)
    for first in range(0, count - size + 1, size):
        yield order[first : first + size]


def initial_layer(rng: np.random.Generator, name: str, inputs: int, outputs: int) -> dict[str, np.ndarray]:
    matrix = rng.normal(0, np.sqrt(2 / inputs), (inputs, outputs)).astype(np.float32)
    return {f"{name}.matrix": matrix, f"{name}.bias": np.zeros(outputs, np.float32)}


class Adam:
    """Steps of Adam with decay of the weights, at a rate that rises over some steps and falls to 0 along a cosine."""

    def __init__(self, layers: dict[str, np.ndarray], rate: float, steps: int, warm_up: int) -> None:
        self.layers, self.rate, self.steps, self.warm_up = layers, rate, steps, warm_up
        self.moments = {name: (0 * values, 0 * values) for name, values in layers.items()}
        self.number = 0

    def step(self, gradients: dict[str, np.ndarray]) -> None:
        """Change the layers in place."""
        self.number += 1
        rise = min(1, self.number / self.warm_up)
        rate = self.rate * (rise * (1 + np.cos(np.pi * self.number / self.steps)) / 2)
        norm = np.sqrt(sum(float(np.vdot(values, values)) for values in gradients.values()))
        for name, (first, second) in self.moments.items():
            gradient = gradients[name] * np.float32(min(1, LARGEST_GRADIENT / norm))
            first += 0.1 * (gradient - first)
            second += 0.001 * (gradient**2 - second)
            unbiased = second / (1 - 0.999**self.number)
            change = (first / (1 - 0.9**self.number)) / (np.sqrt(unbiased) + 1e-8)
            self.layers[name] -= (rate * (change + DECAY * self.layers[name])).astype(np.float32)
