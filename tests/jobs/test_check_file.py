"""Whatever is not a colour is found if it differs, and nothing is found that smoothing may change."""

import json
import re
import shutil
from functools import partial

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from beltrami_cli.errors import InputError, UsageError
from beltrami_cli.formats.changes import Naming
from beltrami_cli.formats.registry import open_document
from beltrami_cli.jobs.check import check_files
from cli.commands import SAMPLES, beltrami, copy_samples
from formats.ply_files import ENCODINGS, Table, build, coloured
from hostile.textured_models import KINDS, OTHER, PICTURE, write_model


def saved(written, path):
    path.write_bytes(b"".join(written.main))
    for name, data in written.sidecars.items():
        (path.parent / name).parent.mkdir(parents=True, exist_ok=True)
        (path.parent / name).write_bytes(data)
    return path


def halved(source, target):
    """Write a file with darker vertex colours."""
    document = open_document(str(source))
    colours = document.coloured_vertices().colours * np.float32(0.5)
    return saved(
        document.patch(colours, Naming(target.stem, in_place=source.parent != target.parent)), target
    )


def everything(encoding):
    tables = coloured(6, [[0, 1, 2], [1, 2, 3, 4], [5, 4, 3]], "uchar", 1)
    tables.append(Table("other", [("list", "uchar float"), ("scalar", "short")], [[[0.5, 1.5], 3], [[], 4]]))
    return build(tables, encoding, comments=["made by hand", "TextureFile a.png"]).data + b"\ntrailing"


FILES = {
    **{f"{encoding}.ply": everything(encoding) for encoding in ENCODINGS},
    "colours.obj": b"# text\nmtllib m.mtl\nv 0 0 0 1 0 0\nv 1 0 0 .5 .25 1\nv 0 1 0 0 0 1 # note\nvt 0 0\n"
    b"usemtl m\ng a\nf 1/1 2/1 3/1\nl 1 2\n",
    "polypaint.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\n#MRGB ff102030ff405060ff7080a0\nf 1 2 3\n",
}


@pytest.mark.slow
@pytest.mark.parametrize("name", FILES)
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_every_byte_counts_unless_it_makes_another_colour_or_spells_it_otherwise(name, data, tmp_path):
    before = tmp_path / name
    before.write_bytes(FILES[name])
    (tmp_path / "m.mtl").write_text("newmtl m\nmap_Kd a.png\nmap_Ks none.png\n")
    (tmp_path / "a.png").write_bytes(PICTURE)
    after = halved(before, tmp_path / f"after{before.suffix}")
    assert check_files(before, after).faithful
    good = after.read_bytes()
    at = data.draw(st.integers(0, len(good) - 1))
    new = data.draw(st.binary(max_size=2).filter(lambda new: new != good[at : at + 1]))
    after.write_bytes(good[:at] + new + good[at + 1 :])
    try:
        report = check_files(before, after)
    except (InputError, UsageError):
        return
    if report.faithful:
        known = [open_document(str(path)).coloured_vertices().colours for path in (before, after)]
        after.write_bytes(good)
        true = open_document(str(after)).coloured_vertices().colours
        if after.suffix == ".obj" and same_but_for_spelling(good, good[:at] + new + good[at + 1 :]):
            return
        assert not np.array_equal(known[1], true) or np.array_equal(known[0], true)


def same_but_for_spelling(*texts):
    """Return whether texts are the same without the last three numbers of vertices of six."""
    blanked = {re.sub(rb"(?m)^(v(?: \S+){3})(?: \S+){3}", rb"\1", text) for text in texts}
    return len(blanked) == 1


def leaves(tree, place=()):
    children = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    found = [leaf for key, value in children for leaf in leaves(value, (*place, key))]
    return found or [place]


def sample_as_text(name, folder):
    """Put a sample into a folder as a glTF file of text."""
    before = folder / "before.gltf"
    if name == "nonmanifold":
        document = open_document(str(SAMPLES / f"{name}-noisy.glb"))
        saved(document.patch(None, Naming("x", in_place=True), form="gltf"), before)
    else:
        (copy_samples(folder, "torus-two-noisy*") / name).rename(before)
    return before


def accessors_of_colours(tree):
    return {each["attributes"].get("COLOR_0") for mesh in tree["meshes"] for each in mesh["primitives"]}


def another(value):
    """Return another value of the same kind, if it is text or a number."""
    if isinstance(value, str):
        return f"{value}-"
    return value + 1 if isinstance(value, (int, float)) else {"new": 1}


