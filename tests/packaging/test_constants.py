"""The table of constants in docs/method.md lists what the code has."""

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("flow", "levelling", "layers")
LONGEST = 40  # characters of a value that is shown


def constants_of(source):
    """Return the module-level constants that have numbers in their values, as source text by name."""
    found = {}
    for node in ast.parse(source).body:
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        for target in targets:
            pairs = [(target, getattr(node, "value", None))]
            if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
                pairs = zip(target.elts, node.value.elts, strict=True)
            for name, value in pairs:
                if isinstance(name, ast.Name) and name.id.isupper() and has_number(value):
                    found[name.id] = ast.unparse(value)
    return found


def has_number(value):
    parts = ast.walk(value) if value is not None else ()
    return any(isinstance(each, ast.Constant) and type(each.value) in (int, float) for each in parts)


def constants_in_code():
    package, found = ROOT / "beltrami_cli", {}
    for path in sorted(each for folder in FOLDERS for each in (package / folder).rglob("*.py")):
        name = path.relative_to(package).as_posix()
        for constant, value in constants_of(path.read_text()).items():
            found[name, constant] = f"`{value}`" if len(value) <= LONGEST else "table"
    return found


def constants_in_table():
    section = (ROOT / "docs" / "method.md").read_text().split("## Constants\n")[1].split("\n## ")[0]
    rows = [line.strip("| ").split(" | ") for line in section.splitlines() if line.startswith("| `")]
    assert all(len(row) == 5 and row[3] and row[4] for row in rows)
    return {(file.strip("`"), name.strip("`")): value for file, name, value, *_ in rows}


def test_the_table_lists_exactly_the_constants_of_the_code():
    assert constants_in_table() == constants_in_code()


def test_constants_are_found_in_tuples_and_tables_and_names_of_text_are_none():
    source = "A, _B = 1, 2.5\nC: int = 3\nD = {'x': (1, 2)}\nE = 'jp2'\nf = 4\nG = H\nimport os\n"
    assert constants_of(source) == {"A": "1", "_B": "2.5", "C": "3", "D": "{'x': (1, 2)}"}
