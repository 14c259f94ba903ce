"""Tokens are found, read and exchanged as plain Python would."""

from __future__ import annotations

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st

from beltrami_cli.formats.tokens import exchange_tokens, find_tokens, read_numbers

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
