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
    *_in(
        "noise_model",
        "backpropagation.py",
        "batches.py",
        "crops.py",
        "grids.py",
        "clean_images.py",
        "losses.py",
    ),
    *_in("noise_model", "noises.py", "observations.py", "recipes.py", "surfaces.py", "train.py"),
    *_in("beltrami_cli/flow/noise", "candidates.py", "cells.py", "clusters.py", "components.py"),
    *_in("beltrami_cli/flow/noise", "even_cells.py", "features.py", "grid_squares.py", "jpeg_traces.py"),
    *_in("beltrami_cli/flow/noise", "neighbourhoods.py", "network.py"),
    "beltrami_cli/flow/vertex_graph.py",
)
SIZES = (
    *NETWORK,
    *_in("noise_model", "families.py", "train_sizes.py"),
    *_in("beltrami_cli/flow/noise", "size.py"),
    *_in("beltrami_cli/native/noise", "pilot.cpp", "pilot.hpp", "pilot_of_squares.cpp"),
)


def configuration(files: tuple[str, ...]) -> str:
    text = "\n".join(code_of((ROOT / path).read_text(encoding="utf-8"), Path(path).suffix) for path in files)
    return hashlib.sha256(text.encode()).hexdigest()


def code_of(text: str, suffix: str) -> str:
    """Return the code of a source without comments, docstrings and layout."""
    if suffix == ".py":
        return repr(_outline(ast.parse(text)))
    return re.sub(r"\s+", " ", re.sub(r"//.*", "", text)).strip()


def _outline(node: Any) -> Any:
    """Return a syntax tree as nested tuples and lists, which are the same for all versions of Python."""
    if isinstance(node, list):
        return [_outline(each) for each in node if not _is_docstring(each)]
    if not isinstance(node, ast.AST):
        return node
    fields = [(name, _outline(value)) for name, value in ast.iter_fields(node)]
    # The fields that newer versions add are empty.
    return type(node).__name__, [(name, value) for name, value in fields if value not in (None, [])]


def _is_docstring(node: Any) -> bool:
    is_constant = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    return is_constant and isinstance(node.value.value, str)


def hashes(folder: Path) -> dict[str, Any]:
    """Return the hashes of the code of the repository, and of the weights in a folder."""
    weights = {name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in FILES}
    return {"network": configuration(NETWORK), "sizes": configuration(SIZES), "weights": weights}
