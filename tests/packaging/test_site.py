"""The pages of the documentation find each other; `make docs` checks more, but needs packages of its own."""

import ast
import re
import tomllib
from pathlib import Path

import pytest

from beltrami_cli.formats.registry import FORMATS
from beltrami_cli.surface.slots import SLOTS

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "beltrami_cli"
PAGES = sorted((ROOT / "docs").glob("*.md"))
DEVELOPERS = [ROOT / "docs" / name for name in ("architecture.md", "contributing.md", "method.md")]
# What paths in tables and sentences are relative to.
FOLDERS = [ROOT, PACKAGE, PACKAGE / "native", ROOT / "tests"]
LINK = re.compile(r"\]\((?!https?:)([^)#\s]*)(?:#([^)\s]*))?\)")


def test_every_page_has_a_place_in_the_site():
    listed = re.findall(r": (\S+\.md)$", (ROOT / "mkdocs.yml").read_text(encoding="utf-8"), re.MULTILINE)
    assert sorted(listed) == [page.name for page in PAGES]


@pytest.mark.parametrize("page", [ROOT / "README.md", *PAGES], ids=lambda page: page.name)
def test_links_lead_to_files(page):
    targets = [target for target, _ in LINK.findall(page.read_text(encoding="utf-8")) if target]
    assert [target for target in targets if not (page.parent / target).exists()] == []


@pytest.mark.parametrize("page", [*ROOT.glob("*.md"), *PAGES], ids=lambda page: page.name)
def test_files_of_the_project_that_pages_name_exist(page):
    text = page.read_text(encoding="utf-8")
    named = re.findall(r"(?<![\w/.-])(?:beltrami_cli|tests|docs|sample_data)/[\w./*-]*\w", text)
    assert [name for name in named if not any(ROOT.glob(name))] == []


def quoted(page):
    """The words in backticks of a page, without its blocks of code."""
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    return set(re.findall(r"`([^`\s]+)`", text))


@pytest.mark.parametrize("page", DEVELOPERS, ids=lambda page: page.name)
def test_paths_that_developers_read_of_exist(page):
    path = r"[\w./-]+(/|\.(py|pyi|cpp|hpp|md|toml|cff|yml))"
    paths = {word for word in quoted(page) if re.fullmatch(path, word)}
    assert paths
    assert [path for path in sorted(paths) if not any((folder / path).exists() for folder in FOLDERS)] == []


@pytest.mark.parametrize("page", DEVELOPERS, ids=lambda page: page.name)
def test_names_that_developers_read_of_exist(page):
    sources = [path for kind in ("py", "cpp", "hpp") for path in PACKAGE.rglob(f"*.{kind}")]
    texts = (path.read_text(encoding="utf-8") for path in (ROOT / "Makefile", *sources))
    known = set(re.findall(r"\w+", " ".join(texts)))
    assert {word for word in quoted(page) if re.fullmatch(r"[A-Za-z_]\w*", word)} - known == set()


def families():
    """Names that pages list together: the slots, and the extensions of formats that one class reads."""
    extensions = {}
    for line in FORMATS:
        if line.kind == "model":
            extensions.setdefault(line.reader, set()).update((line.name, *line.aliases))
    extensions["read only"] -= {"foreign", "zae"}  # a .zae file is a compressed .dae file
    return [{*SLOTS}, *(names for names in extensions.values() if len(names) > 2)]


@pytest.mark.parametrize("page", [ROOT / "README.md", *PAGES], ids=lambda page: page.name)
def test_what_a_page_lists_is_complete(page):
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    for block in re.split(r"\n\n|\n(?=\|)", text.replace("COLLADA", "DAE")):
        words = {*re.findall(r"\w+", block)}
        words |= {word.lower() for word in words}
        for family in families():
            assert len(family & words) < 3 or family <= words, (block, family - words)


def test_commands_for_developers_are_targets_of_make():
    targets = set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    shown = set(re.findall(r"^make ([\w-]+)", DEVELOPERS[1].read_text(encoding="utf-8"), re.MULTILINE))
    assert len(shown) > 5
    assert shown <= targets


def test_every_folder_of_the_package_has_its_place_in_the_architecture():
    folders = {f"{path.parent.name}/" for path in PACKAGE.glob("*/__init__.py")} | {"native/"}
    assert folders <= quoted(DEVELOPERS[0])


def test_types_of_the_glossary_are_classes_and_its_terms_few():
    rows = DEVELOPERS[0].read_text(encoding="utf-8").partition("## Glossary")[2].partition("\n## ")[0]
    types = re.findall(r"^\| [^|]+ \| `(\w+)` \|", rows, re.MULTILINE)
    sources = (path.read_text(encoding="utf-8") for path in PACKAGE.rglob("*.py"))
    classes = {name for text in sources for name in re.findall(r"^class (\w+)", text, re.MULTILINE)}
    assert {*types} <= classes
    assert 15 < len(types) <= rows.count("\n| ") - 2 <= 25


def figures(page):
    return re.findall(r"```mermaid\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)


def imported_by(path):
    """The modules of the package that a file imports anywhere, by their paths."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module is not None:
            found |= {node.module, *(f"{node.module}.{each.name}" for each in node.names)}
    return {ROOT / (name.replace(".", "/") + ".py") for name in found}


def test_the_road_is_that_of_the_imports():
    road = figures(DEVELOPERS[0])[0]
    paths = {name: PACKAGE / path for name, path in re.findall(r'(\w+)\["([\w/.]+)<br>', road)}
    arrows = re.findall(r"^ *(\w+)(?:\[.*?\])? --> (\w+)", road, re.MULTILINE)
    assert len(arrows) == len(road.strip().splitlines()) - 1
    for source, target in arrows:
        assert paths[target] in imported_by(paths[source]), (source, target)


def test_the_floors_are_those_of_the_contract():
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]
    layers = contracts["contracts"][0]["layers"]
    shown = figures(DEVELOPERS[0])[1].strip().splitlines()[1]
    floors = [re.findall(r"\w+", floor) for floor in shown.split("-->")]
    declared = [re.findall(r"\w+", layer) for layer in layers if layer != "__main__"]
    assert [*map(set, floors)] == [*map(set, declared)]
