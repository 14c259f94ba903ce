"""3MF files: colours of corners, materials, parts in several files, and damage."""

from __future__ import annotations

import io
import zipfile

import numpy as np
import pytest
import trimesh

from beltrami_cli.errors import InputError
from formats.read_only_files import FACES, LEVELS, OBJECT, SQUARE, VERTICES, model, opened, threemf


def test_3mf_colours_of_corners():
    document = opened(threemf(model(OBJECT)), "x.3mf")
    painted = document.painted()
    np.testing.assert_array_equal(painted.positions, SQUARE)
    np.testing.assert_array_equal(painted.faces, FACES)
    np.testing.assert_allclose(painted.colours, LEVELS / 255, atol=1e-7)
    assert painted.stored == "uint8"


def test_3mf_materials_parts_transforms_and_other_files():
    flat = (
        '<basematerials id="5"><base name="a" displaycolor="#FF0000"/><base name="b" displaycolor="#00FF0080"/>'
        "</basematerials>"
        f'<object id="2" pid="5" pindex="1"><mesh><vertices>{VERTICES}</vertices><triangles>'
        '<triangle v1="0" v2="1" v3="2"/></triangles></mesh></object>'
    )
    parts = (
        f'{OBJECT}<object id="3"><components><component objectid="1" transform="1 0 0 0 1 0 0 0 1 0 0 5"/>'
        '<component objectid="2" p:path="/3D/b.model"/></components></object>'
    )
    build = '<item objectid="3" transform="2 0 0 0 2 0 0 0 2 0 0 1"/>'
    document = opened(threemf(model(parts, build), b=model(flat)), "x.3mf")
    contents = document.contents()
    np.testing.assert_array_equal(contents.positions[:4], SQUARE * 2 + [0, 0, 11])
    np.testing.assert_array_equal(contents.positions[4:], SQUARE * 2 + [0, 0, 1])
    np.testing.assert_array_equal(contents.colours[4:7], [[0, 1, 0]] * 3)
    assert contents.alpha is not None
    np.testing.assert_allclose(contents.alpha, [1, 1, 1, 1, 128 / 255, 128 / 255, 128 / 255, 1], atol=1e-6)
    mesh = trimesh.load_scene(
        io.BytesIO(threemf(model(OBJECT, '<item objectid="1" transform="2 0 0 0 2 0 0 0 2 0 3 1"/>'))),
        file_type="3mf",
    )
    ours = opened(
        threemf(model(OBJECT, '<item objectid="1" transform="2 0 0 0 2 0 0 0 2 0 3 1"/>')), "x.3mf"
    ).painted()
    np.testing.assert_allclose(mesh.to_mesh().vertices[mesh.to_mesh().faces], ours.positions[ours.faces])


def test_3mf_textures_are_refused_by_that_name():
    textured = f'<texture2dgroup id="9" texid="8"/>{OBJECT}'.replace('pid="', 'pid="9')
    with pytest.raises(InputError, match="its colours are textures, which are not read in files"):
        opened(threemf(model(textured)), "x.3mf").painted()


def doubling(depth):
    parts = ""
    for number in range(2, depth):
        part = f'<component objectid="{number - 1}"/>'
        parts += f'<object id="{number}"><components>{part}{part}</components></object>'
    return model(OBJECT + parts, f'<item objectid="{depth - 1}"/>')


LAUGHS = '<!DOCTYPE model [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;">]>' + model(OBJECT)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"PK\x03\x04 junk", "the archive is damaged"),
        (threemf("no xml"), "is no XML"),
        (threemf(LAUGHS), "a document type is not allowed"),
        (threemf(model(OBJECT.replace('v1="0"', 'v1="zero"'))), "is damaged (invalid literal"),
        (threemf(model(OBJECT.replace('v1="0"', ""))), "is damaged ('v1')"),
        (threemf(model(OBJECT.replace('v3="2"', 'v3="4"'))), "none of the 4"),
        (threemf(model(OBJECT.replace('x="1.0"', 'x="inf"'))), "is not finite"),
        (threemf(model(OBJECT.replace("#FF0000", "#F00"))), "is no colour"),
        (threemf(model(OBJECT, '<item objectid="7"/>')), "there is no object '7'"),
        (threemf(model(OBJECT, '<item objectid="1" transform="1 2"/>')), "a transform has 2 numbers"),
        (
            threemf(model('<object id="1"><components><component objectid="1"/></components></object>')),
            "too many parts",
        ),
        (threemf(doubling(31)), "too many parts within parts"),
        (threemf(model(OBJECT, "")), "there are no polygons"),
        (threemf(model(OBJECT.replace("p1", "q1").replace("pindex", "q"), "")), "there are no polygons"),
    ],
)
def test_damaged_3mf_files_are_refused(data, message):
    with pytest.raises(InputError) as caught:
        opened(data, "x.3mf", 1 << 30).painted()
    assert message in str(caught.value)


@pytest.mark.slow
def test_3mf_files_that_unpack_to_much_are_refused():
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("3D/3dmodel.model", bytes(1 << 28))
    with pytest.raises(InputError, match="bytes, more than the"):
        opened(packed.getvalue(), "x.3mf", 1 << 30).painted()
