"""What the weights depend on besides the pictures."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

TRAINING = ("noises", "observations", "pictures", "surfaces", "train")
INFERENCE = ("clusters", "features", "grid_squares", "neighbourhoods", "network")
FILES = (
    *(Path(__file__).with_name(f"{name}.py") for name in TRAINING),
    *(Path(__file__).parents[1] / f"beltrami_cli/flow/noise/{name}.py" for name in INFERENCE),
)


def configuration() -> str:
    """Return the hash of all that the weights depend on besides the pictures, without comments and spaces."""
    text = "\n".join(re.sub(r"\s+|#.*", "", path.read_text(encoding="utf-8")) for path in FILES)
    return hashlib.sha256(text.encode()).hexdigest()
