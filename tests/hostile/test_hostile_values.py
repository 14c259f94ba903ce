"""Whatever is given to an option or stands in a text file: a sentence and a documented code, no unexpected error."""

import json
import random
import re
import warnings
from pathlib import Path

import click
import pytest

from batch.batches import without_workers
from beltrami_cli.cli.batch_items import SHARED_WITH_SMOOTH
from beltrami_cli.cli.registry import COMMANDS as ALL
from cli.commands import beltrami, command
from small_models import COLOURED, ply

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def _without_workers():
    """Processes of a batch take what its leader has checked."""
    with without_workers():
        yield


MESH = ply(
    COLOURED,
    [
        [0, 0, 0, 10, 200, 30], [1, 0, 0, 90, 9, 9], [1, 1, 0, 90, 90, 250], [0, 1, 0, 200, 90, 90],
        [0.5, 0.5, 0.4, 0, 255, 9],
    ],
    [(0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)],
)  # fmt: skip
NUMBERS = [
    "0", "-1", "1", "2", "1e9", "1100", "nan", "inf", "-inf", "1e400", "9" * 400, "0x10", "1_0", "-0", "½", "1e-320",
]  # fmt: skip
TEXTS = [
    "", " ", ",", ",,", "\n", "a\nb", "é", "\x1b[31m", "\udcff", "a" * 5000, "/", ".", "..", "-", "--", "~",
    "/dev/null", "/nowhere/x", "no.such.file", "mesh.ply", "a,a", "red", "red,red", "vertices", "http://x", "x://",
    "%s{}", "auto", "none", "1,2", "1,nan,3", "99999999999x1", "*", "[", "$HOME", "0,0,0", "4x4", "#ffffff", "1e999,1",
]  # fmt: skip
TEXTURED = str(Path(__file__).parents[2] / "sample_data" / "tiled-clean.glb")
# `view` serves until it is stopped; its values are tested where it is.
COMMANDS = [name for name in ALL if name != "view"]
# What each command needs besides; a tiny mesh, so that a value that is accepted costs little.
ARGUMENTS = {
    "blender-extension": ("out.zip",),
    "bake": ("mesh.ply", "out.glb", "--to", "texture", "--size", "64"),
    "batch": ("mesh.ply", "--out-dir", "out", "--fast", "-n", "1", "-j", "1"),
    "check": ("mesh.ply", "mesh.ply"), "compare": ("mesh.ply", "mesh.ply"), "config": (), "docs": ("tuning",),
    "info": ("mesh.ply", "--fast"), "kernel": ("mesh.ply", "kernel.ply", "--at", "1"),
    "level": (TEXTURED, "out.glb"), "noise": ("mesh.ply", "out.ply", "--sigma", "5"),
    "render": ("mesh.ply", "out.png", "--size", "16"), "report": ("mesh.ply", "mesh.ply", "out.html"),
    "smooth": ("mesh.ply", "out.ply", "--fast", "-n", "1"),
    "sweep": ("mesh.ply", "out.png", "--beta", "1", "--size", "16", "--fast", "-n", "1"),
}  # fmt: skip


def hostile(folder, *arguments):
    """Run a command; whatever it is, it ends with a documented code and in lines without a mistake of ours."""
    (folder / "mesh.ply").write_bytes(MESH)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        done = beltrami(*arguments, code=None, cwd=folder)
    said = done.stderr.decode("utf-8", "surrogateescape")
    assert "unexpected error" not in said, (arguments, said)
    assert not re.search(r"\.py\b.*Warning|Warning:", said), (arguments, said)
    assert done.returncode in (0, 1, 2, 3, 4), (arguments, said)
    assert all(line.isprintable() or "\t" in line for line in said.splitlines()), (arguments, said)
    return done.returncode


def cases(name, chance):
    """Give arguments of a command, with a hostile value for each option and for each file in turn."""
    given = list(ARGUMENTS[name])
    # Workers take long to start, and do with the options of `smooth` what that does.
    left_out = {"scheduler", *(SHARED_WITH_SMOOTH if name == "batch" else ())}
    arguments = [each.name for each in command(name).params if isinstance(each, click.Argument)]
    for option in command(name).params:
        value = chance.choice(NUMBERS if chance.random() < 0.5 else TEXTS)
        if isinstance(option, click.Argument):
            at = arguments.index(option.name)
            if at < len(given):
                yield [name, *given[:at], "--", value, *given[at + 1 :]]
        elif isinstance(option, click.Option) and option.name not in left_out:
            if option.is_flag:
                yield [name, *given, option.opts[-1]]
            elif not option.is_eager:
                yield [name, *given, chance.choice(option.opts), value]


