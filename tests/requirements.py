"""Prints what an environment needs, for the Makefile: with an extra, to run the package, or to build it."""

from __future__ import annotations

import re
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

PROJECT = Path(__file__).parents[1] / "pyproject.toml"


def requirements(project: dict[str, Any], extra: str) -> Iterator[str]:
    """Yield the dependencies of the package and of an extra, those of the extras that it names among them.

    `package` has no extra.
    """
    yield from project["dependencies"]
    for requirement in {**project["optional-dependencies"], "package": []}[extra]:
        if names := re.fullmatch(rf"{project['name']}\[(.*)\]", requirement):
            for name in names[1].split(","):
                yield from requirements(project, name.strip())
        else:
            yield requirement


if __name__ == "__main__":
    read = tomllib.loads(PROJECT.read_text(encoding="utf-8"))
    extras = sys.argv[1:]
    lines = read["build-system"]["requires"]
    if extras:
        lines = [line for extra in extras for line in requirements(read["project"], extra)]
    print("\n".join(dict.fromkeys(lines)))
