"""The weights of the noise model belong to the training in the repository."""

import ast
import json
from pathlib import Path

import pytest

import configuration
import stamp
from beltrami_cli.flow.noise import network
from configuration import FILES, ROOT, code_of, hashes

INSTALLED = Path(network.__file__).parent
MOST_BYTES = 400 * 1024  # of all weights


def test_weights_belong_to_the_configuration():
    stamped = json.loads(stamp.STAMP.read_text(encoding="utf-8"))
    remedy = "run `make noise-model`, or `python noise_model stamp` if no value of training changed"
    assert {**hashes(INSTALLED), "values": stamped["values"]} == stamped, remedy


def test_changed_values_of_training_are_not_stamped(tmp_path, monkeypatch):
    before = stamp.STAMP.read_text(encoding="utf-8")
    values, path = json.loads(before)["values"], tmp_path / "stamp.json"
    path.write_text(before, encoding="utf-8")
    values["grid"][0] *= 1.001
    monkeypatch.setattr(stamp, "STAMP", path)
    monkeypatch.setattr(stamp, "training_values", lambda: values)
    with pytest.raises(SystemExit, match="values of training changed for grid"):
        stamp.stamp(are_new=False)
    assert path.read_text(encoding="utf-8") == before


@pytest.mark.parametrize(
    ("suffix", "code", "worded", "others"),
    [
        (
            ".py", "if a:\n    b()\nc()", '"""A."""\nif a:  # B\n  b(\n  )\n"""\nC\n"""\n\nc()\n',
            ["if a:\n    b()\n    c()", "if a:\n    b()\nc(2)", "if a:\n    b()"],
        ),
        (
            ".hpp", "#include <array>\nint a = 1 + +b;", "// A\n#include <array>\n\nint a =\n  1 + +b;  // B",
            ["#include <vector>\nint a = 1 + +b;", "#include <array>\nint a = 1 ++b;"],
        ),
    ],
)  # fmt: skip
def test_the_configuration_depends_on_code_and_not_on_words(suffix, code, worded, others):
    assert code_of(worded, suffix) == code_of(code, suffix)
    assert code_of(code, suffix) not in [code_of(other, suffix) for other in others]


def imports(path):
    """Return the modules of noise_model and flow/noise that a file imports, as paths."""
    found = set()
    for node in ast.walk(ast.parse((ROOT / path).read_text(encoding="utf-8"))):
        names = [alias.name for alias in node.names] if isinstance(node, (ast.Import, ast.ImportFrom)) else []
        if isinstance(node, ast.ImportFrom):
            names = [node.module, *(f"{node.module}.{name}" for name in names)]
        for name in names:
            folder = "" if name.startswith("beltrami_cli.flow.noise.") else "noise_model/"
            found.add(f"{folder}{name.replace('.', '/')}.py")
    return {name for name in found if (ROOT / name).is_file()}


@pytest.mark.parametrize(
    ("main", "listed"), [("train.py", configuration.NETWORK), ("train_sizes.py", configuration.SIZES)]
)
def test_the_configuration_lists_all_modules_that_training_imports(main, listed):
    found, new = set(), {f"noise_model/{main}"}
    while new:
        found |= new
        new = {name for path in new for name in imports(path)} - found
    assert found <= set(listed)


def test_weights_are_small():
    assert sum((INSTALLED / name).stat().st_size for name in FILES) <= MOST_BYTES
