"""The pages of the documentation, and the examples and notes of commands in them."""

from __future__ import annotations

import re
from pathlib import Path

_OMITTED_PAGES = {"index", "changelog"}  # they consist of links and of another file
_MARKS = re.compile(r"^<!--.*-->\n", re.MULTILINE)


def docs_folder() -> Path:
    """Return the folder of the documentation: in the package, or in the sources that it runs from."""
    package = Path(__file__).parents[1]
    installed = package / "docs"
    return installed if installed.is_dir() else package.parent / "docs"


def pages() -> dict[str, Path]:
    return {path.stem: path for path in sorted(docs_folder().glob("*.md")) if path.stem not in _OMITTED_PAGES}


def page_text(path: Path) -> str:
    """Return a page as Markdown without the marks for scripts."""
    return _MARKS.sub("", path.read_text(encoding="utf-8"))


def notes_on(command: str) -> str:
    """Return the examples and notes of a command, for click, from its section of the page of commands."""
    text = (docs_folder() / "commands.md").read_text(encoding="utf-8")
    section = text.partition(f"\n## {command}\n")[2].partition("\n## ")[0]
    notes: list[str] = []
    for block in section.strip().split("\n\n"):
        if not block.startswith("```"):
            notes.append(block)
            continue
        title = notes.pop() if notes and notes[-1].endswith(":") else "Examples:"
        notes.append("\n".join(["\b", title, *(f"  {line}" for line in block.split("\n")[1:-1])]))
    return "\n\n".join(notes)
