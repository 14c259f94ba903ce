"""Every seed, every input that once did harm, and some mutations of them: a short replay of what `make fuzz` does."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from beltrami_cli.formats.registry import FORMATS
from fuzz.targets import TARGETS, attempt

CORPUS = Path(__file__).with_name("corpus")
SEEDS = sorted(path for path in CORPUS.rglob("*") if path.is_file() and path.parent.name != "core")
MUTATIONS = 40
FEW = {"usd": 1}  # by target, where each takes some processes of 0.3 s


def mutated(data: bytes, others: list[bytes], chance: random.Random) -> bytes:
    """Change, remove, repeat or put in some bytes, as a fuzzer does."""
    result = bytearray(data)
    for _ in range(chance.randint(1, 4)):
        at = chance.randrange(len(result) + 1)
        length = chance.choice([0, 1, 1, 2, 4, 8, 40])
        new = chance.choice(
            [
                chance.randbytes(chance.choice([1, 2, 4, 8])),
                bytes([chance.choice([0, 1, 127, 128, 255])]) * chance.choice([1, 4, 8]),
                str(chance.choice([-1, 0, 2**31, 2**32 - 1, 2**63, 1e308, "nan", "1e-400"])).encode(),
                bytes(result[at : at + length]) * chance.choice([2, 30]),
                (donor := chance.choice(others))[
                    (a := chance.randrange(len(donor) + 1)) : a + chance.choice([4, 60])
                ],
            ]
        )
        result[at : at + length] = new
    return bytes(result[: chance.choice([len(result)] * 3 + [chance.randrange(len(result) + 1)])])


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS, ids=[f"{path.parent.name}-{path.name}" for path in SEEDS])
def test_nothing_worse_than_a_refusal(seed: Path) -> None:
    target = seed.parent.name
    if target == "usd":
        pytest.importorskip("pxr", reason="usd-core is not installed")
    data = seed.read_bytes()
    attempt(target, data)
    chance = random.Random(seed.name)
    others = [path.read_bytes() for path in SEEDS if path.parent == seed.parent]
    for number in range(FEW.get(target, MUTATIONS)):
        bad = mutated(data, others, chance)
        try:
            attempt(target, bad)
        except Exception as error:
            raise AssertionError(
                f"{type(error).__name__} from mutation {number}, {len(bad)} bytes"
            ) from error


def test_every_reader_is_fuzzed() -> None:
    fuzzed = {line.reader for line in FORMATS if {line.name, *line.aliases} & {*TARGETS}}
    # Other libraries read surveys, in processes of their own that take 0.3 s each.
    assert {line.reader for line in FORMATS} - fuzzed == {"survey"}


def test_every_target_has_seeds() -> None:
    assert {path.parent.name for path in SEEDS} == set(TARGETS)
