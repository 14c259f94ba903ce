"""Tasks of the process with usd-core: a scene as arrays, layers with new values.

New values are put into a stored layer where the old ones stand, so that every other byte stays. The result is read
again and compared with the intended layer: where anything else differs, it is dropped, and usd-core exports the whole
layer. So values may be looked for by simple means.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Sdf, Usd, UsdGeom, Vt

from beltrami_cli.arrays import Array, Float32s, Uint8s
from beltrami_cli.formats.tokens import Spans, exchange_spans
from beltrami_cli.formats.usd.scene import NeedsLayersError, Scene, files_in_variants, files_of, opened

Change = tuple[Array, Array]  # the values of an attribute before and after

Arrays = dict[str, "NDArray[Any]"]
_MADE = "made"  # name of a layer that is written, without its suffix
_COLOURS = re.compile(rb"primvars:displayColor\s*=\s*\[([^\]]*)\]")
_VECTOR = re.compile(rb"\([^()]*\)")


def read(order: dict[str, Any], _: Arrays) -> tuple[dict[str, Any], Arrays]:
    """Return a scene, or which layers it needs as well."""
    try:
        stage = opened(order["root"], order["layers"], order["refused"])
    except NeedsLayersError as error:
        return {"needs": error.needs}, {}
    scene = Scene()
    others: set[str] = set()
    images = files_in_variants(stage, order["layers"])
    for prim in Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()):
        if prim.IsA(UsdGeom.Mesh):
            scene.take(prim)
            continue
        images |= files_of(prim)
        if prim.IsA(UsdGeom.Gprim):
            others.add(str(prim.GetTypeName()))
            colours = UsdGeom.Gprim(prim).GetDisplayColorAttr().Get(Usd.TimeCode.EarliestTime())
            scene.counts["no mesh"] += int(colours is not None and len(colours) > 1)
    shown = enumerate(scene.uses)
    uses = [{**use, "material": n, "slot": slot} for n, each in shown for slot, use in each.items()]
    words = {
        "uses": uses,
        "images": {use["attribute"]: use["file"] for use in uses} | images,
        "materials": scene.materials,
        "blocks": scene.blocks,
        "meshes": scene.meshes,
        "counts": dict(scene.counts),
        "slots": sorted(scene.slots),
        "others": sorted(others),
        "up": str(UsdGeom.GetStageUpAxis(stage)),
        # `UsdGeom.GetStageMetersPerUnit` refuses single precision, as old exporters wrote it.
        "unit": float(stage.GetMetadata("metersPerUnit")),
        "variants": [
            f"{prim.GetPath()}{{{name}={sets.GetVariantSelection(name)}}}"
            for prim in stage.Traverse()
            for sets in [prim.GetVariantSets()]
            for name in sets.GetNames()
        ],
    }
    if order.get("text"):
        words["text"] = _without_colours(stage, words)
    return words, scene.joined()


def edit(order: dict[str, Any], arrays: Arrays) -> tuple[dict[str, Any], Arrays]:
    """Return the root layer with other colours and images, in the same form or as `suffix` says."""
    stage = opened(order["root"], order["layers"], order["refused"])
    root = stage.GetRootLayer()
    before = _stored(stage, order)
    hides = False
    for block in order["blocks"]:
        colours = arrays["colours"][block["first"] : block["first"] + block["count"]]
        hides = _recolour(stage, block, colours) or hides
    for path, name in order["files"].items():
        hides = _set(stage, path, Sdf.AssetPath(name)) or hides
    if order["same"]:
        (old_colours, old_names), (new_colours, new_names) = before, _stored(stage, order)
        both = zip(old_colours, new_colours, strict=True)
        changes = [(old, new) for old, new in both if not np.array_equal(old, new)]
        names = list(dict.fromkeys(zip(old_names, new_names, strict=True)))
        patched = _in_place(Path(order["root"]), root, changes, names)
        if patched is not None:
            return {"hides": hides}, {"layer": np.frombuffer(patched, np.uint8)}
    return {"hides": hides}, {"layer": _exported(root, order["suffix"])}


def _stored(stage: Any, order: dict[str, Any]) -> tuple[list[Array], list[str]]:
    colours = [np.array(stage.GetAttributeAtPath(block["attribute"]).Get()) for block in order["blocks"]]
    return colours, [stage.GetAttributeAtPath(path).Get().path for path in order["files"]]


def _recolour(stage: Any, block: dict[str, Any], colours: Float32s) -> bool:
    """Give a mesh other colours; indexed ones stay indexed where possible. Return the same as `_set`."""
    attribute = stage.GetAttributeAtPath(block["attribute"])
    primvar = UsdGeom.Primvar(attribute)
    old = np.array(primvar.ComputeFlattened(), np.float64)
    if np.array_equal(old.astype(np.float32), colours):
        return False
    kind = type(attribute.Get())
    if primvar.IsIndexed():
        indices = np.array(primvar.GetIndices(), np.int64)
        values = np.array(attribute.Get(), np.float64).astype(np.float32)
        values[indices] = colours
        if not np.array_equal(values[indices], colours):
            values, indices = np.unique(colours, axis=0, return_inverse=True)
            _set(stage, primvar.GetIndicesAttr().GetPath(), Vt.IntArray.FromNumpy(indices.astype(np.int32)))
    else:
        values = colours
    dtype = np.array(attribute.Get()).dtype
    return _set(stage, block["attribute"], kind.FromNumpy(np.ascontiguousarray(values.astype(dtype))))


def _set(stage: Any, path: str, value: object) -> bool:
    """Set a value in the root layer: where it stands there, or in an opinion of its own that is stronger.

    Return whether that opinion hides values in variants of other layers.
    """
    root, attribute, hides = stage.GetRootLayer(), stage.GetAttributeAtPath(path), False
    for spec in attribute.GetPropertyStack():
        if spec.HasInfo("default"):
            if spec.layer == root:
                spec.default = value
                return False
            hides = spec.path.ContainsPrimVariantSelection()
            break
    if attribute.GetPrim().IsInstanceProxy():
        raise ValueError(f"{path} is of an instance whose colours are in another layer, which stays as it is")
    stage.SetEditTarget(root)
    if not attribute.Set(value):
        raise ValueError(f"{path} cannot be set")
    return hides


def _exported(layer: Any, suffix: str) -> Uint8s:
    """Return a layer as a file of the kind that a suffix says; for .usd, of the kind that it was."""
    path = Path(f"{_MADE}{suffix}")
    arguments = {}
    if suffix == ".usd":
        text = Path(layer.realPath).read_bytes().startswith(b"#usda") if layer.realPath else False
        arguments = {"format": "usda" if text else "usdc"}
    if not layer.Export(str(path.absolute()), args=arguments):
        raise ValueError("the layer cannot be written")
    made = np.fromfile(path, np.uint8)
    path.unlink()
    return made


def _without_colours(stage: Any, words: dict[str, Any]) -> str:
    """Return the text of the root layer without colours and names of images."""
    bare = Sdf.Layer.CreateAnonymous(".usda")
    bare.TransferContent(stage.GetRootLayer())
    paths = [use["attribute"] for use in words["uses"]]
    for block in words["blocks"]:
        primvar = UsdGeom.Primvar(stage.GetAttributeAtPath(block["attribute"]))
        indices = [str(primvar.GetIndicesAttr().GetPath())] if primvar.IsIndexed() else []
        paths += [block["attribute"], *indices]
    for path in dict.fromkeys(paths):
        for spec in stage.GetAttributeAtPath(path).GetPropertyStack():
            # Several instances have the same one.
            if spec.layer == stage.GetRootLayer() and (own := bare.GetPropertyAtPath(spec.path)):
                own.ClearInfo("default")
                if own.owner.specifier == Sdf.SpecifierOver:
                    own.owner.RemoveProperty(own)
    bare.RemoveInertSceneDescription()  # overrides that hold nothing else
    # Damaged layers may hold strings that are not UTF-8, which `ExportToString` refuses.
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "layer.usda")
        bare.Export(str(file))
        return file.read_text("utf-8", errors="backslashreplace")


def convert(order: dict[str, Any], arrays: Arrays) -> tuple[dict[str, Any], Arrays]:
    """Return the text of a layer in the form that a suffix says."""
    layer = Sdf.Layer.CreateAnonymous(".usda")
    if not layer.ImportFromString(arrays["text"].tobytes().decode()):
        raise ValueError("the text is no layer")
    return {}, {"layer": _exported(layer, order["suffix"])}


def _in_place(
    stored: Path, layer: Any, colours: Sequence[Change], names: Sequence[tuple[str, str]]
) -> bytes | None:
    """Return a stored layer with other colours and names of images, equal to `layer`; None if that cannot be."""
    data = stored.read_bytes()
    if data.startswith(b"PXR-USDC"):
        made = None if names else _in_binary(data, colours)
    else:
        made = _in_text(data, colours, names)
    return made if made is not None and _are_equal(layer, made, stored.suffix) else None


def _in_binary(data: bytes, colours: Sequence[Change]) -> bytes | None:
    """Exchange arrays, which are stored as they are if they are of vectors."""
    whole = bytearray(data)
    for before, after in colours:
        old, new = before.tobytes(), after.tobytes()
        at = whole.find(old)
        if len(old) != len(new) or at < 0 or whole.find(old, at + 1) >= 0:
            return None
        whole[at : at + len(old)] = new
    return bytes(whole)


def _in_text(data: bytes, colours: Sequence[Change], names: Sequence[tuple[str, str]]) -> bytes | None:
    """Exchange the vectors that changed, and names between @."""
    found = [(match.span(1), [*_VECTOR.finditer(match[1])]) for match in _COLOURS.finditer(data)]
    spans: Spans = {}
    for before, after in colours:
        fits = next((k for k, (_, each) in enumerate(found) if len(each) == len(before) == len(after)), None)
        if fits is None:
            return None
        (start, _), vectors = found.pop(fits)
        changed = np.flatnonzero((before != after).any(axis=1)).tolist()
        spans |= {(start + vectors[k].start(), start + vectors[k].end()): _spelled(after[k]) for k in changed}
    for old, new in names:
        pattern = re.compile(rb"(?<==)(\s*)@" + re.escape(old.encode()) + rb"@")
        spans |= {(match.end(1), match.end()): b"@%s@" % new.encode() for match in pattern.finditer(data)}
    return exchange_spans(data, spans)


def _spelled(colour: Array) -> bytes:
    """Return the shortest numbers that are read back the same."""
    return b"(" + b", ".join(str(value).encode() for value in colour.astype("U32").tolist()) + b")"


def _are_equal(layer: Any, data: bytes, suffix: str) -> bool:
    path = Path(f"patched{suffix}").absolute()
    path.write_bytes(data)
    made = Sdf.Layer.FindOrOpen(str(path))
    path.unlink()
    if made is None:
        return False
    paths, others = list[Any](), list[Any]()
    layer.Traverse("/", paths.append)
    made.Traverse("/", others.append)
    properties = [path for path in paths if path.IsPropertyPath()]
    return len(paths) == len(others) and all(_value(layer, path) == _value(made, path) for path in properties)


def _value(layer: Any, path: Any) -> object:
    spec = layer.GetAttributeAtPath(path)
    return (spec.HasInfo("default"), spec.default) if spec else None
