"""Tests run against the installed package: it is compared with the sources before a test imports it.

In an environment of `make dev` it is installed again if they differ; in others pytest ends with one line.
"""

from __future__ import annotations

import base64
import hashlib
import importlib.util
import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGE = "beltrami_cli"
STAMP = Path(sys.prefix) / ".installed-test"  # of the Makefile


def ensure_current() -> None:
    """Install the package again if its sources changed, or exit with the command that does."""
    installed = imported_distribution()
    if installed is None or not (ROOT / PACKAGE).is_dir():
        return
    if STAMP.exists() and (make := shutil.which("make")):
        command = [make, "--no-print-directory", f"VENV={sys.prefix}", f"PYTHON={sys.executable}", STAMP]
        environment = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}
        if subprocess.run(command, cwd=ROOT, env=environment).returncode:
            sys.exit("pytest: the sources cannot be installed, see above")
    if changed := differences(ROOT, installed):
        names = changed[0] + (f" and {len(changed) - 1} more" if changed[1:] else "")
        command = [sys.executable, "-m", "pip", "install", "--no-deps", "--force-reinstall", str(ROOT)]
        sys.exit(
            f"pytest: the installed package is not that of the sources ({names}); install it again, which the "
            f"environment of `make dev` does by itself: {shlex.join(command)}"
        )


def imported_distribution() -> Distribution | None:
    """Return the installation that tests import; None if they import another copy, as in `make sanitize`."""
    try:
        installed = distribution(PACKAGE)
    except PackageNotFoundError:
        return None
    # `python -m pytest` puts the working folder first, in which the package has no compiled core.
    sys.path[:] = [entry for entry in sys.path if Path(entry).resolve() != ROOT]
    imported = importlib.util.find_spec(PACKAGE)
    expected = Path(str(installed.locate_file(f"{PACKAGE}/__init__.py")))
    return installed if imported and imported.origin and Path(imported.origin) == expected else None


def differences(root: Path, installed: Distribution) -> list[str]:
    """Return the sources that were changed, added or removed after the installation, relative to the checkout."""
    files = installed.files or []
    recorded = {file.as_posix(): file.hash.value for file in files if file.hash and file.parts[0] == PACKAGE}
    sources = dict(_sources(root))
    present = {name: _digest(path) for name, path in sources.items()}
    compiled = {name for name in recorded if name.endswith((".so", ".pyd"))}
    names = {name for name, _ in present.items() ^ recorded.items()} - compiled
    changed = [sources.get(name, root / name) for name in names]
    # What is compiled or becomes metadata can only be compared by time.
    [record] = [file for file in files if file.name == "RECORD"]
    since = Path(str(record.locate())).stat().st_mtime
    others = [root / "pyproject.toml", *(root / PACKAGE / "native").rglob("*.*")]
    changed += [path for path in others if path.stat().st_mtime > since]
    return sorted(path.relative_to(root).as_posix() for path in changed)


def _sources(root: Path) -> Iterator[tuple[str, Path]]:
    """Yield the files that are installed as they are, by their names in the wheel."""
    for path in (root / PACKAGE).rglob("*"):
        name = path.relative_to(root)
        left_out = name.parts[1] == "native" or path.parent.name == "__pycache__" or path.name.startswith(".")
        if path.is_file() and not left_out and path.suffix != ".so":
            yield name.as_posix(), path
    for path in (root / "docs").glob("*.md"):
        yield f"{PACKAGE}/docs/{path.name}", path


def _digest(path: Path) -> str:
    """Return the digest of a file as RECORD has it."""
    return base64.urlsafe_b64encode(hashlib.sha256(path.read_bytes()).digest()).rstrip(b"=").decode()
