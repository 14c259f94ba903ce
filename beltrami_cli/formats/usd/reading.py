"""The tasks of the process with usd-core that read a scene: its meshes, materials and colours, or its text."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from pxr import Sdf, Usd, UsdGeom

from beltrami_cli.arrays import Array
from beltrami_cli.formats.usd.contents import Count, SceneContents, SceneRequest, TextRequest, TextureUse
from beltrami_cli.formats.usd.geometry import Geometry
from beltrami_cli.formats.usd.stage import NeedsLayersError, files_in_variants, files_of, opened
from beltrami_cli.surface.worker_process import Message


def read(request: SceneRequest, _: dict[str, Array]) -> Message:
    """Return the `SceneContents` and arrays of a scene, or the layers that it needs as well."""
    try:
        stage = opened(request["root"], request["layers"], request["refused"])
    except NeedsLayersError as error:
        return {"needs": error.needs}, {}
    geometry, others = Geometry(), set[str]()
    images = files_in_variants(stage, request["layers"])
    for prim in Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()):
        if prim.IsA(UsdGeom.Mesh):
            geometry.take(prim)
            continue
        images |= files_of(prim)
        if prim.IsA(UsdGeom.Gprim):
            others.add(str(prim.GetTypeName()))
            colours = UsdGeom.Gprim(prim).GetDisplayColorAttr().Get(Usd.TimeCode.EarliestTime())
            geometry.counts["no mesh"] += int(colours is not None and len(colours) > 1)
    return _contents(stage, geometry, images, others).to_message()


def _contents(
    stage: Any, geometry: Geometry, images: Mapping[str, str], others: Iterable[str]
) -> SceneContents:
    """Return the contents of a scene; `images`: files that no mesh shows, by attribute."""
    uses = tuple(
        TextureUse(material, slot, shown.attribute, shown.file, shown.wrap)
        for material, by_slot in enumerate(geometry.materials.images)
        for slot, shown in by_slot.items()
    )
    materials = tuple(geometry.materials.inputs)
    counts: dict[Count, int] = {**geometry.counts, "unread": sum(each.is_unread for each in materials)}
    return SceneContents(
        uses=uses,
        images={use.attribute: use.file for use in uses} | dict(images),
        materials=materials,
        blocks=tuple(geometry.blocks),
        meshes=tuple(geometry.meshes),
        counts=counts,
        slots=tuple(sorted(geometry.slots)),
        others=tuple(sorted(others)),
        up=str(UsdGeom.GetStageUpAxis(stage)),
        # `UsdGeom.GetStageMetersPerUnit` refuses single precision, as old exporters wrote it.
        unit=float(stage.GetMetadata("metersPerUnit")),
        variants=tuple(
            f"{prim.GetPath()}{{{name}={sets.GetVariantSelection(name)}}}"
            for prim in stage.Traverse()
            for sets in [prim.GetVariantSets()]
            for name in sets.GetNames()
        ),
        arrays=geometry.joined(),
    )


def text(request: TextRequest, _: dict[str, Array]) -> Message:
    """Return the text of the root layer without the values of some attributes: colours, and names of images."""
    stage = opened(request["root"], request["layers"], request["refused"])
    bare = Sdf.Layer.CreateAnonymous(".usda")
    bare.TransferContent(stage.GetRootLayer())
    paths = [*request["images"], *request["colours"]]
    for path in request["colours"]:
        primvar = UsdGeom.Primvar(stage.GetAttributeAtPath(path))
        paths += [str(primvar.GetIndicesAttr().GetPath())] if primvar.IsIndexed() else []
    for path in dict.fromkeys(paths):
        for spec in stage.GetAttributeAtPath(path).GetPropertyStack():
            # Several instances have the same one.
            if spec.layer == stage.GetRootLayer() and (copied := bare.GetPropertyAtPath(spec.path)):
                copied.ClearInfo("default")
                if copied.owner.specifier == Sdf.SpecifierOver:
                    copied.owner.RemoveProperty(copied)
    bare.RemoveInertSceneDescription()  # overrides that hold nothing else
    # Damaged layers may hold strings that are not UTF-8, which `ExportToString` refuses.
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "layer.usda")
        bare.Export(str(file))
        return file.read_text("utf-8", errors="backslashreplace"), {}
