"""Lines of points: which columns are the colours, by names, by values, or by what users say; only colours change."""

import numpy as np
import pytest

from beltrami_cli.errors import InputError, NoColoursError
from beltrami_cli.formats.files.access import Access
from beltrami_cli.formats.points.text_document import TextPointsDocument
from beltrami_cli.formats.registry import open_bytes
from beltrami_cli.jobs.check import check_files
from formats.gltf_files import patched

RGB = ("red", "green", "blue")
COUNT = 400


def opened(data, name="a.xyz", **access):
    return TextPointsDocument(data, name, None, Access(**access))


@pytest.mark.parametrize(
    ("text", "channels", "colours"),
    [
        (b"1 2 3 0 51 255", RGB, [0, 0.2, 1]), (b"1 2 3 0 0.2 1", RGB, [0, 0.2, 1]),
        (b"1 2 3 0 13107 65535", RGB, [0, 0.2, 1]), (b"1 2 3 1023 0 341\n" * 9, RGB, [1, 0, 1 / 3]),
        (b"1 2 3 0.25", ("intensity",), [0.25]), (b"1 2 3 51", ("intensity",), [0.2]),
        (b"1 2 3 -1024 \n 1 2 3 2048", ("intensity",), [-0.5]), (b"1 2 3 1 0 0 0 0.6 0.8", RGB, [1, 0, 0]),
        (b"# x y z b g r\n1 2 3 255 51 0", RGB, [0, 0.2, 1]),
        (b"//X;Y;Z;R;G;B;Intensity\n1;2;3;0;51;255;9", RGB, [0, 0.2, 1]),
        (b"x y z i nx ny nz\n1 2 3 0.25 0 0 1", ("intensity",), [0.25]),
        (b"i r g b z y x\n7 0 51 255 3 2 1", RGB, [0, 0.2, 1]),
        (b"\xef\xbb\xbf1,2,3,0,51,255\r\n", RGB, [0, 0.2, 1]),
        (b"1\t2\t3\t0\t51\t255\r1 2 3 4 5 6\r", RGB, [0, 0.2, 1]),
        (b"# scanned on Monday\n\n 1 2 3 1 0 0 # red\n1 2 3 0 1 0\n", RGB, [1, 0, 0]),
    ],
)  # fmt: skip
def test_numbers_are_read_whatever_their_range_separators_and_line_ends(text, channels, colours):
    vertices = opened(text).coloured_vertices()
    assert vertices.channels == channels
    assert vertices.positions[0].tolist() == [1, 2, 3]
    assert np.allclose(vertices.colours[0], colours, atol=1e-6)
    assert vertices.faces.shape == (0, 3)


def test_what_is_not_obvious_is_said():
    document = opened(b"1 2 3 977 0 51 255")
    assert document.notices == ("Its 7 columns are taken for x y z intensity red green blue.",)
    document = opened(b"1 2 3 -1024.5")
    assert "1024.5" in document.coloured_vertices().notices[0]


@pytest.mark.parametrize(
    ("text", "error", "said"),
    [
        (b"1 2 3", NoColoursError, "no colours"),
        (b"1 2 3 0 0.6 -0.8\n1 2 3 1 0 0", InputError, "normals"),
        (b"1 2 3 4 5 6 7 8", InputError, "4 to 6 or 5 to 7 or 6 to 8; .*--columns.*x,y,z,r,g,b,scalar"),
        (b"1 2\n3 4\n", InputError, "2 numbers each, and it is not clear which are colours"),
        (b"1 2 3 -4 5 -6 7 8", InputError, "8 numbers each, and it is not clear which are colours"),
        (b"1 2 3 0 0 1 1 0 0", InputError, "columns 4 to 6 or .* or 7 to 9"),
        (b"1 2 3 4 5 6\n1 2 3 4 5\n", InputError, "line 2: 5 numbers, but the first point has 6"),
        (b"\n1 2 3 4 5 6\n1 2 3 four 5 6\n", InputError, "line 3: 'four' is not a number"),
        (b"C 0 0 0\n", InputError, "line 1: 'C' is not a number"),
        (b"3\n1 2 3 4 5 6\n1 2 3 4 5 6\n", InputError, "line 1: 3 points are announced, but 2 follow"),
        (b"1 2 3 4 5 6\n1\n1 2 3 4 5 6\n", InputError, "line 2: one number only"),
        (b"0\n", InputError, "no points"),
        (b"# nothing\n", InputError, "no points"),
        (b"1 2 3 4 5 nan\n", InputError, "the colour of point 0 is not finite"),
        (b"nan 2 3 4 5 6\n", InputError, "1 of 1 positions are not finite"),
        (b"1 2 3 4 5 6000.5\n", InputError, "full scale"),
        (b"x y z r g\n1 2 3 4 5\n", NoColoursError, "x y z r g have no colours"),
        (b"a,b,c\n1,2,3\n", InputError, "a b c have no x, y and z"),
        (
            b"words\nthese are 3 files\n",
            InputError,
            "line 2: 'these' is not a number, so this is not a table",
        ),
        (
            b"ncols 4\nnrows 4\n0 0 0 0\n",
            InputError,
            "line 1: 'ncols' is not a number, so this is not a table",
        ),
        (b"1,5;2,5;3,5;200;100;50\n", InputError, "line 1: commas stand in some places.*with a point"),
        (b"# x y z r g b\n1,5 2,5 3,5 200 100 50\n", InputError, "line 2: commas stand in some places"),
        (b"1,2,3,,5,6\n1,2,3,4,5,6\n", InputError, "line 2: 6 numbers, but the first point has 5"),
        (b"x y z r g b\n1 2 3 4\n", InputError, "names 6 columns, but there are 4"),
        (b"\xff\xfe1\x00 \x002\x00\n1 2 3 4", InputError, "it is not plain text; export"),
        (b"\0" * 40, InputError, "it is not plain text; export"),
        (b"[Points]\n1 2 3 4 5 6\n\xc0\0\n", InputError, "it is not plain text; export"),
    ],
)
def test_what_cannot_be_read_is_refused_in_one_line(text, error, said):
    with pytest.raises(error, match=said) as caught:
        open_bytes(text, "a.txt", None).coloured_vertices()
    assert "\n" not in str(caught.value)
    assert "\0" not in str(caught.value)


