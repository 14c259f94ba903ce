"""docs/messages.md quotes messages that the program has, and lists all kinds of errors."""

import ast
import re
from pathlib import Path

import beltrami_cli.cli.console  # has an error of its own
from beltrami_cli.errors import BeltramiError

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "messages.md").read_text(encoding="utf-8")


def texts():
    """All texts in the code of the package, each in a line."""
    for path in (ROOT / "beltrami_cli").rglob("*.py"):
        nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        yield from (
            each.value for each in nodes if isinstance(each, ast.Constant) and isinstance(each.value, str)
        )


def test_the_program_has_the_messages_that_the_page_quotes():
    quoted = [
        text
        for row in re.findall(r"^\| (`.*?) \|", PAGE, re.MULTILINE)
        for text in re.findall("`(.*?)`", row)
    ]
    assert len(quoted) > 30
    assert {row.count(" | ") for row in PAGE.splitlines() if row.startswith("| ")} == {2}
    said = "\n".join(texts())
    parts = [part.strip(" ,;") for text in quoted for part in text.split("...")]
    assert [part for part in parts if part not in said] == []


def test_every_kind_of_error_has_its_place_on_the_page():
    public = [getattr(beltrami_cli, name) for name in beltrami_cli.__all__ if name.endswith("Error")]
    kinds = {str(each.exit_code): each.__name__ for each in public if each is not BeltramiError}
    assert dict(re.findall(r"^## (\d): .*\(`(\w+)`\)$", PAGE, re.MULTILINE)) == kinds
    others = [*BeltramiError.__subclasses__()]
    for kind in others:
        others += kind.__subclasses__()
    assert {str(kind.exit_code) for kind in others} == set(kinds)
