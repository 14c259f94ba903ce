"""Reproduce the figures of the paper: ``make figures``, or ``python docs/figures/make.py [FOLDER]``.

Writes the pictures, by default in this script's folder, and the tables of numbers into ``docs/figures.md``.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import face
import step_edge
import waves

if TYPE_CHECKING:
    from collections.abc import Sequence

HERE = Path(__file__).resolve().parent
PAGE = HERE.parent / "figures.md"
FIGURES = {"step-edge": step_edge, "waves": waves, "face": face}


def main(arguments: Sequence[str]) -> int:
    """Compute, draw, and put the numbers into the page."""
    folder = Path(arguments[0]) if arguments else HERE
    folder.mkdir(parents=True, exist_ok=True)
    page = PAGE.read_text(encoding="utf-8")
    for name, figure in FIGURES.items():
        result = figure.run()
        table = as_markdown(figure.numbers(result))
        figure.draw(result, folder / f"{name}.png")
        print(f"{folder / name}.png\n{table}")
        page = with_table(page, name, table)
    PAGE.write_text(page, encoding="utf-8")
    return 0


def as_markdown(rows: Sequence[Sequence[str]]) -> str:
    """Return a table; the first row is its head."""
    head, *others = (f"| {' | '.join(row)} |" for row in rows)
    return "\n".join([head, f"|{' --- |' * len(rows[0])}", *others]) + "\n"


def with_table(page: str, name: str, table: str) -> str:
    """Return the page with the table between its marks in place of the one that is there."""
    before, mark, rest = page.partition(f"<!-- numbers: {name} -->\n")
    _, end, after = rest.partition("<!-- end -->\n")
    if not (mark and end):
        raise SystemExit(f"{PAGE} has no marks for the numbers of {name}")
    return before + mark + table + end + after


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
