"""The full scale of integer colours and of intensities is the least number of bits that holds them."""

import json

import numpy as np
import pytest

from beltrami_cli.formats.colours import full_scale, intensity_scale
from cli.commands import beltrami
from formats.ply_files import Table, build

SIDE = 50
COLOURS = (8, 10, 12, 16)
INTENSITIES = (8, 10, 12, 14, 16)
NAMES = {"colours": ("red", "green", "blue"), "intensity": ("intensity",)}


def scan(kind, bits, what="colours", seed=0):
    """Return the truth and noisy numbers of a plain half and a darker one, of 0.8 and 0.3 of full scale."""
    full = 2**bits - 1
    truth = np.where(np.arange(SIDE * SIDE) % SIDE < SIDE // 2, 0.8, 0.3)[:, None] * full
    noise = 0.06 * full * np.random.default_rng(seed).standard_normal((SIDE * SIDE, len(NAMES[what])))
    return truth, np.rint(np.clip(truth + noise, 0, full)).astype(
        "f8" if kind in ("float", "double") else "i8"
    )


def as_ply(kind, numbers, what="colours"):
    properties = [*((name, "float") for name in "xyz"), *((name, kind) for name in NAMES[what])]
    places = np.stack([*np.divmod(np.arange(SIDE * SIDE), SIDE), np.zeros(SIDE * SIDE, int)], axis=1)
    return build([Table("vertex", properties, np.hstack([places, numbers]).tolist())], "ascii").data


def numbers_in(path):
    lines = path.read_text().split("end_header\n")[-1].splitlines()
    return np.array([line.split()[3:] for line in lines], float)


def facts(path):
    return json.loads(beltrami("info", path, "--json", "--fast").stdout)


@pytest.mark.parametrize(
    ("kind", "what", "bits"),
    [
        *((kind, "colours", bits) for bits in COLOURS for kind in ("ushort", "uint", "int")),
        ("short", "colours", 12),
        *((kind, "intensity", bits) for bits in INTENSITIES for kind in ("ushort", "int", "float")),
    ],
)
def test_the_full_scale_is_that_of_the_bits_whatever_type_holds_them(tmp_path, kind, what, bits):
    path = tmp_path / "in.ply"
    path.write_bytes(as_ply(kind, scan(kind, bits, what)[1], what))
    assert facts(path)["colours"]["full_scale"] == 2**bits - 1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "what", "bits"),
    [
        ("uint", "colours", 10),
        ("short", "colours", 12),
        ("ushort", "intensity", 14),
        ("float", "intensity", 8),
    ],
)
def test_noise_is_smoothed_on_any_scale(tmp_path, kind, what, bits):
    truth, noisy = scan(kind, bits, what)
    path, smoothed = tmp_path / "in.ply", tmp_path / "out.ply"
    path.write_bytes(as_ply(kind, noisy, what))
    beltrami("smooth", path, smoothed)
    errors = [np.sqrt(np.mean(np.square(each - truth))) for each in (noisy, numbers_in(smoothed))]
    assert errors[1] < errors[0] / 3


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".xyz", ".npz"])
def test_other_files_of_points_tell_their_range_too(tmp_path, suffix):
    path = tmp_path / f"in{suffix}"
    places = np.stack([*np.divmod(np.arange(SIDE * SIDE), SIDE), np.zeros(SIDE * SIDE, int)], axis=1)
    _, noisy = scan("ushort", 10)
    if suffix == ".npz":
        np.savez(path, positions=places.astype(float), colours=noisy.astype(np.uint16))
    else:
        np.savetxt(path, np.hstack([places, noisy]), fmt="%d")
    assert facts(path)["colours"]["full_scale"] == 1023


def test_opacity_says_the_range_of_dark_colours(tmp_path):
    rows = [[x, y, 0, 40, 50, 200, 65535] for x, y in ((0, 0), (1, 0), (1, 1))]
    names = [
        *((name, "float") for name in "xyz"),
        *((c, "ushort") for c in ("red", "green", "blue", "alpha")),
    ]
    face = Table("face", [("vertex_indices", "uchar int")], [[[0, 1, 2]]])
    path = tmp_path / "dark.ply"
    path.write_bytes(build([Table("vertex", names, rows), face], "ascii").data)
    assert facts(path)["colours"]["full_scale"] == 65535


def test_dim_colours_of_16_bit_are_not_taken_for_14_bit(tmp_path):
    # A picture of a quarter of full scale is dim, and would be four times too bright in another format.
    path = tmp_path / "dim.ply"
    path.write_bytes(as_ply("ushort", scan("ushort", 14)[1]))
    assert facts(path)["colours"]["full_scale"] == 65535


def test_files_that_fit_into_different_bits_are_compared_on_one_scale(tmp_path):
    before, after = (scan("ushort", 8)[1] for _ in range(2))
    before[0], after[0] = 300, 250
    paths = [tmp_path / "before.ply", tmp_path / "after.ply"]
    for path, numbers in zip(paths, (before, after), strict=True):
        path.write_bytes(as_ply("ushort", numbers))
    report = json.loads(beltrami("compare", *paths, "--json").stdout)
    error = np.sqrt(np.mean(np.square((before - after) / 1023)))
    assert report["parts"][0]["psnr"] == pytest.approx(-20 * np.log10(error), abs=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["float", "short"])
def test_decibels_below_0_are_smoothed(tmp_path, kind):
    truth = np.where(np.arange(SIDE * SIDE) % SIDE < SIDE // 2, -2200, -900)[:, None]
    noisy = np.rint(truth + 150 * np.random.default_rng(1).standard_normal(truth.shape)).astype(int)
    unit = 100 if kind == "float" else 1
    path, smoothed = tmp_path / "in.ply", tmp_path / "out.ply"
    path.write_bytes(as_ply(kind, noisy / unit if kind == "float" else noisy, "intensity"))
    beltrami("smooth", path, smoothed)
    assert np.sqrt(np.mean(np.square(unit * numbers_in(smoothed) - truth))) < 150 / 3


@pytest.mark.parametrize("spike", [17.0, 300.0, 1e6, -1e6])
def test_one_spike_of_a_renderer_says_nothing_of_the_range(spike):
    colours = np.random.default_rng(3).random((500, 3))
    colours[7, 1] = spike
    assert full_scale(colours, "x.ply")[0] == 1


@pytest.mark.parametrize("single", [-0.01, -1.0])
def test_one_negative_intensity_says_nothing_of_the_range(single):
    values = np.random.default_rng(3).random((2000, 1))
    values[7] = single
    assert intensity_scale(values)[0] == 1
    whole = np.rint(4000 * np.abs(values))
    whole[7] = -1
    assert intensity_scale(whole)[0] == 4095