@pytest.mark.parametrize("name", ["torus-two-noisy.gltf", "nonmanifold"])
def test_every_member_of_a_gltf_counts(name, tmp_path):
    before = sample_as_text(name, tmp_path)
    tree = json.loads(before.read_text())
    tree["extras"] = {"note": "kept", "numbers": [1, 2.5]}
    tree["nodes"][0]["name"] = "node"
    for accessor in tree["accessors"]:
        accessor |= {"name": "numbers", "extras": {"kept": 1}}
    before.write_text(json.dumps(tree))
    after = tmp_path / "after.gltf"
    missed = []
    for *parents, last in leaves(tree):
        changed = json.loads(before.read_text())
        holder = changed
        for key in parents:
            holder = holder[key]
        holder[last] = another(holder[last])
        after.write_text(json.dumps(changed))
        try:
            if check_files(before, after).faithful:
                missed.append((*parents, last))
        except (InputError, UsageError):
            continue
    # How buffers are called and how long they are counts by their content; as does where colours are.
    colours = accessors_of_colours(tree)
    views = {tree["accessors"][index].get("bufferView") for index in colours - {None}}
    assert [
        place
        for place in missed
        if place[0] not in ("buffers", "images")
        and not (place[0] == "accessors" and place[1] in colours and place[2] in ("bufferView", "min", "max"))
        and not (place[0] == "bufferViews" and place[1] in views)
    ] == []


def test_bytes_behind_accessors_count(tmp_path):
    source = SAMPLES / "nonmanifold-noisy.glb"
    after = halved(source, tmp_path / "after.glb")
    assert check_files(source, after).faithful
    good = after.read_bytes()
    json_length = int.from_bytes(good[12:16], "little")
    tree = json.loads(good[20 : 20 + json_length])
    for index, accessor in enumerate(tree["accessors"]):
        view = tree["bufferViews"][accessor["bufferView"]]
        at = 28 + json_length + view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        after.write_bytes(good[:at] + bytes([good[at] ^ 1]) + good[at + 1 :])
        report = check_files(source, after)
        assert report.faithful == (index in accessors_of_colours(tree))


@pytest.mark.parametrize("kind", KINDS)
def test_images_may_differ_in_pixels_but_not_in_size(kind, tmp_path):
    before = write_model(tmp_path / "a", kind, "a.png")
    (tmp_path / "a" / "a.png").write_bytes(PICTURE)
    after = write_model(tmp_path / "b", kind, "a.png")
    (tmp_path / "b" / "a.png").write_bytes(OTHER)
    report = check_files(before, after)
    assert report.faithful
    assert "400 of 400 differ" in report.differences[0].detail
    (tmp_path / "b" / "a.png").write_bytes(b"junk")
    assert not check_files(before, after).faithful
    shutil.copy(SAMPLES / "scan-noisy.jpg", tmp_path / "b" / "a.png")
    report = check_files(before, after)
    assert not report.faithful
    assert "20 x 20 pixels became 512 x 512 pixels" in report.differences[0].detail
    (tmp_path / "b" / "a.png").unlink()
    assert not check_files(before, after).faithful


def test_texels_on_the_surface_are_counted_apart_from_those_around_charts(tmp_path):
    source = SAMPLES / "torus-two-noisy.gltf"
    beltrami("smooth", source, tmp_path / "o.gltf", "-n", 1, "--beta", 5, "--gutter", "keep", "--fast")
    lines = beltrami("check", source, tmp_path / "o.gltf", text=True).stdout.splitlines()
    assert sum("on the surface" in line for line in lines) == 2
    assert all("in the gutter none of" in line for line in lines if "on the surface" in line)


def test_the_command_lists_and_exits_as_it_says(tmp_path):
    source = SAMPLES / "nonmanifold-noisy.ply"
    after = halved(source, tmp_path / "after.ply")

    check = partial(beltrami, "check", source, text=True)
    run = check(after)
    assert run.stderr == ""
    assert "colour  vertex colours:" in run.stdout
    assert run.stdout.endswith("nothing else differs\n")
    assert check(source).stdout == "nothing differs\n"
    data = json.loads(check(after, "--json").stdout)
    assert data["faithful"]
    assert data["differences"][0]["of_colour"]
    after.write_bytes(after.read_bytes() + b"more")
    run = check(after, code=1)
    assert "OTHER  elements vertex, face: differs from its byte" in run.stdout
    assert run.stdout.endswith("\n1 thing besides colours differs\n")
    assert check(after, "-q", code=1).stdout == ""


def test_of_many_differences_those_besides_colours_are_listed_first_and_all_are_counted():
    check = partial(
        beltrami, "check", SAMPLES / "head-tex-noisy.glb", SAMPLES / "scan-noisy.glb", text=True, code=1
    )
    *differences, more, total = check().stdout.splitlines()
    *every, same_total = check("-v").stdout.splitlines()
    assert len(differences) < len(every)
    assert set(differences) < set(every)
    assert more.split() == [str(len(every) - len(differences)), "more;", "-v", "lists", "all"]
    assert total == same_total == f"{sum('OTHER' in line for line in every)} things besides colours differ"
