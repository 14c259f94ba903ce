"""What the weights depend on besides the pictures."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

HERE = Path(__file__).parent
FILES = tuple(
    HERE / f"{name}.py" for name in ("noises", "observations", "pictures", "train", "features", "network")
)


def configuration() -> str:
    """Return the hash of all that the weights depend on besides the pictures, without comments and spaces."""
    text = "\n".join(re.sub(r"\s+|#.*", "", path.read_text(encoding="utf-8")) for path in FILES)
    return hashlib.sha256(text.encode()).hexdigest()
