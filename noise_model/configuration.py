"""Hash of the code and settings that trained weights depend on."""

from __future__ import annotations

import ast
import hashlib
import re
from pathlib import Path

NETWORK = (
    *(f"noise_model/{name}.py" for name in ("noises", "observations", "pictures", "surfaces", "train")),
    *(
        f"beltrami_cli/flow/noise/{name}.py"
        for name in ("clusters", "features", "grid_squares", "jpeg_traces", "neighbourhoods", "network")
    ),
)
SIZES = (
    *NETWORK,
    *(f"noise_model/{name}.py" for name in ("size_kinds", "train_sizes")),
    *(f"beltrami_cli/flow/noise/{name}.py" for name in ("pilot", "size")),
    *(f"beltrami_cli/native/noise/{name}" for name in ("pilot.cpp", "pilot.hpp", "pilot_of_squares.cpp")),
)


def configuration(files: tuple[str, ...]) -> str:
    """Return the hash of the code in source files."""
    root = Path(__file__).parents[1]
    text = "\n".join(code_of((root / path).read_text(encoding="utf-8"), Path(path).suffix) for path in files)
    return hashlib.sha256(text.encode()).hexdigest()


def code_of(text: str, suffix: str) -> str:
    """Return source text without comments, docstrings and white space; it does not depend on the version of Python."""
    if suffix != ".py":
        return re.sub(r"\s+|//.*", "", text)
    lines = text.splitlines()
    for node in ast.walk(ast.parse(text)):
        if (
            isinstance(node, ast.Expr)
            and isinstance(node.value, ast.Constant)
            and node.value.value is not ...
        ):
            lines[node.lineno - 1 : node.end_lineno] = [""] * (node.end_lineno - node.lineno + 1)
    return re.sub(r"\s+|#.*", "", "\n".join(lines))
