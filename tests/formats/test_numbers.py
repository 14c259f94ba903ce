"""Numbers in files: full scale is that of the least number of bits that holds them; tokens are split as by Python."""

import json

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from beltrami_cli.formats.files.edits import exchange_tokens
from beltrami_cli.formats.files.tokens import find_tokens, read_numbers
from beltrami_cli.formats.full_scale import full_scale, intensity_scale
from beltrami_cli.formats.ply.document import PlyDocument
from beltrami_cli.formats.registry import open_bytes
from cli.commands import beltrami
from formats.gltf_files import patched
from small_models import ply

COUNT = 1000
NAMES = {"colours": ("red", "green", "blue"), "intensity": ("intensity",)}


def scan(bits, what="colours"):
    """Return noisy numbers around 0.8 and 0.3 of full scale, by turns."""
    full = 2**bits - 1
    truth = np.tile([0.8, 0.3], COUNT // 2)[:, None]
    noise = 0.06 * np.random.default_rng(0).standard_normal((COUNT, len(NAMES[what])))
    return np.rint(np.clip(truth + noise, 0, 1) * full).astype(int)


def as_ply(kind, numbers, what="colours"):
    rows = [[n, 0, 0, *row] for n, row in enumerate(numbers.tolist())]
    return ply(f"float x y z, {kind} {' '.join(NAMES[what])}", rows)


def scale_of(data):
    return PlyDocument(data, "in.ply").coloured_vertices().full_scale


@pytest.mark.parametrize(
    ("kind", "what", "bits"),
    [
        *((kind, "colours", bits) for bits in (8, 10, 12, 16) for kind in ("ushort", "uint", "int")),
        ("short", "colours", 12),
        *((kind, "intensity", bits) for bits in (8, 10, 12, 14, 16) for kind in ("ushort", "int", "float")),
    ],
)
def test_the_full_scale_is_that_of_the_bits_whatever_type_holds_them(kind, what, bits):
    assert scale_of(as_ply(kind, scan(bits, what), what)) == 2**bits - 1


def test_dim_colours_of_16_bit_are_not_taken_for_14_bit():
    # A picture of a quarter of full scale is dim, and would be four times too bright in another format.
    assert scale_of(as_ply("ushort", scan(14))) == 65535


def test_opacity_says_the_range_of_dark_colours():
    rows = [[n, 0, 0, 40, 50, 200, 65535] for n in range(3)]
    assert scale_of(ply("float x y z, ushort red green blue alpha", rows)) == 65535


def test_files_that_fit_into_different_bits_are_compared_on_one_scale(tmp_path):
    before, after = scan(8), scan(8)
    before[0], after[0] = 300, 250
    paths = [tmp_path / "before.ply", tmp_path / "after.ply"]
    for path, numbers in zip(paths, (before, after), strict=True):
        path.write_bytes(as_ply("ushort", numbers))
    report = json.loads(beltrami("compare", *paths, "--json").stdout)
    error = np.sqrt(np.mean(np.square((before - after) / 1023)))
    assert report["parts"][0]["psnr"] == pytest.approx(-20 * np.log10(error), abs=1e-3)


@pytest.mark.parametrize("single", [17.0, 300.0, 1e6, -1e6])
def test_one_spike_says_nothing_of_the_range(single):
    """As renderers make them, and as scanners mark what they did not see."""
    rng = np.random.default_rng(3)
    colours, values = rng.random((500, 3)), rng.random((2000, 1))
    colours[7, 1], values[7] = single, -0.01
    assert full_scale(colours, "x.ply")[0] == 1
    assert intensity_scale(values)[0] == 1
    whole = np.rint(4000 * np.abs(values))
    whole[7] = -1
    assert intensity_scale(whole)[0] == 4095


@pytest.mark.parametrize(
    ("form", "text", "new", "expected"),
    [
        ("obj", "v 0 0 0 1 0 0", [0.2, 0, 0], "v 0 0 0 0.200000 0 0"),
        ("obj", "v 0 0 0 0.50000000 0 0", [0.2, 0, 0], "v 0 0 0 0.20000000 0 0"),
        ("obj", "v 0 0 0 0.5000000000000000 0 0", [0.25, 0, 0], "v 0 0 0 0.250000000 0 0"),
        ("obj", "v 0 0 0 5e-1 0 1E0", [0.25, 0, 1], "v 0 0 0 0.25 0 1E0"),
        ("obj", "v 0 0 0 200 0 7", [1.5, -1, 0.5], "v 0 0 0 255 0 128"),
        ("xyz", "0 0 0 0.5 0.25 0.75", [0.5, 0.3, 0.75], "0 0 0 0.5 0.300000 0.75"),
        ("xyz", "0 0 0 0.500000000 0 1", [0.5, 0.1, 1], "0 0 0 0.500000000 0.100000001 1"),
        ("xyz", "0 0 0 5e-1 0 1", [0.5, 0.125, 1], "0 0 0 5e-1 0.125 1"),
        ("xyz", "0 0 0 127.5 0 255", [0.5, 0.125, 1], "0 0 0 127.5 31.8750 255"),
        ("xyz", "0 0 0 -1024\n0 0 1 2048", [[-0.25], [1]], "0 0 0 -512\n0 0 1 2048"),
        ("xyz", "0 0 0 -1024\n0 0 1 2048", [[-1e-5], [1]], "0 0 0 0\n0 0 1 2048"),
        ("xyz", "0 0 0 -9 1 2 3\n0 0 0 9 4 5 6", [[1, 0, 0], [0, 1, 0]], "0 0 0 -9 255 0 0\n0 0 0 9 0 255 0"),
        ("xyz", "x y z b g r\n0 0 0 1 2 3", [1, 2 / 255, 0], "x y z b g r\n0 0 0 0 2 255"),
        ("xyz", "0 0 0 200 0 7", [1.5, -1, 0.5], "0 0 0 255 0 128"),
        ("xyz", "1\r0;0;0;200; 0;7\r", [0, 1, 0], "1\r0;0;0;0; 255;0\r"),
    ],
)
def test_new_colours_are_spelled_as_the_old_ones(form, text, new, expected):
    document = open_bytes(text.encode(), f"a.{form}", None)
    assert patched(document, np.atleast_2d(new)) == expected.encode()


texts = st.text(alphabet="1a.-e \t\n\r\v\f\0#", max_size=30).map(str.encode)


@given(texts)
def test_tokens_are_those_of_split(text):
    starts, ends = find_tokens(text)
    assert [text[a:b] for a, b in zip(starts, ends, strict=True)] == text.split()


@given(
    st.lists(st.sampled_from(["1", "-2.5", "1e3", "nan", "x", "1-2", "0x1", "1_0", ".", "7,"]), max_size=12)
)
@example([" "])
def test_numbers_are_read_up_to_the_first_token_that_is_none(tokens):
    good = []
    for token in " ".join(tokens).split():
        if token not in ("1", "-2.5", "1e3", "nan"):
            break
        good.append(float(token))
    np.testing.assert_array_equal(read_numbers(" ".join(tokens).encode()), good)


@given(texts, st.data())
def test_exchange_keeps_everything_else(text, data):
    starts, ends = find_tokens(text)
    chosen = np.array(
        sorted(data.draw(st.sets(st.integers(0, max(len(starts) - 1, 0))))) if len(starts) else [], int
    )
    words = [b"<%d>" % number for number in chosen]
    pieces = exchange_tokens(text, starts[chosen], ends[chosen], lambda block: words[block])
    expected, at = b"", 0
    for number, word in zip(chosen, words, strict=True):
        expected += text[at : starts[number]] + word
        at = ends[number]
    assert b"".join(pieces) == expected + text[at:]
