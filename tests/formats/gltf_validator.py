"""The glTF validator of Khronos, an npm package that `make test` installs.

The environment variable BELTRAMI_GLTF_VALIDATOR may name the folder where it is elsewhere.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

_INSTALLED = Path(sys.prefix) / "gltf-validator" / "node_modules" / "gltf-validator"
_PACKAGE = Path(os.environ.get("BELTRAMI_GLTF_VALIDATOR", _INSTALLED))
_SCRIPT = Path(__file__).with_suffix(".cjs")
_NODE = shutil.which("node", path=os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]))

needs_validator = pytest.mark.skipif(
    _NODE is None or not _PACKAGE.is_dir(),
    reason="the glTF validator is not installed: run the tests by `make test`",
)


def issues(*files):
    """Return for each file what the validator finds: (severity, code, place, message), in order."""
    done = subprocess.run(
        [_NODE, _SCRIPT, _PACKAGE, *files], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    return [
        sorted((m["severity"], m["code"], m.get("pointer", ""), m["message"]) for m in found)
        for found in json.loads(done.stdout)
    ]
