"""What is said of noise tells how sure it is, the same everywhere; and what is advised changes the file."""

import dataclasses
import json
import re

import numpy as np
import pytest

from batch.batches import batch
from beltrami_cli.flow.noise import size
from beltrami_cli.flow.noise.model import Reading
from beltrami_cli.flow.noise.size import sizes_of
from beltrami_cli.layers.reports import describe_reading
from beltrami_cli.quantities import show_amount
from beltrami_cli.view.noise_in_words import noise_in_words, noise_of
from cli.commands import SAMPLES, beltrami, colours_in
from formats.image_files import encode
from oracles.pictures import photograph

ADVICE = re.compile(r"--\w[\w-]*(?: (?:[\d.]+(?:/255)?|smooth))?")


@pytest.fixture
def noisy(tmp_path):
    """Make a photograph with noise of 15 of 255."""
    noise = np.random.default_rng(1).normal(0, 15, (96, 96, 3))
    pixels = np.rint(255 * photograph(96) + noise).clip(0, 255).astype(np.uint8)
    (tmp_path / "in.png").write_bytes(encode(pixels, "png"))
    return tmp_path / "in.png"


@pytest.fixture
def suppose(monkeypatch):
    """Let there be no noise with a probability."""

    def set_none(none):
        def sizes(*evidence):
            return [dataclasses.replace(each, none=none) for each in sizes_of(*evidence)]

        monkeypatch.setattr(size, "sizes_of", sizes)

    return set_none


def smoothed(source, *options):
    """Smooth a file; return what is said, the report and the result."""
    result, report = source.with_stem("out"), source.with_name("run.json")
    run = beltrami("smooth", source, result, "--overwrite", "--report", report, *options, text=True)
    return run.stderr, colours_in(report), result.read_bytes()


def advice_in(said):
    return {match.group() for match in ADVICE.finditer(said)}


@pytest.mark.parametrize(
    ("none", "strength", "words"),
    [
        (0.01, "normal", r"noise .*\d/255.* removed \(colours moved by"),
        (0.15, "normal", "may be noise or texture: removed .*; --noise 0 keeps it"),
        (0.5, "normal", "may be noise or texture: left as it is; --noise [\\d.]+ removes it"),
        (0.5, "strong", "may be noise or texture: removed .*; --noise 0 keeps it"),
        (0.95, "normal", "no noise detected, .*left as they are; to smooth all the same, give --noise"),
    ],
)
def test_each_advice_changes_the_result(none, strength, words, noisy, suppose):
    suppose(none)
    said, part, result = smoothed(noisy, "--strength", strength)
    assert re.search(words, said)
    assert part["reading"]["none"] == none
    assert (result == noisy.read_bytes()) == (not part["iterations"])
    assert len(advice_in(said)) == (none > 0.1)
    for options in advice_in(said):
        _, other, changed = smoothed(noisy, "--strength", strength, *options.split())
        assert changed != result
        # What is right if there is noise: about the noise.
        assert max(part["change"]["mean"], other["change"]["mean"]) > 8 / 255
        assert other["reading"] is None


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        *("head-clean.ply", "knot-clean.ply", "terrain-clean.ply", "nonmanifold-noisy.ply"),
        *("torus-two-clean-dough.png", "torus-two-clean-icing.png", "torus-two-noisy-dough.png"),
    ],
)
def test_each_advice_on_samples_changes_the_result(name, tmp_path):
    source = tmp_path / name
    source.write_bytes((SAMPLES / name).read_bytes())
    said, part, result = smoothed(source)
    for options in advice_in(said + beltrami("info", source, text=True).stdout) - {"--json"}:
        _, other, changed = smoothed(source, *options.split())
        assert changed != result
        assert max(part["change"]["mean"], other["change"]["mean"]) > 0.1 / 255


@pytest.mark.parametrize("shade", [0, 90])
def test_where_nothing_can_change_nothing_is_advised(shade, tmp_path):
    (tmp_path / "in.png").write_bytes(encode(np.full((48, 48, 3), shade, np.uint8), "png"))
    said, _, _ = smoothed(tmp_path / "in.png")
    assert "no noise detected, so the colours are left as they are\n" in said
    assert not advice_in(said)


