"""The manual pages say what the commands say, and roff understands them."""

import re
import shutil
import subprocess
import sys

import click
import pytest

from beltrami_cli.cli.command import DEFAULT_GROUP
from beltrami_cli.cli.manual import main, manual
from beltrami_cli.cli.registry import COMMANDS
from cli.commands import command

PAGES = dict(manual("1.2.3"))


def test_there_is_a_page_for_every_command_and_one_for_all():
    assert set(PAGES) == {"beltrami.1", *(f"beltrami-{name}.1" for name in COMMANDS)}
    escaped = [name.replace("-", "\\-") for name in COMMANDS]
    assert all(f"beltrami\\-{name}(1)" in PAGES["beltrami.1"] for name in escaped)


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_is_on_the_page_with_the_name_that_is_typed_in_its_group(name):
    shown = [each for each in command(name).params if isinstance(each, click.Option) and not each.hidden]
    options = [text for each in shown for text in each.opts]
    page = PAGES[f"beltrami-{name}.1"].replace("\\-", "-")
    assert [text for text in options if not re.search(rf"^\.B .*{text}\b", page, re.MULTILINE)] == []
    assert re.findall(r"\.B (.*)\n\n", page) == []  # each is explained
    groups = command(name).option_groups(click.Context(command(name), info_name=name))
    titles = [f'"{title}"' for title in groups if title != DEFAULT_GROUP]
    assert re.findall(r"^\.SS (.*)$", page, re.MULTILINE) == titles


def test_pages_are_written_where_only_what_builds_the_package_is_installed(tmp_path):
    code = (
        "import sys; sys.modules |= dict.fromkeys(['numpy', 'OpenImageIO', 'rich', 'trimesh', 'xatlas']); "
        "from beltrami_cli.cli.manual import main; main(sys.argv[1], '1.2.3')"
    )
    subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=True, timeout=60)
    assert {page.name for page in tmp_path.iterdir()} == set(PAGES)


@pytest.mark.skipif(shutil.which("groff") is None, reason="there is no groff")
def test_roff_has_nothing_to_complain_of_and_shows_examples_as_they_are_typed(tmp_path):
    main(str(tmp_path), "1.2.3")
    for page in tmp_path.iterdir():
        done = subprocess.run(
            ["groff", "-ww", "-man", "-Tascii", "-P-c", "-rLL=200n", page.name],
            cwd=tmp_path, capture_output=True, check=True, timeout=60,
        )  # fmt: skip
        assert done.stderr == b""
        assert b"beltrami 1.2.3" in done.stdout
        if page.name == "beltrami.1":
            assert b"cat scan.ply | beltrami smooth - - > c.ply" in done.stdout
            assert b'eval "$(_BELTRAMI_COMPLETE=bash_source beltrami)"' in done.stdout
