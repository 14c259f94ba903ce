"""COLLADA files, read by pycollada: colours, materials, skins, archives, and damage."""

from __future__ import annotations

import io
import zipfile

import numpy as np
import pytest

from beltrami_cli.errors import InputError
from formats.read_only_files import FACES, SQUARE, opened

pytest.importorskip("collada", reason="pycollada is not installed: run the tests by `make test`")


def source(key, values, axes):
    params = "".join(f'<param name="{axis}" type="float"/>' for axis in axes)
    accessor = f'<accessor source="#{key}a" count="4" stride="3">{params}</accessor>'
    array = f'<float_array id="{key}a" count="12">{values}</float_array>'
    return f'<source id="{key}">{array}<technique_common>{accessor}</technique_common></source>'


DAE = "\n".join(
    [
        '<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">',
        '<asset><unit meter="1"/><up_axis>Y_UP</up_axis></asset><library_geometries><geometry id="g"><mesh>',
        source("p", "0 0 0 1 0 0 1 1 0 0 1 0", "XYZ"),
        source("c", "1 0 0 0 0.5 0 0 0 0.25 0.1 0.2 0.3", "RGB"),
        '<vertices id="v"><input semantic="POSITION" source="#p"/></vertices><triangles count="2">',
        '<input semantic="VERTEX" source="#v" offset="0"/><input semantic="COLOR" source="#c" offset="1"/>',
        "<p>0 0 1 1 2 2 0 0 2 2 3 3</p></triangles></mesh></geometry></library_geometries>",
        '<library_visual_scenes><visual_scene id="s"><node><translate>0 0 7</translate>',
        '<instance_geometry url="#g"/></node></visual_scene></library_visual_scenes>',
        '<scene><instance_visual_scene url="#s"/></scene></COLLADA>',
    ]
)


@pytest.mark.slow
def test_dae_colours_in_their_place():
    painted = opened(DAE.encode(), "x.dae").painted()
    np.testing.assert_array_equal(painted.positions[painted.faces], SQUARE[FACES] + [0, 0, 7])
    seen = {
        tuple(p[:2]): c for p, c in zip(painted.positions.tolist(), painted.colours.tolist(), strict=True)
    }
    np.testing.assert_allclose(seen[1, 0], [0, 0.5, 0])
    np.testing.assert_allclose(seen[0, 1], [0.1, 0.2, 0.3])
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        archive.writestr("model.dae", DAE)
    again = opened(packed.getvalue(), "x.zae").painted()
    np.testing.assert_array_equal(again.colours, painted.colours)
    with pytest.raises(InputError, match="document type"):
        opened(b"<!DOCTYPE COLLADA []>" + DAE.encode(), "x.dae").painted()
    with pytest.raises(InputError, match="it is damaged"):
        opened(DAE[:-1].encode(), "x.dae").painted()


MATERIAL = "".join(
    [
        '<library_effects><effect id="e"><profile_COMMON><technique sid="t"><lambert><diffuse>',
        "<color>1 1 1 1</color></diffuse></lambert></technique></profile_COMMON></effect></library_effects>",
        '<library_materials><material id="m"><instance_effect url="#e"/></material></library_materials>',
    ]
)
BOUND = (
    '<instance_geometry url="#g"><bind_material><technique_common><instance_material symbol="s" target="#m"/>'
    "</technique_common></bind_material></instance_geometry>"
)


def test_dae_colours_stay_beside_a_material_and_in_their_precision():
    text = DAE.replace("<library_geometries>", f"{MATERIAL}<library_geometries>")
    text = text.replace('<triangles count="2">', '<triangles count="2" material="s">')
    document = opened(text.replace('<instance_geometry url="#g"/>', BOUND).encode(), "x.dae")
    colours = document.painted().colours
    np.testing.assert_array_equal(
        np.sort(colours.ravel()), np.float32([0] * 6 + [0.1, 0.2, 0.25, 0.3, 0.5, 1])
    )
    assert "materials" in document.contents().left_out


def test_dae_textures_are_refused_by_that_name():
    image = '<library_images><image id="i"><init_from>a.png</init_from></image></library_images><library_geometries>'
    text = DAE.replace("<library_geometries>", image).replace(
        '<input semantic="COLOR" source="#c" offset="1"/>', ""
    )
    with pytest.raises(InputError, match="its colours are textures, which are not read in files"):
        opened(text.replace("0 0 1 1 2 2 0 0 2 2 3 3", "0 1 2 0 2 3").encode(), "x.dae").painted()


SKIN = "\n".join(
    [
        '<library_controllers><controller id="k"><skin source="#g">',
        "<bind_shape_matrix>1 0 0 0 0 1 0 0 0 0 1 3 0 0 0 1</bind_shape_matrix>",
        '<source id="j"><Name_array id="ja" count="1">Bone</Name_array><technique_common>',
        '<accessor source="#ja" count="1"><param name="JOINT" type="name"/></accessor></technique_common></source>',
        '<source id="b"><float_array id="ba" count="16">1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</float_array>',
        '<technique_common><accessor source="#ba" count="1" stride="16">',
        '<param name="TRANSFORM" type="float4x4"/></accessor></technique_common></source>',
        '<source id="w"><float_array id="wa" count="1">1</float_array><technique_common>',
        '<accessor source="#wa" count="1"><param name="WEIGHT" type="float"/></accessor></technique_common></source>',
        '<joints><input semantic="JOINT" source="#j"/><input semantic="INV_BIND_MATRIX" source="#b"/></joints>',
        '<vertex_weights count="4"><input semantic="JOINT" source="#j" offset="0"/>',
        '<input semantic="WEIGHT" source="#w" offset="1"/><vcount>1 1 1 1</vcount>',
        "<v>0 0 0 0 0 0 0 0</v></vertex_weights>",
        "</skin></controller></library_controllers>",
    ]
)


def test_dae_polygons_with_a_skin_are_where_they_were_bound():
    skinned = DAE.replace('<instance_geometry url="#g"/>', '<instance_controller url="#k"/>')
    skinned = skinned.replace("<library_visual_scenes>", f"{SKIN}<library_visual_scenes>")
    document = opened(skinned.encode(), "x.dae")
    painted = document.painted()
    np.testing.assert_array_equal(painted.positions[painted.faces], SQUARE[FACES] + [0, 0, 3])
    assert "skins" in document.contents().left_out


@pytest.mark.slow
def test_dae_polygons_that_cannot_be_read_are_mentioned():
    with pytest.raises(InputError, match="it is damaged, or not understood"):
        opened(DAE.replace("1 1 0 0 1 0<", "1,1 0 0 1 0<").encode(), "x.dae").painted()
    broken = '<node><instance_geometry url="#gone"/></node></visual_scene>'
    document = opened(DAE.replace("</visual_scene>", broken).encode(), "x.dae")
    assert len(document.painted().faces) == 2
    assert "what could not be read" in document.contents().left_out