@pytest.mark.parametrize("none", [0.01, 0.15, 0.5, 0.95])
def test_info_and_the_report_say_the_same_as_the_result(none, noisy, suppose):
    suppose(none)
    said, part, _ = smoothed(noisy, "-v")
    shown = beltrami("info", noisy, text=True).stdout
    facts = json.loads(beltrami("info", noisy, "--json", text=True).stdout)
    assert facts["reading"] == part["reading"]
    words = noise_in_words(part, is_smoothed=part["iterations"] > 0)
    assert f"noise   {words}\n" in shown
    shared = "may be noise or texture" if "texture" in words else noise_of(part) if none < 0.1 else words
    assert shared in said.splitlines()[-1] + "".join(said.splitlines()[:4])
    estimates = [re.findall(r"(?:predicted PSNR|no PSNR can be) .*", text) for text in (said, shown)]
    assert estimates[0] == estimates[1]


@pytest.mark.slow
def test_tables_have_the_same_noise_as_the_message_on_a_single_file(noisy):
    _, part, _ = smoothed(noisy)
    size = show_amount(part["reading"]["median"])
    other = noisy.with_stem("other")
    other.write_bytes(noisy.read_bytes())
    listed = beltrami("info", noisy, other, text=True).stdout.splitlines()[1:]
    done = batch(noisy, "--out-dir", noisy.parent / "many")
    assert show_amount(max(part["noise"].values())) != size
    assert [re.findall(r"[\d.]+/255", line)[0] for line in listed] == [size, size]
    assert size in done


def test_hidden_pixels_are_smoothed_by_the_advice(noisy):
    pixels = np.dstack([np.random.default_rng(2).integers(90, 160, (64, 64, 3)), np.zeros((64, 64))])
    noisy.write_bytes(encode(pixels.astype(np.uint8), "png"))
    said, _, result = smoothed(noisy)
    (options,) = advice_in(said)
    assert smoothed(noisy, *options.split())[2] != result


def test_the_result_is_one_line_and_kernels_are_shown_on_request(noisy):
    internals = r"beta|kernel|patches|pitch|work:"
    (line,) = smoothed(noisy)[0].splitlines()
    assert not re.search(internals, line)
    assert re.search(internals, smoothed(noisy, "-v")[0])


def reading(low, median, high, none=0.0):
    return describe_reading(Reading(none, low / 255, median / 255, high / 255), 1.0)


def test_an_interval_is_shown_where_it_is_wide():
    part = {"noise": {"red": 13 / 255}, "noise_model": {"grain": 1.0}}
    assert noise_of({**part, "reading": None}) == "13.0/255"
    assert noise_of({**part, "reading": reading(10, 12, 14)}) == "12.0/255"
    assert noise_of({**part, "reading": reading(3, 6.2, 14)}) == "about 6.2/255 (3 to 14)"


@pytest.mark.parametrize(
    ("read", "is_clean"),
    [
        (reading(3, 6, 14, 0.91), True),
        (reading(3, 6, 14, 0.85), False),
        (reading(0.2, 0.5, 1.9), True),
        (reading(0.5, 1.5, 8, 0.5), False),
        (reading(0.5, 1.5, 8, 0.8), True),
    ],
)
def test_no_noise_is_said_only_where_one_in_ten_such_pictures_has_visible_noise_at_most(read, is_clean):
    part = {"noise": {"red": 0.0}, "noise_model": {"grain": 1.0}, "reading": read}
    words = noise_in_words(part, is_smoothed=False)
    assert (words == "no noise detected") == (is_clean or read["none"] <= 0.1)


def test_the_standard_output_has_a_name(noisy):
    run = beltrami("smooth", "-", "-", stdin=noisy.read_bytes())
    assert run.stderr.startswith(b"<stdout>: 96 x 96 pixels, noise ")


def test_the_noise_that_jpeg_left_of_what_is_given_is_explained(tmp_path):
    noisy = np.random.default_rng(1).normal(120, 12, (64, 64, 3)).clip(0, 255).astype(np.uint8)
    for name, known in (("in.jpg", "jpeg"), ("in.png", "png")):
        (tmp_path / name).write_bytes(encode(noisy, known))
        said, _, _ = smoothed(tmp_path / name, "--noise", "12")
        assert ("which JPEG coding left of 12.0/255" in said) == (known == "jpeg")


@pytest.mark.parametrize("given", ["12", "shot:0.01,read:0.01", "{}/sigma.png"])
def test_given_noise_is_not_in_doubt(given, noisy, suppose):
    suppose(0.15)
    (noisy.parent / "sigma.png").write_bytes(encode(np.full((96, 96, 3), 12, np.uint8), "png"))
    said, part, _ = smoothed(noisy, "--noise", given.format(noisy.parent))
    assert part["reading"] is None
    assert "may be noise or texture" not in said
