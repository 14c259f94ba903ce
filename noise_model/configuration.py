"""Hash of the code and settings that trained weights depend on."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

NETWORK = (
    *(f"noise_model/{name}.py" for name in ("noises", "observations", "pictures", "surfaces", "train")),
    *(
        f"beltrami_cli/flow/noise/{name}.py"
        for name in ("clusters", "features", "grid_squares", "neighbourhoods", "network")
    ),
)
SIZES = (
    *NETWORK,
    *(f"noise_model/{name}.py" for name in ("size_kinds", "train_sizes")),
    *(f"beltrami_cli/flow/noise/{name}.py" for name in ("pilot", "size")),
    *(f"beltrami_cli/native/noise/{name}" for name in ("pilot.cpp", "pilot.hpp", "pilot_of_squares.cpp")),
)


def configuration(files: tuple[str, ...]) -> str:
    """Return the hash of source files without spaces and Python comments."""
    root = Path(__file__).parents[1]
    text = "\n".join(re.sub(r"\s+|#.*", "", (root / path).read_text(encoding="utf-8")) for path in files)
    return hashlib.sha256(text.encode()).hexdigest()