@pytest.mark.parametrize("name", COMMANDS)
def test_values_of_options(name, tmp_path):
    for number, arguments in enumerate(cases(name, random.Random(name))):
        folder = tmp_path / str(number)
        folder.mkdir()
        hostile(folder, *arguments)


@pytest.mark.parametrize("name", [name for name in COMMANDS if name != "config"])
def test_the_arguments_that_hostile_ones_take_the_place_of_are_sound(name, tmp_path):
    assert hostile(tmp_path, name, *ARGUMENTS[name]) == 0


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("smooth", "-n 170 -t .5 --beta 3 --beta-growth 100"),  # 100^155 is beyond all numbers
        ("render", "--fov 1e-320"),
        ("kernel", "--time-step 1e-320"),
    ],
)
def test_sound_options_whose_result_is_at_the_end_of_all_numbers(name, options, tmp_path):
    assert hostile(tmp_path, name, *ARGUMENTS[name], *options.split()) == 0


VALUES = [
    None, True, -1, 0, 1100, 1e308, float("nan"), 10**400, "", "x", "\0", "\ud800", "\n", [], [[]], ["x"], {},
    {"x": {}},
]  # fmt: skip
NESTED = ("[" * 100_000, '{"a":' * 100_000, "[" * 500 + "]" * 500, '{"a":' * 500 + "1" + "}" * 500)
JSONS = [
    b"", b"\xff", b"\0", b"null", b"[1", b'"x', b"1e999", b"NaN", *(json.dumps(value).encode() for value in VALUES),
]  # fmt: skip
TOMLS = [
    b"", b"\xff", b"\0", b"=", b"a = ", b"a = " + NESTED[0].encode(), b"a = " + NESTED[2].encode(), b"[" * 100_000,
    b".".join([b"a"] * 100_000) + b" = 1", b"a = 2020-01-01", b"smooth = 1", b"[smooth]\nbeta = []", b"[[smooth]]",
    b"threads = 1e400", b"[smooth]\niterations = " + b"9" * 400, b'[smooth]\nchannels = "\\u0000"', b"[nothing]",
    b"[smooth]\nreport = {}", b"tool = 1", b"[tool]\nbeltrami = 1", b'"\\u0000" = 1', b"x" * (1 << 21),
]  # fmt: skip


@pytest.mark.parametrize("text", [*TOMLS, *JSONS[: -len(VALUES)]])
def test_texts_of_configurations(text, tmp_path):
    (tmp_path / "beltrami.toml").write_bytes(text)
    found = hostile(tmp_path, "smooth", *ARGUMENTS["smooth"], "--overwrite")
    (tmp_path / "beltrami.toml").rename(tmp_path / "named.toml")
    named = hostile(tmp_path, "--config", "named.toml", "smooth", *ARGUMENTS["smooth"], "--overwrite")
    assert {found, named} <= {0, 2, 3}


@pytest.mark.parametrize("suffix", [".toml", ".csv", ".jsonl"])
def test_texts_of_manifests(suffix, tmp_path):
    tables = (b'input\n"x', b"input,input\na,b", b"input\na,b,c", b"input\n\0")
    for text in (*TOMLS, *JSONS, *map(str.encode, NESTED), *tables):
        (tmp_path / f"jobs{suffix}").write_bytes(text)
        assert hostile(tmp_path, "batch", f"jobs{suffix}", "--out-dir", "out") in (2, 3)


ADDRESSES = [
    "", "x", "tcp://", "tcp://x:99999999", "tcp://[::", "no.json", "run.json", "a\nb", "\udcff", "inproc://x",
]  # fmt: skip


@pytest.mark.parametrize("address", ADDRESSES)
def test_addresses_of_schedulers(address, tmp_path):
    (tmp_path / "run.json").write_text("[1]")
    assert hostile(tmp_path, "batch", *ARGUMENTS["batch"], "--scheduler", address) == 1
