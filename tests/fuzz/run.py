"""Fuzzes one target with atheris, guided by what the readers' code does; see `make fuzz`.

    python tests/fuzz/run.py TARGET [--seconds N] [--found FOLDER]

What is found new is kept in the folder for next time; what fails is written beside it and reported.
"""

from __future__ import annotations

import argparse
import importlib
import pkgutil
import sys
from pathlib import Path

import atheris

SEEDS = Path(__file__).with_name("corpus")
_PATIENCE = 20  # seconds for one input
_MAX_MEMORY = 3000  # MB
_LONGEST = 1 << 16  # bytes of an input


def main() -> None:
    """Fuzz until the time is over, or something is found."""
    sys.path.insert(0, str(Path(__file__).parents[1]))
    with atheris.instrument_imports(include=["beltrami_cli", "fuzz"]):
        import beltrami_cli

        for module in pkgutil.walk_packages(beltrami_cli.__path__, "beltrami_cli."):
            if not module.name.endswith(("_native", "__main__")):
                importlib.import_module(module.name)
        from fuzz.targets import TARGETS, attempt
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("target", choices=sorted(TARGETS))
    options.add_argument("--seconds", type=int, default=60)
    options.add_argument("--found", type=Path, default=Path("build/fuzz"))
    chosen = options.parse_args()
    found = chosen.found / chosen.target
    found.mkdir(parents=True, exist_ok=True)
    arguments = [
        sys.argv[0], f"-max_total_time={chosen.seconds}", f"-timeout={_PATIENCE}", f"-rss_limit_mb={_MAX_MEMORY}",
        f"-max_len={_LONGEST}", f"-artifact_prefix={chosen.found}/{chosen.target}-", "-print_final_stats=1", "-seed=1",
        str(found), str(SEEDS / chosen.target),
    ]  # fmt: skip
    atheris.Setup(arguments, lambda data: attempt(chosen.target, data))
    atheris.Fuzz()


if __name__ == "__main__":
    main()
