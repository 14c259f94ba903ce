"""The stage of a USD scene, composed of the layers that may be read, and the files that it refers to."""

from __future__ import annotations

import posixpath
from collections.abc import Sequence
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any

from pxr import Sdf, Usd

_OPEN: list[Any] = []  # references to layers, without which USD would close them and read them again


class NeedsLayersError(Exception):
    """Layers that the stage needs and that are not loaded yet, as (referring layer, path as written in it)."""

    def __init__(self, needs: list[tuple[str, str]]) -> None:
        super().__init__()
        self.needs = needs


def opened(root: str, layers: list[str], refused: Sequence[Sequence[str]]) -> Any:
    """Open the stage of a root layer in this folder, without refused layers; NeedsLayersError if others are missing."""
    needs: list[tuple[str, str]] = []
    here, left_out = Path.cwd(), {tuple(each) for each in refused}
    for name in layers:
        layer = Sdf.Layer.FindOrOpen(str(here / name))
        if layer is None:
            raise ValueError(f"{name} cannot be opened")
        _OPEN.append(layer)
        for path in layer.GetCompositionAssetDependencies():
            if not path or placed(name, path) in layers:  # references within the layer have no path
                continue
            if (name, path) not in left_out:
                needs.append((name, path))
            layer.UpdateCompositionAssetDependency(path, "")
        _without_clips(layer)
    if needs:
        raise NeedsLayersError(needs)
    stage = Usd.Stage.Open(Sdf.Layer.FindOrOpen(str(here / root)), None, Usd.Stage.LoadAll)
    if stage is None:
        raise ValueError("it cannot be composed")
    return stage


def _without_clips(layer: Any) -> None:
    """Remove value clips: files with values at other times than the first."""

    def take_out(path: Any) -> None:
        spec = layer.GetObjectAtPath(path)
        if path.IsPrimPath() and spec.HasInfo("clips"):
            spec.ClearInfo("clips")

    layer.Traverse("/", take_out)


def placed(layer: str, path: str) -> str:
    """Return a path in a layer relative to the folder of the root layer."""
    return posixpath.normpath(posixpath.join(posixpath.dirname(layer), path))


def files_of(prim: Any) -> dict[str, str]:
    """Return the files that a prim refers to, by attribute."""
    files = {}
    for attribute in prim.GetAuthoredAttributes():
        value: Any = attribute.Get() if attribute.GetTypeName() == "asset" else None
        if getattr(value, "path", ""):
            files[str(attribute.GetPath())] = placed(layer_of(attribute), value.path)
    return files


def files_in_variants(stage: Any, layers: list[str]) -> dict[str, str]:
    """Return the files that unselected variants refer to, by layer and path of the attribute."""
    prims = Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies())
    shown = {
        (spec.layer, spec.path)
        for prim in prims
        for attribute in prim.GetAuthoredAttributes()
        if attribute.GetTypeName() == "asset"
        for spec in attribute.GetPropertyStack()
    }
    files: dict[str, str] = {}

    def take(layer: Any, name: str, path: Any) -> None:
        is_shown = not path.ContainsPrimVariantSelection() or (layer, path) in shown
        spec = None if is_shown else layer.GetAttributeAtPath(path)
        value: Any = spec.default if spec and spec.HasInfo("default") else None
        if isinstance(value, Sdf.AssetPath) and value.path:
            where = "" if layer == stage.GetRootLayer() else name  # independent of the name of the root layer
            files[f"{where}{path}"] = placed(name, value.path)

    for name in layers:
        layer = Sdf.Layer.FindOrOpen(str(Path.cwd() / name))
        layer.Traverse("/", partial(take, layer, name))
    return files


def layer_of(attribute: Any) -> str:
    """Return the path of the layer that defines the value of an attribute, relative to this folder."""
    here = Path.cwd().resolve()
    for spec in attribute.GetPropertyStack():
        if spec.HasInfo("default"):
            return PurePosixPath(Path(spec.layer.realPath).resolve().relative_to(here)).as_posix()
    return ""
