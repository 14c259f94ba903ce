"""The glTF validator of Khronos, an npm package that `make test` installs, and its asset auditor, by `make audit`.

The environment variables BELTRAMI_GLTF_VALIDATOR and BELTRAMI_GLTF_AUDITOR may name folders where they are elsewhere.
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

_AUDITOR = Path(os.environ.get("BELTRAMI_GLTF_AUDITOR", Path(sys.prefix) / "gltf-auditor"))
needs_auditor = pytest.mark.skipif(
    _NODE is None or not _AUDITOR.is_dir(),
    reason="the glTF asset auditor is not installed: run make audit",
)


def unfit(*files):
    """Return for each file which of the auditor's checks it fails."""
    script = _SCRIPT.with_name("gltf_auditor.mjs")
    try:
        done = subprocess.run(
            [_NODE, script, _AUDITOR, *files], capture_output=True, text=True, timeout=100, check=False
        )
    except subprocess.TimeoutExpired:
        pytest.skip("the auditor takes longer than 100 s")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    if found[0] is None:
        pytest.skip("the auditor does not read the source")
    return [set(each) for each in found]


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
