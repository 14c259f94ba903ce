"""A configuration that merely lies in a folder: it sets parameters of the method, and nothing that could do harm."""

import json
import os

import click
import pytest

from beltrami_cli.cli.configuration import configured_values, load, may_be_found
from beltrami_cli.cli.option_names import long_name
from beltrami_cli.cli.registry import COMMANDS
from beltrami_cli.errors import UsageError
from cli.commands import SAMPLES, beltrami, command

NOISY = SAMPLES / "nonmanifold-noisy.ply"
QUICK = ("-n", "1", "--fast")
NEVER = (
    "scheduler", "pieces", "report_path", "preview_path", "map_to", "junit_to", "out_dir", "suffix", "resume",
    "overwrite", "allow_outside", "guides", "height", "positions", "mask", "colours", "reference", "parameters",
    "max_memory", "max_voxels", "max_unwrap_faces", "at_once",
)  # fmt: skip


def run(folder, *arguments, **variables):
    return beltrami(*arguments, cwd=folder, env=variables, text=True)


def options_of(name):
    return [each for each in command(name).params if isinstance(each, click.Option) and not each.is_eager]


@pytest.mark.parametrize("name", sorted(COMMANDS))
@pytest.mark.parametrize("table", ["", "[{}]\n", "[tool.beltrami.{}]\n"])
def test_other_options_are_refused_in_a_line_that_names_the_way_out(name, table, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / ("pyproject.toml" if "tool" in table else "beltrami.toml")
    for option in options_of(name):
        if may_be_found(option):
            continue
        value = "true" if option.is_flag else '"x"'
        path.write_text(f"{table.format(name)}{long_name(option)} = {value}\n")
        with pytest.raises(UsageError) as refused:
            configured_values(load(None), name)
        reported = str(refused.value)
        assert all(word in reported for word in (str(path), long_name(option), "--config"))
        assert "\n" not in reported


def test_what_may_be_set_exists_and_is_harmless():
    options = [option for name in COMMANDS for option in options_of(name)]
    assert {option.name for option in options} >= set(NEVER)
    harmless = {option.name for option in options if may_be_found(option)}
    assert harmless >= {"iterations", "beta", "slots", "jpeg_quality", "output_format", "preset"}
    assert harmless & set(NEVER) <= {"reference"}  # of `level` it names charts, and of `compare` a file
    # No option of a path can be missing in `NEVER`.
    paths = {option.name for option in options if "FILE" in (option.metavar or "")}
    assert paths - {"materials", "noise"} <= set(NEVER)


def test_noise_may_be_a_number_but_no_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for text in ('"12"', '"attribute:error"'):
        (tmp_path / "beltrami.toml").write_text(f"noise = {text}\n")
        assert configured_values(load(None), "smooth")["noise"] == text.strip('"')
    for text in ('"sigma.exr"', '"frame:/dev/dark.png"'):
        (tmp_path / "beltrami.toml").write_text(f"noise = {text}\n")
        with pytest.raises(UsageError, match="--config"):
            configured_values(load(None), "smooth")


def test_a_named_file_and_variables_may_set_everything(tmp_path):
    (tmp_path / "named.toml").write_text('[smooth]\nreport = "r.json"\noverwrite = true\n')
    for arguments, variables in (
        (("--config", "named.toml"), {}),
        ((), {"BELTRAMI_CONFIG": "named.toml"}),
        ((), {"BELTRAMI_SMOOTH_REPORT": "r.json", "BELTRAMI_SMOOTH_OVERWRITE": "1"}),
    ):
        (tmp_path / "r.json").unlink(missing_ok=True)
        (tmp_path / "out.ply").write_text("old")
        run(tmp_path, *arguments, "smooth", NOISY, "out.ply", *QUICK, **variables)
        assert json.loads((tmp_path / "r.json").read_text())["output"] == "out.ply"


@pytest.mark.parametrize("name", ["beltrami.toml", "pyproject.toml"])
@pytest.mark.parametrize("mode", [0o664, 0o646, 0o666])
def test_what_others_may_write_to_is_not_read(name, mode, tmp_path):
    path = tmp_path / name
    path.write_text("[tool.beltrami.smooth]\nbeta = 3\nreport = 'x'\n")
    path.chmod(mode)
    done = run(tmp_path, "config")
    assert done.stderr.count("\n") == 1
    assert str(path) in done.stderr
    assert "others than its owner" in done.stderr
    assert "beta" not in done.stdout
    path.write_text("[tool.beltrami.smooth]\nbeta = 3\n")
    assert "beta = 3" in run(tmp_path, "--config", path, "config").stdout
    path.chmod(0o644)
    assert "beta = 3" in run(tmp_path, "config").stdout


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root can give files away")
@pytest.mark.parametrize("is_link", [False, True])
def test_what_belongs_to_another_user_is_not_read(is_link, tmp_path):
    path = tmp_path / "beltrami.toml"
    target = tmp_path / "target.toml" if is_link else path
    target.write_text("[smooth]\nbeta = 3\n")
    if is_link:
        path.symlink_to(target)
        assert "beta = 3" in run(tmp_path, "config").stdout
    os.chown(path, 65534, 65534, follow_symlinks=False)  # of a link: the link alone
    done = run(tmp_path, "config")
    assert "belongs to another user" in done.stderr
    assert "beta" not in done.stdout


def test_the_search_ends_at_home_and_at_the_root_of_a_repository(tmp_path):
    deep = tmp_path / "home" / "repository" / "deep"
    deep.mkdir(parents=True)
    (tmp_path / "beltrami.toml").write_text("[smooth]\nbeta = 3\n")
    home = {"HOME": str(tmp_path / "home")}
    assert "beta" not in run(deep, "config", **home).stdout
    assert "beta = 3" in run(deep, "config", HOME=str(tmp_path)).stdout
    (tmp_path / "home" / "beltrami.toml").write_text("[smooth]\nbeta = 4\n")
    assert "beta = 4" in run(deep, "config", **home).stdout
    (deep.parent / ".git").mkdir()
    assert "beta" not in run(deep, "config", **home).stdout
    (deep.parent / "beltrami.toml").write_text("[smooth]\nbeta = 5\n")
    assert "beta = 5" in run(deep, "config", **home).stdout


def test_a_project_of_others_that_does_not_mention_this_program_needs_no_word(tmp_path):
    (tmp_path / "pyproject.toml").write_text("[project]\nname = 'other'\n")
    (tmp_path / "pyproject.toml").chmod(0o666)
    assert run(tmp_path, "config").stderr == ""
