"""--max-memory: sizes as people write them, and a limit that holds and is lifted again."""

import os
import re
import resource
from contextlib import nullcontext
from unittest.mock import Mock

import numpy as np
import pytest

from beltrami_cli.errors import InputError
from beltrami_cli.jobs import smoothing
from beltrami_cli.quantities import show_size, size_in
from beltrami_cli.surface import memory
from beltrami_cli.surface.memory import default_memory, limited_memory
from cli.commands import beltrami, run_command
from formats.tile_files import tiled_model
from formats.volume_files import npz

SIZES = {
    "1": 1, "500M": 500 << 20, "4G": 4 << 30, "1.5g": 3 << 29, "2 GiB": 2 << 30, "3kB": 3 << 10, "1T": 1 << 40,
}  # fmt: skip


@pytest.mark.parametrize("text", SIZES)
def test_sizes(text):
    assert size_in(text) == SIZES[text]


@pytest.mark.parametrize("text", [" ", "G", "-1G", "1X", "1 G B", "nan", "1e9", "0x10", "9" * 30])
def test_what_is_no_size(text):
    with pytest.raises(ValueError, match=re.escape(text)):
        size_in(text)


def test_sizes_are_shown_in_the_unit_that_suits_them():
    assert [show_size(size) for size in (12, 500 << 20, 4 << 30)] == ["12", "500M", "4G"]


def test_by_default_half_of_what_is_available_may_be_taken(monkeypatch, tmp_path):
    whole = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    assert 1 << 26 < (default_memory() or 1 << 30) <= whole // 2
    root = tmp_path / "cgroup"
    (root / "jobs" / "one").mkdir(parents=True)
    (root / "jobs" / "memory.max").write_text(f"{3 << 26}\n")
    (root / "jobs" / "memory.current").write_text(f"{1 << 26}\n")
    (root / "jobs" / "memory.stat").write_text(f"anon 5\ninactive_file {1 << 25}\nactive_file 0\n")
    (root / "jobs" / "one" / "memory.max").write_text("max\n")
    (tmp_path / "own").write_text("1:name=systemd:/\n0::/jobs/one\n")
    monkeypatch.setattr(memory, "_CGROUPS", root)
    monkeypatch.setattr(memory, "_OWN_CGROUPS", tmp_path / "own")
    assert default_memory() == ((3 << 26) - (1 << 26) + (1 << 25)) // 2
    (tmp_path / "own").write_text("4:cpu,memory:/jobs\n")
    (root / "memory" / "jobs").mkdir(parents=True)
    (root / "memory" / "memory.limit_in_bytes").write_text(f"{1 << 29}\n")
    (root / "memory" / "memory.usage_in_bytes").write_text(f"{1 << 20}\n")
    assert default_memory() == ((1 << 29) - (1 << 20)) // 2


@pytest.mark.parametrize(
    "take", [lambda: np.zeros(1 << 34, np.uint8), Mock(side_effect=RuntimeError("can't start new thread"))]
)
def test_more_than_the_limit_is_refused_by_name_and_the_limit_is_lifted(take):
    before = resource.getrlimit(resource.RLIMIT_DATA)
    message = r"big\.ply: needs more than 1G of memory; raise --max-memory"
    with pytest.raises(InputError, match=message), limited_memory(1 << 30, "big.ply"):
        take()
    assert resource.getrlimit(resource.RLIMIT_DATA) == before
    with limited_memory(1 << 30, "small.ply"):
        assert np.ones(1 << 26, np.uint8).sum() == 1 << 26


def test_what_is_too_large_to_be_drawn_is_refused_before_it_is_smoothed(tmp_path, monkeypatch):
    """Nine tiles of 48 x 48 texels take 22 bytes each as they are drawn, 456 KB for one model; smoothing takes less."""
    model = tiled_model(tmp_path / "in", size=3)
    cause = b"0.0415 million texels do not fit into memory to be drawn; raise --max-memory, or leave out --preview\n"
    options = ("--preview", tmp_path / "look.png", "--max-memory", "600K", "-n", "1", "--beta", "20")
    monkeypatch.setattr(smoothing, "smooth_layer", None)
    monkeypatch.setattr(
        "beltrami_cli.cli.options.limited_memory", lambda *_: nullcontext()
    )  # which is for a process of its own
    for more in ((), ("--unwrap",)):
        run = beltrami("smooth", model, tmp_path / "new.obj", *options, *more, code=3)
        assert run.stderr.endswith(cause)
    assert not list(tmp_path.glob("*.*"))
    run = beltrami("render", model, model, tmp_path / "look.png", "--max-memory", "600K", code=3)
    assert run.stderr.endswith(b"million texels do not fit into memory to be drawn; raise --max-memory\n")


def test_a_surface_too_large_for_the_memory_is_refused_and_does_not_end_the_process(tmp_path):
    # scikit-image writes past arrays that it cannot enlarge, so it must not come to that.
    values = np.random.default_rng(2).standard_normal((100, 100, 100)).astype(np.float16)
    path = tmp_path / "noise.npz"
    path.write_bytes(npz(values=values, colours=np.zeros((100, 100, 100, 1), np.uint8)))
    run = beltrami("smooth", path, tmp_path / "out.ply", "--max-memory", "80M", code=3)
    assert b"needs more than 80M" in run.stderr


@pytest.mark.slow
def test_models_are_drawn_in_little_memory(tmp_path):
    """Not so little that Embree cannot start its threads, at which it crashes."""
    model, picture = tiled_model(tmp_path / "in", size=1), tmp_path / "look.png"
    run = run_command("render", model, picture, "--max-memory", "64M")
    assert run.returncode == 0, run.stderr
    assert picture.exists()
