"""Hashes of the weights, and of the code and settings that they depend on."""

from __future__ import annotations

import ast
import hashlib
import re
from pathlib import Path
from typing import Any

# The folder of the repository, not of an installed package.
ROOT = Path(__file__).parents[1]
WEIGHTS = ROOT / "beltrami_cli/flow/noise"
FILES = "grid_weights.npz", "grid_sizes.npz", "cluster_weights.npz", "cluster_sizes.npz"


def _in(folder: str, *names: str) -> tuple[str, ...]:
    return tuple(f"{folder}/{name}" for name in names)


NETWORK = (
    *_in("noise_model", "backpropagation.py", "batches.py", "crops.py", "losses.py", "noises.py"),
    *_in("noise_model", "observations.py", "pictures.py", "recipes.py", "surfaces.py", "train.py"),
    *_in(
        "beltrami_cli/flow/noise", "cells.py", "clusters.py", "components.py", "even_cells.py", "features.py"
    ),
    *_in("beltrami_cli/flow/noise", "grid_squares.py", "jpeg_traces.py", "neighbourhoods.py", "network.py"),
    "beltrami_cli/flow/vertex_graph.py",
)
SIZES = (
    *NETWORK,
    *_in("noise_model", "size_kinds.py", "train_sizes.py"),
    *_in("beltrami_cli/flow/noise", "size.py"),
    *_in("beltrami_cli/native/noise", "pilot.cpp", "pilot.hpp", "pilot_of_squares.cpp"),
)


def configuration(files: tuple[str, ...]) -> str:
    text = "\n".join(code_of((ROOT / path).read_text(encoding="utf-8"), Path(path).suffix) for path in files)
    return hashlib.sha256(text.encode()).hexdigest()


def code_of(text: str, suffix: str) -> str:
    """Return source text without comments, docstrings and white space; it does not depend on the version of Python."""
    if suffix != ".py":
        return re.sub(r"\s+|//.*", "", text)
    lines = text.splitlines()
    for node in ast.walk(ast.parse(text)):
        value = node.value if isinstance(node, ast.Expr) else None
        if isinstance(value, ast.Constant) and isinstance(value.value, str):
            lines[node.lineno - 1 : node.end_lineno] = [""] * (node.end_lineno - node.lineno + 1)
    return re.sub(r"\s+|#.*", "", "\n".join(lines))


def hashes(folder: Path) -> dict[str, Any]:
    """Return the hashes of the code of the repository, and of the weights in a folder."""
    weights = {name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in FILES}
    return {"network": configuration(NETWORK), "sizes": configuration(SIZES), "weights": weights}
