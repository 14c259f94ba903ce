"""All files of a release agree; `make release-check` runs this where the package is not installed."""

import re
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).parents[2]
DECLARED = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PROJECT, BUILD = DECLARED["project"], DECLARED["build-system"]
VERSIONS = {
    "CITATION.cff": "\nversion: {}\n",
    "CHANGELOG.md": "\n## {} (",
    "recipe/meta.yaml": '{{% set version = "{}" %}}',
    "beltrami_cli/blender/blender_manifest.toml": '\nversion = "{}"\n',
}


@pytest.mark.parametrize("name", VERSIONS)
def test_versions_agree(name):
    assert VERSIONS[name].format(PROJECT["version"]) in (ROOT / name).read_text(encoding="utf-8")


def test_the_conda_recipe_needs_what_the_package_needs():
    lines = (ROOT / "recipe" / "meta.yaml").read_text(encoding="utf-8").split("\nrequirements:\n")[1]
    sections = dict(re.findall(r"^  (\w+):\n((?:    - .*\n)+)", lines, re.MULTILINE))
    of_conda = {"OpenImageIO": "py-openimageio", "xatlas": "xatlas-python"}

    def listed(section):
        return set(re.findall(r"- (.*?) *(?:#.*)?$", sections[section], re.MULTILINE))

    def renamed(requirements):
        parsed = [Requirement(text) for text in requirements]
        return {f"{of_conda.get(each.name, each.name)} {each.specifier}" for each in parsed}

    assert listed("run") == renamed(PROJECT["dependencies"]) | {"python"}
    assert listed("host") == renamed(BUILD["requires"]) | {"python", "pip"}
