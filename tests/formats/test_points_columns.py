"""Which columns of text files of points are the colours: by names, by values, or by what users say."""

from __future__ import annotations

import numpy as np
import pytest

from beltrami_cli.errors import InputError
from beltrami_cli.formats.access import Access
from beltrami_cli.formats.points.text_document import TextPointsDocument, write_csv
from beltrami_cli.formats.registry import open_bytes
from beltrami_cli.jobs.inspect import check_files
from formats.points_files import patched

COUNT = 400


def columns():
    """One column of each kind, as text."""
    rng = np.random.default_rng(0)
    shades = np.clip(np.rint(rng.normal((200, 120, 60), 12, (COUNT, 3))), 0, 255).astype(int)
    normals = rng.normal(size=(COUNT, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    up = np.tile([0, 0, 1], (COUNT, 1))
    known = {axis: rng.uniform(-50, 50, COUNT) for axis in "xyz"}
    known |= dict(zip("rgb", shades.T, strict=True))
    known |= {f"{name}f": shade / 255 for name, shade in zip("rgb", shades.T, strict=True)}
    known |= {f"{name}16": shade * 257 for name, shade in zip("rgb", shades.T, strict=True)}
    known |= {f"n{axis}": normal for axis, normal in zip("xyz", normals.T, strict=True)}
    known |= {f"u{axis}": normal for axis, normal in zip("xyz", up.T, strict=True)}
    known["class"] = rng.choice([2, 3, 6, 9], COUNT)
    known["return"] = rng.integers(1, 4, COUNT)
    known["returns"] = rng.integers(3, 5, COUNT)
    known["zero"] = np.zeros(COUNT, int)
    known["i8"] = rng.integers(0, 256, COUNT)
    known["i12"] = rng.integers(300, 4096, COUNT)
    known["db"] = rng.normal(-12, 3, COUNT)
    known["time"] = 4e5 + rng.uniform(0, 60, COUNT)
    return {
        name: [f"{value:d}" if values.dtype.kind == "i" else f"{value:.6f}" for value in values]
        for name, values in known.items()
    }


COLUMNS = columns()


def table(layout, separator=" ", head=""):
    rows = zip(*(COLUMNS[name] for name in layout.split()), strict=True)
    return (head + "".join(f"{separator.join(row)}\n" for row in rows)).encode()


def opened(data, name="a.xyz", **access):
    return TextPointsDocument(data, name, None, Access(**access))


def changed_columns(data, document):
    """The columns in which new colours differ from the old, every other byte being the same."""
    new = patched(document, 1 - document.painted().colours)
    separators = bytes.maketrans(b",;\t", b"   ")
    before, after = (
        np.array([line.split() for line in text.translate(separators).splitlines()[-COUNT:]])
        for text in (data, new)
    )
    return [int(column) for column in np.flatnonzero((before != after).any(axis=0))]


@pytest.mark.parametrize(
    ("layout", "first"),
    [
        ("x y z r g b", 3),
        ("x y z r g b class", 3),
        ("x y z r g b zero", 3),
        ("x y z r g b i12", 3),
        ("x y z r g b db", 3),
        ("x y z r g b time class", 3),
        ("x y z r g b class return returns", 3),
        ("x y z r g b i12 nx ny nz", 3),
        ("x y z r g b ux uy uz", 3),
        ("x y z r g b nx ny nz db", 3),
        ("x y z rf gf bf i12", 3),
        ("x y z rf gf bf nx ny nz", 3),
        ("x y z rf gf bf ux uy uz class", 3),
        ("x y z r16 g16 b16 db", 3),
        ("x y z r16 g16 b16 class", 3),
        ("x y z class r g b", 4),
        ("x y z i12 r g b", 4),
        ("x y z db rf gf bf", 4),
        ("x y z nx ny nz r g b", 6),
        ("x y z time class r g b", 5),
    ],
)
@pytest.mark.parametrize("separator", [" ", "\t", ",", "; "])
def test_columns_that_can_be_the_colours_are_found_by_their_values(layout, first, separator):
    data = table(layout, separator)
    assert changed_columns(data, opened(data)) == [first, first + 1, first + 2]


UNCLEAR = [
    ("x y z r g b i8", "the colours can be columns 4 to 6 or 5 to 7"),
    ("x y z i8 r g b", "the colours can be columns 4 to 6 or 5 to 7"),
    ("x y z r16 g16 b16 i12", "the colours can be columns 4 to 6 or 5 to 7"),
    ("x y z i12 return returns class", "it is not clear which are colours"),
    ("x y z return returns class", "it is not clear which are colours"),
    ("x y z i12 return class", "it is not clear which are colours"),
    ("x y z db i12", "it is not clear which are colours"),
]


@pytest.mark.parametrize(("layout", "cause"), UNCLEAR)
def test_two_readings_or_none_are_refused_with_the_option_that_decides(layout, cause):
    with pytest.raises(InputError, match=f"{cause}; give --columns") as caught:
        opened(table(layout)).painted()
    assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match=cause):  # and not compared as if there were no colours
        opened(table(layout)).fingerprint()


@pytest.mark.parametrize(
    ("layout", "given", "found"),
    [
        ("x y z r g b i8", "x y z r g b scalar", [3, 4, 5]),
        ("x y z i8 r g b", "X Y Z Intensity Red Green Blue", [4, 5, 6]),
        ("x y z i12 return returns class", "x y z intensity return returns class", [3]),
        ("i8 b g r z y x", "any b g r z y x", [1, 2, 3]),
        ("x y z r g b class", "x y z a b c intensity", [6]),
    ],
)
def test_given_names_count_for_more_than_those_in_the_file_and_the_values(layout, given, found):
    for head in ("", "x y z r g b other\n", "//X Y Z R G B Other\n"):
        data = table(layout, head=head)
        assert changed_columns(data, opened(data, columns=tuple(given.split()))) == found


@pytest.mark.parametrize(
    ("given", "cause"),
    [
        ("x y z r g b", "7 numbers each, but --columns has 6 names; give --columns"),
        ("x y r g b s t", "have no x, y and z"),
        ("x y z red g b s", "have no colours"),
    ],
)
def test_names_that_do_not_fit_are_refused(given, cause):
    with pytest.raises(InputError, match=cause):
        opened(table("x y z r g b class"), columns=tuple(given.split())).painted()


@pytest.mark.parametrize(
    ("head", "separator"),
    [
        ("//X Y Z R G B Intensity\n", " "),
        ("//X,Y,Z,R,G,B,Scalar field\n", ","),
        ("# made on a b c d Monday\n# x y z r g b i\n", " "),
        ("x,y,z,red,green,blue,scalar\n", ","),
        ('"X";"Y";"Z";"Red";"Green";"Blue";"Scalar field #2"\n', ";"),
        ("X\tY\tZ\tR\tG\tB\tGPS time\n", "\t"),
        (f"//X Y Z R G B Return\n{COUNT}\n", " "),
    ],
)
def test_names_in_the_file_decide(head, separator):
    data = table("x y z r g b i8", separator, head)
    assert changed_columns(data, opened(data)) == [3, 4, 5]


def test_in_files_with_a_count_of_points_the_intensity_comes_first_if_it_can():
    data = table("x y z i8 r g b", head=f"{COUNT}\n")
    assert changed_columns(data, opened(data, "a.pts")) == [4, 5, 6]
    data = table("x y z r g b i12", head=f"{COUNT}\n")
    assert changed_columns(data, opened(data, "a.pts")) == [3, 4, 5]


@pytest.mark.parametrize(
    ("suffix", "written"), [("asc", "xyz"), ("txt", "xyz"), ("csv", "csv"), ("XYZ", "xyz")]
)
def test_other_suffixes_are_read_alike(suffix, written):
    data = table("x y z r g b class", ",", "x,y,z,red,green,blue,class\n")
    document = open_bytes(data, f"a.{suffix}", None)
    assert document.format == written
    assert changed_columns(data, document) == [3, 4, 5]


def test_a_table_that_is_written_has_commas_and_names():
    contents = opened(table("x y z r g b nx ny nz")).contents()
    data = b"".join(write_csv(contents, "a").main)
    assert data.startswith(b"x,y,z,red,green,blue,nx,ny,nz\n")
    again = open_bytes(data, "a.csv", None)
    assert np.array_equal(again.painted().positions, contents.positions)
    assert np.allclose(again.painted().colours, contents.colours, atol=1e-6)


@pytest.mark.parametrize(
    ("data", "cause"),
    [
        (
            b"To whom it may concern:\nthese are 3 files\n",
            "line 2: 'these' is no number, so this is no table",
        ),
        (b"hello\n", "there are no points"),
        (b"name,size\nscan,4\n", "line 2: 'scan' is no number, so this is no table"),
        (b"ncols 4\nnrows 4\n0 0 0 0\n", "line 1: 'ncols' is no number, so this is no table"),
        (b"a,b,c\n1,2,3\n", "a b c have no x, y and z"),
        (b"1,5;2,5;3,5;200;100;50\n", "line 1: commas stand in some places.*decimals with a point"),
        (b"# x y z r g b\n1,5 2,5 3,5 200 100 50\n", "line 2: commas stand in some places"),
        (b"1,2,3,,5,6\n1,2,3,4,5,6\n", "line 2: 6 numbers, but the first point has 5"),
    ],
)
@pytest.mark.parametrize("suffix", ["txt", "csv", "asc", "xyz"])
def test_texts_that_are_no_tables_of_points_are_refused_in_one_line(data, cause, suffix):
    with pytest.raises(InputError, match=cause) as caught:
        open_bytes(data, f"a.{suffix}", None).painted()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("layout", ["x y z r g b i12", "x y z r g b class", "x y z i12 r g b"])
def test_the_check_takes_the_columns_of_the_first_file_for_both(layout, tmp_path):
    """Whatever the new colours look like: here they have few values, and so can be read in two ways."""
    data = table(layout)
    before, after = tmp_path / "a.xyz", tmp_path / "b.xyz"
    before.write_bytes(data)
    document = opened(data)
    after.write_bytes(patched(document, np.rint(document.painted().colours)))
    report = check_files(before, after)
    assert report.faithful
    assert [each.what for each in report.differences] == ["point colours"]
    lines = data.splitlines(keepends=True)
    moved = [column for column in range(7) if column not in document._columns.colours]
    for column in moved:
        words = lines[7].split()
        words[column] = b"255"
        after.write_bytes(b"".join([*lines[:7], b" ".join(words) + b"\n", *lines[8:]]))
        assert not check_files(before, after).faithful
