"""The tasks of the process with usd-core that write layers: with new values, or in another form.

New values are patched into the stored layer, so that all other bytes stay. The old ones are looked for by simple means;
the result is read again and compared with the intended layer, so that a value found in a wrong place is noticed. Where
the stored layer cannot be patched, usd-core exports the whole of it.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Sdf, UsdGeom, Vt

from beltrami_cli.arrays import Array, Float32s, Uint8s
from beltrami_cli.formats.files.edits import Spans, exchange_spans
from beltrami_cli.formats.usd.contents import ColourBlock, EditRequest
from beltrami_cli.formats.usd.stage import opened

_LAYER_NAME = "made"  # name of a layer that is written, without its suffix
Values = tuple[list[Array], list[str]]  # the colours of meshes, and names of images
Change = tuple[Array, Array]  # the colours of a mesh before and after

_COLOURS = re.compile(rb"primvars:displayColor\s*=\s*\[([^\]]*)\]")
_VECTOR = re.compile(rb"\([^()]*\)")


def edit(request: EditRequest, arrays: dict[str, Array]) -> tuple[dict[str, Any], dict[str, Array]]:
    """Return the root layer with new colours and images, in the form of a suffix, or in its own ("")."""
    stage = opened(request["root"], request["layers"], request["refused"])
    blocks = [ColourBlock(**block) for block in request["blocks"]]
    root, before = stage.GetRootLayer(), _stored(stage, blocks, request["files"])
    hides = [
        *(_recolour(stage, block, arrays["colours"][block.rows]) for block in blocks),
        *(_set(stage, path, Sdf.AssetPath(name)) for path, name in request["files"].items()),
    ]
    made, file = None, Path(request["root"])
    if not request["suffix"]:
        made = _patched(file, root, before, _stored(stage, blocks, request["files"]))
    suffix = request["suffix"] or file.suffix
    layer = _exported(root, suffix) if made is None else np.frombuffer(made, np.uint8)
    return {"hides": any(hides)}, {"layer": layer}


def _stored(stage: Any, blocks: Sequence[ColourBlock], files: Iterable[str]) -> Values:
    """Return the present colours of some blocks, and the images that some attributes name."""
    colours = [np.array(stage.GetAttributeAtPath(block.attribute).Get()) for block in blocks]
    return colours, [stage.GetAttributeAtPath(path).Get().path for path in files]


def _recolour(stage: Any, block: ColourBlock, colours: Float32s) -> bool:
    """Give a mesh new colours; indexed ones stay indexed where possible. Return the same as `_set`."""
    attribute = stage.GetAttributeAtPath(block.attribute)
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
    return _set(stage, block.attribute, kind.FromNumpy(np.ascontiguousarray(values.astype(dtype))))


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


def _patched(stored: Path, layer: Any, before: Values, after: Values) -> bytes | None:
    """Return a stored layer with new values, equal to `layer`; None if it cannot be patched."""
    pairs = zip(before[0], after[0], strict=True)
    colours = [(old, new) for old, new in pairs if not np.array_equal(old, new)]
    names = list(dict.fromkeys(zip(before[1], after[1], strict=True)))
    data = stored.read_bytes()
    if data.startswith(b"PXR-USDC"):
        made = None if names else _in_binary(data, colours)
    else:
        made = _in_text(data, colours, names)
    return made if made is not None and _are_equal(layer, made, stored.suffix) else None


def _in_binary(data: bytes, colours: Sequence[Change]) -> bytes | None:
    """Replace arrays of vectors, which USDC stores without compression."""
    whole = bytearray(data)
    for before, after in colours:
        old, new = before.tobytes(), after.tobytes()
        at = whole.find(old)
        if len(old) != len(new) or at < 0 or whole.find(old, at + 1) >= 0:
            return None
        whole[at : at + len(old)] = new
    return bytes(whole)


def _in_text(data: bytes, colours: Sequence[Change], names: Sequence[tuple[str, str]]) -> bytes | None:
    """Replace the vectors that changed, and asset paths (between @)."""
    stored = [(match.span(1), [*_VECTOR.finditer(match[1])]) for match in _COLOURS.finditer(data)]
    spans: Spans = {}
    for before, after in colours:
        fits = next((k for k, (_, each) in enumerate(stored) if len(each) == len(before) == len(after)), None)
        if fits is None:
            return None
        (start, _), vectors = stored.pop(fits)
        changed = np.flatnonzero((before != after).any(axis=1)).tolist()
        spans |= {(start + vectors[k].start(), start + vectors[k].end()): _spelled(after[k]) for k in changed}
    for old, new in names:
        pattern = re.compile(rb"(?<==)(\s*)@" + re.escape(old.encode()) + rb"@")
        spans |= {(match.end(1), match.end()): b"@%s@" % new.encode() for match in pattern.finditer(data)}
    return exchange_spans(data, spans)


def _spelled(colour: Array) -> bytes:
    """Return a colour as the shortest numbers that read back as the same."""
    return b"(" + b", ".join(str(value).encode() for value in colour.astype("U32").tolist()) + b")"


def _are_equal(layer: Any, data: bytes, suffix: str) -> bool:
    path = Path(f"patched{suffix}").absolute()
    path.write_bytes(data)
    made = Sdf.Layer.FindOrOpen(str(path))
    path.unlink()
    if made is None:
        return False
    paths, paths_made = list[Any](), list[Any]()
    layer.Traverse("/", paths.append)
    made.Traverse("/", paths_made.append)
    properties = [path for path in paths if path.IsPropertyPath()]
    return len(paths) == len(paths_made) and all(
        _value(layer, path) == _value(made, path) for path in properties
    )


def _value(layer: Any, path: Any) -> object:
    spec = layer.GetAttributeAtPath(path)
    return (spec.HasInfo("default"), spec.default) if spec else None


def _exported(layer: Any, suffix: str) -> Uint8s:
    """Return a layer as a file of the kind that a suffix says; for .usd, of the kind that it was."""
    path = Path(f"{_LAYER_NAME}{suffix}")
    arguments = {}
    if suffix == ".usd":
        text = Path(layer.realPath).read_bytes().startswith(b"#usda") if layer.realPath else False
        arguments = {"format": "usda" if text else "usdc"}
    if not layer.Export(str(path.absolute()), args=arguments):
        raise ValueError("the layer cannot be written")
    made = np.fromfile(path, np.uint8)
    path.unlink()
    return made


def convert(_: dict[str, Any], arrays: dict[str, Array]) -> tuple[dict[str, Any], dict[str, Array]]:
    """Return the text of a layer as USDC."""
    layer = Sdf.Layer.CreateAnonymous(".usda")
    if not layer.ImportFromString(arrays["text"].tobytes().decode()):
        raise ValueError("the text is not a layer")
    return {}, {"layer": _exported(layer, ".usdc")}
