"""Edited JSON keeps the words of its source."""

from __future__ import annotations

import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beltrami_cli.formats.gltf.container import parsed, revised

values = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-9, 9)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(max_size=4),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
    max_leaves=12,
)
trees = st.dictionaries(st.text(max_size=3), values, max_size=4)
styles = st.sampled_from(
    [
        {},
        {"indent": 2},
        {"indent": "\t"},
        {"separators": (",", ":")},
        {"indent": 0},
        {"indent": 1, "separators": (",", " : ")},
    ]
)


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(old=trees, new=trees, style=styles, ascii_only=st.booleans(), crlf=st.booleans())
def test_revised_text_parses_to_the_new_tree_in_the_style_of_the_source(old, new, style, ascii_only, crlf):
    text = json.dumps(old, ensure_ascii=ascii_only, **style)
    text = text.replace("\n", "\r\n") if crlf else text
    assert revised(text, parsed(text, "")) == text
    assert parsed(revised(text, new), "") == new
    plain, added = {"a": 1, "b": ["x", 3]}, {"a": 1, "b": ["x", 4, 2], "c": "y"}
    text = json.dumps(plain, ensure_ascii=False, **style)
    assert revised(text, added) == json.dumps(added, ensure_ascii=False, **style)


def test_numbers_escapes_and_spacing_of_the_rest_stay():
    text = '{ "a":1.50E+2 ,\n  "caf\\u00e9" : [ 0.10, 2e-3,3 ],\t"b": {"x": 1 , "y":2}  }'
    tree = parsed(text, "")
    tree["b"]["y"] = 7
    tree["café"][2] = 4
    assert revised(text, tree) == text.replace('"y":2', '"y":7').replace("2e-3,3", "2e-3,4")


@pytest.mark.parametrize(
    ("text", "change", "expected"),
    [
        ('{"a":[1],"b":2}', lambda t: t["a"].append(5), '{"a":[1,5],"b":2}'),
        ('{\n  "a": [\n    1\n  ]\n}', lambda t: t["a"].append({"x": 1}),
         '{\n  "a": [\n    1,\n    {\n      "x": 1\n    }\n  ]\n}'),
        ('{"a": 1, "b": 2}', lambda t: t.pop("b"), '{"a": 1}'),
        ('{"a": 1, "b": 2}', lambda t: t.update(c={"d": 1, "e": 2}), '{"a": 1, "b": 2, "c": {"d": 1, "e": 2}}'),
        ('{"a":{},"b":[]}', lambda t: (t["a"].update(x=1), t["b"].append(2)), '{"a":{"x":1},"b":[2]}'),
    ],
)  # fmt: skip
def test_additions_and_removals_take_the_style_of_their_neighbours(text, change, expected):
    tree = parsed(text, "")
    change(tree)
    assert revised(text, tree) == expected


def test_half_characters_stay_escaped():
    text = '{"a": ["\\ud800"], "b": 1}'
    tree = parsed(text, "x.gltf")
    tree["a"].append({"name": tree["a"][0]})
    tree["b"] = "ü"
    assert revised(text, tree).encode() == '{"a": ["\\ud800",{"name": "\\ud800"}], "b": "ü"}'.encode()
