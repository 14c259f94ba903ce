"""A stamp of the weights with the code that they belong to, which a test compares with the repository.

The stamp also records the first rows and gradients of training on synthetic images, which show whether a change of the
code alters values of training.
"""

from __future__ import annotations

import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from PIL import Image

from beltrami_cli.flow.noise import network
from beltrami_cli.flow.noise.network import Weights
from configuration import ROOT, SIZES, WEIGHTS, hashes
from families import FAMILIES
from train import CHANNELS, initial_layers, losses_and_gradients, make_observations
from train_sizes import make_rows

STAMP = ROOT / "noise_model/stamp.json"
OBSERVATIONS, ROWS = 6, 2  # of each kind and family that are compared
# Tolerance, absolute and relative: NumPy rounds sums of single precision differently on other processors.
TOLERANCE = 1e-5


def training_values() -> dict[str, list[float]]:
    """Return values of training on a synthetic photograph and a synthetic texture."""
    rng = np.random.default_rng(0)
    with TemporaryDirectory() as folder:
        for name in ("backgrounds", "textures"):
            path = Path(folder, name, "smooth.png")  # by its name an image for training, see `crops.part_of`
            path.parent.mkdir()
            coarse = Image.fromarray(rng.integers(256, size=(40, 40, 3), dtype=np.uint8))
            coarse.resize((640, 640), Image.Resampling.BICUBIC).save(path)
        return {kind: values_of_kind(kind, [Path(folder)]) for kind in CHANNELS}


def values_of_kind(kind: str, roots: list[Path]) -> list[float]:
    """Return weighted sums of observations, of losses and gradients of initial weights, and of rows for sizes."""
    data = make_observations(kind, "training", 0, OBSERVATIONS, roots)
    means, scales = data.standard()
    columns = {name: len(mean) for name, mean in means.items()}
    weights = Weights(initial_layers(np.random.default_rng(0), columns, network.WIDTHS[kind]), means, scales)
    parts: list[Any] = [np.nan_to_num(part) for part in data.parts.values()]
    data.standardise_in_place(weights)
    losses, gradients = losses_and_gradients(np.arange(OBSERVATIONS), data, weights)
    parts += [*losses.values(), *gradients.values()]
    for number in range(len(FAMILIES[kind])):
        parts += make_rows(kind, "training", number, 0, ROWS, roots, network.weights_of(kind))
    # Weights that rise show values in another order too.
    return [float(np.abs(part).ravel() @ np.linspace(1, 2, np.size(part))) for part in parts]


def check_installed() -> None:
    """Refuse an installed package that differs from the sources, which the stamp describes."""
    installed = Path(network.__file__).parents[3]
    for name in SIZES:
        if (installed / name).is_file() and (installed / name).read_bytes() != (ROOT / name).read_bytes():
            raise SystemExit(f"the installed {name} differs from the source: install the package")


def stamp(*, are_new: bool) -> None:
    """Stamp the weights; unless they are new, only if training still computes the values that the stamp records."""
    check_installed()
    now, values = hashes(WEIGHTS), training_values()
    if not are_new:
        stamp = json.loads(STAMP.read_text(encoding="utf-8"))
        if now["weights"] != stamp["weights"]:
            raise SystemExit("the weights differ from the stamped ones: run `make noise-model`")
        for kind, stamped in stamp["values"].items():
            if len(values[kind]) != len(stamped) or not np.allclose(
                values[kind], stamped, TOLERANCE, TOLERANCE
            ):
                raise SystemExit(f"values of training changed for {kind}: run `make noise-model`")
        values = stamp["values"]
    STAMP.write_text(json.dumps({**now, "values": values}, indent=1) + "\n", encoding="utf-8")