def columns():
    """One column of each kind, as text."""
    rng = np.random.default_rng(0)
    shades = np.clip(np.rint(rng.normal((200, 120, 60), 12, (COUNT, 3))), 0, 255).astype(int)
    normals = rng.normal(size=(COUNT, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    known = {axis: rng.uniform(-50, 50, COUNT) for axis in "xyz"}
    for name, shade in zip("rgb", shades.T, strict=True):
        known |= {name: shade, f"{name}f": shade / 255, f"{name}16": shade * 257}
    for axis, normal in zip("xyz", normals.T, strict=True):
        known |= {f"n{axis}": normal, f"u{axis}": np.full(COUNT, float(axis == "z"))}
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


def changed_columns(data, document):
    """The columns in which new colours differ from the old, every other byte being the same."""
    new = patched(document, 1 - document.coloured_vertices().colours)
    separators = bytes.maketrans(b",;\t", b"   ")
    before, after = (
        np.array([line.split() for line in text.translate(separators).splitlines()[-COUNT:]])
        for text in (data, new)
    )
    return [int(column) for column in np.flatnonzero((before != after).any(axis=0))]


BY_VALUES = [
    *((f"x y z {more}", 3) for more in ("r g b", "r g b class", "r g b i12", "r g b time class")),
    ("x y z r g b i12 nx ny nz", 3), ("x y z r g b ux uy uz", 3), ("x y z rf gf bf i12", 3),
    ("x y z rf gf bf ux uy uz class", 3), ("x y z r16 g16 b16 db", 3), ("x y z class r g b", 4),
    ("x y z db rf gf bf", 4), ("x y z nx ny nz r g b", 6), ("x y z time class r g b", 5),
]  # fmt: skip
BY_NAMES = [
    ("//X Y Z R G B Intensity\n", " "),
    ("//X,Y,Z,R,G,B,Scalar field\n", ","),
    ("# made on a b c d Monday\n# x y z r g b i\n", " "),
    ("x,y,z,red,green,blue,scalar\n", ","),
    ('"X";"Y";"Z";"Red";"Green";"Blue";"Scalar field #2"\n', ";"),
    ("X\tY\tZ\tR\tG\tB\tGPS time\n", "\t"),
    (f"//X Y Z R G B Return\n{COUNT}\n", " "),
]
BY_OPTION = [
    ("x y z r g b i8", "x y z r g b scalar", [3, 4, 5]),
    ("x y z i8 r g b", "X Y Z Intensity Red Green Blue", [4, 5, 6]),
    ("x y z i12 return returns class", "x y z intensity return returns class", [3]),
    ("i8 b g r z y x", "any b g r z y x", [1, 2, 3]),
    ("x y z r g b class", "x y z a b c intensity", [6]),
]
COUNTED = {"head": f"{COUNT}\n", "name": "a.pts"}  # the intensity comes first if it can


@pytest.mark.parametrize(
    ("layout", "found", "more"),
    [
        *(
            (layout, [at, at + 1, at + 2], {"separator": "; " if "class" in layout else " "})
            for layout, at in BY_VALUES
        ),
        *(
            ("x y z r g b i8", [3, 4, 5], {"head": head, "separator": separator})
            for head, separator in BY_NAMES
        ),
        *(
            (layout, found, {"head": head, "columns": tuple(given.split())})
            for layout, given, found in BY_OPTION
            for head in ("", "x y z r g b other\n", "//X Y Z R G B Other\n")
        ),
        ("x y z i8 r g b", [4, 5, 6], COUNTED),
        ("x y z r g b i12", [3, 4, 5], COUNTED),
    ],
)
def test_colours_are_found_by_options_by_names_in_the_file_and_by_values(layout, found, more):
    data = table(layout, more.get("separator", " "), more.get("head", ""))
    document = opened(data, more.get("name", "a.xyz"), columns=more.get("columns", ()))
    assert changed_columns(data, document) == found


UNCLEAR = [
    ("x y z r g b i8", "the colours can be columns 4 to 6 or 5 to 7"),
    ("x y z r16 g16 b16 i12", "the colours can be columns 4 to 6 or 5 to 7"),
    ("x y z i12 return returns class", "it is not clear which are colours"),
    ("x y z return returns class", "it is not clear which are colours"),
    ("x y z db i12", "it is not clear which are colours"),
]


@pytest.mark.parametrize(("layout", "cause"), UNCLEAR)
def test_two_readings_or_none_are_refused_with_the_option_that_decides(layout, cause):
    with pytest.raises(InputError, match=f"{cause}; give --columns") as caught:
        opened(table(layout)).coloured_vertices()
    assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match=cause):  # and not compared as if there were no colours
        opened(table(layout)).fingerprint()


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
        opened(table("x y z r g b class"), columns=tuple(given.split())).coloured_vertices()


@pytest.mark.parametrize(
    ("suffix", "written"), [("asc", "xyz"), ("txt", "xyz"), ("csv", "csv"), ("XYZ", "xyz")]
)
def test_other_suffixes_are_read_as_tables(suffix, written):
    data = table("x y z r g b class", ",", "x,y,z,red,green,blue,class\n")
    document = open_bytes(data, f"a.{suffix}", None)
    assert document.format == written
    assert changed_columns(data, document) == [3, 4, 5]


@pytest.mark.parametrize("layout", ["x y z r g b i12", "x y z r g b class", "x y z i12 r g b"])
def test_the_check_takes_the_columns_of_the_first_file_for_both(layout, tmp_path):
    """Whatever the new colours look like: here they have few values, and so can be read in two ways."""
    data = table(layout)
    before, after = tmp_path / "a.xyz", tmp_path / "b.xyz"
    before.write_bytes(data)
    document = opened(data)
    after.write_bytes(patched(document, np.rint(document.coloured_vertices().colours)))
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


def test_counts_may_head_several_scans():
    document = opened(b"2\n0 0 0 1 2 3 4\n1 0 0 5 6 7 8\n1\n0 1 0 1 2 3 4\n", "scan.pts")
    assert len(document.coloured_vertices().positions) == 3
    assert document.facts()["announced"] == [2, 1]
    assert document.facts()["columns"] == ["x", "y", "z", "intensity", "red", "green", "blue"]


def test_points_without_a_place_take_no_part_and_keep_their_bytes():
    text = b"0 0 0 10 20 30\nnan nan nan 0 0 0\n1 0 inf 9 9 9\n1 0 0 40 50 60\n"
    document = opened(text)
    assert len(document.coloured_vertices().positions) == 2
    assert "2 of 4 points have no finite position" in document.coloured_vertices().notices[0]
    result = patched(document, np.array([[1, 0, 0], [0, 0, 1]]))
    assert result == b"0 0 0 255 0 0\nnan nan nan 0 0 0\n1 0 inf 9 9 9\n1 0 0 0 0 255\n"


def test_colours_that_stay_keep_their_bytes_to_the_last():
    document = opened(b"  1 2.50 3 010 +20 030 # a\r\n\r\n// b\r\n4,5,6;\t40 50\t60")
    same = document.coloured_vertices().colours
    assert patched(document, same) == b"  1 2.50 3 010 +20 030 # a\r\n\r\n// b\r\n4,5,6;\t40 50\t60"
    assert patched(document, None) == patched(document, same)
    # A change that is lost in rounding is none.
    assert patched(document, same + np.float32(1e-4)) == patched(document, same)
    other = same.copy()
    other[0, 1] = 21 / 255
    assert patched(document, other) == b"  1 2.50 3 010 21 030 # a\r\n\r\n// b\r\n4,5,6;\t40 50\t60"


def test_other_columns_are_attributes():
    document = opened(b"1 2 3 -7 1 2 3 0 0 1\n4 5 6 8 1 2 4 0 0 1\n")
    assert document.attributes() == ("normal", "intensity")
    assert document.attribute("Intensity").tolist() == [[-7], [8]]
    assert document.attribute("normal").tolist() == [[0, 0, 1], [0, 0, 1]]
    with pytest.raises(InputError, match="no depth"):
        document.attribute("depth")
