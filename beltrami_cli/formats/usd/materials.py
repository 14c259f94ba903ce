"""Materials of USD scenes: the numbers and images of a UsdPreviewSurface, and the images of a MaterialX surface."""

from __future__ import annotations

from typing import Any

import numpy as np
from pxr import UsdShade

from beltrami_cli.arrays import Int64s
from beltrami_cli.formats.usd.preview_surface import NEUTRAL, NUMBERS, SURFACE_SLOTS, MaterialInputs
from beltrami_cli.formats.usd.shown_images import ShownImage, SlotImages, image_at, numbers_of, sources_of
from beltrami_cli.surface.records import Slot

# The colour inputs of MaterialX surfaces; an image may be connected to each.
_MTLX: dict[str, dict[Slot, str]] = {
    "ND_standard_surface_surfaceshader": {"baseColor": "base_color", "emissive": "emission_color"},
    "ND_open_pbr_surface_surfaceshader": {"baseColor": "base_color", "emissive": "emission_color"},
    "ND_gltf_pbr_surfaceshader": {"baseColor": "base_color", "emissive": "emissive"},
    "ND_UsdPreviewSurface_surfaceshader": {"baseColor": "diffuseColor", "emissive": "emissiveColor"},
}
_UNFIT = " laid out otherwise than in glTF"


class Materials:
    """The materials of a scene, numbered as meshes show them."""

    def __init__(self) -> None:
        self.inputs: list[MaterialInputs] = []
        self.images: list[SlotImages] = []
        self._number_of: dict[str, int] = {}  # by path

    def of_polygons(self, prim: Any, count: int) -> Int64s:
        """Return the numbers of the materials of a mesh's polygons, which may be bound to subsets of them; -1: none."""
        binding = UsdShade.MaterialBindingAPI(prim)
        numbers = np.full(count, self._number(binding.ComputeBoundMaterial()[0]))
        for subset in binding.GetMaterialBindSubsets():
            bound = UsdShade.MaterialBindingAPI(subset.GetPrim()).ComputeBoundMaterial()[0]
            chosen = np.array(subset.GetIndicesAttr().Get() or [], np.int64)
            numbers[chosen[(chosen >= 0) & (chosen < count)]] = self._number(bound)
        return numbers

    def _number(self, material: Any) -> int:
        if not material:
            return -1
        path = str(material.GetPath())
        if path not in self._number_of:
            self._number_of[path] = len(self.inputs)
            inputs, images = _read_material(material)
            self.inputs.append(inputs)
            self.images.append(images)
        return self._number_of[path]


def _read_material(material: Any) -> tuple[MaterialInputs, SlotImages]:
    """Return the inputs of a material, and the image that it shows in each slot."""
    prim, surface = material.GetPrim(), material.ComputeSurfaceSource()[0]
    if surface and surface.GetIdAttr().Get() == "UsdPreviewSurface":
        return _read_preview_surface(surface, prim.GetName())
    images = _of_materialx(material)
    is_unread = not images and bool(prim.GetChildren())
    return MaterialInputs(prim.GetName(), _factors(images), is_unread=is_unread), images


def _read_preview_surface(surface: Any, name: str) -> tuple[MaterialInputs, SlotImages]:
    images, lost = _of_preview_surface(surface)
    values, has_alpha = _numbers(surface) | _factors(images), False
    opacity, base = image_at(surface, "opacity"), images.get("baseColor")
    if opacity is not None:
        has_alpha = opacity.output == "a" and base is not None and opacity.is_at(base)
        lost += [] if has_alpha else [f"opacity maps{_UNFIT}"]
        values |= {"opacity": opacity.factors[3]} if has_alpha else {}
    lost += [
        f"the scale or bias of {slot} maps"
        for slot, shown in images.items()
        if not _is_expressible(slot, shown)
    ]
    lost += [each for each, neutral in NEUTRAL.items() if _has_effect(surface, each, neutral)]
    return MaterialInputs(name, values, has_alpha, lost), images


def _of_preview_surface(surface: Any) -> tuple[SlotImages, list[str]]:
    """Return the images of a surface by slot, and those that are lost, in words."""
    images, lost = dict[Slot, ShownImage](), list[str]()
    for slot, described in SURFACE_SLOTS.items():
        wanted = described.inputs
        found = [(shown, each) for each in wanted if (shown := image_at(surface, each.name)) is not None]
        is_one = len(found) == len(wanted) and len({shown.shader for shown, _ in found}) == 1
        if is_one and all(each.type != "float" or shown.output == each.channel for shown, each in found):
            images[slot] = found[0][0]
        elif found:
            lost.append(f"{slot} maps{_UNFIT}")
    return images, lost


def _numbers(surface: Any) -> dict[str, Any]:
    """Return the values of the inputs that are numbers."""
    values: dict[str, Any] = {}
    for name, count in NUMBERS.items():
        numbers = numbers_of(surface, name)
        if len(numbers) == count:
            values[name] = numbers if count > 1 else numbers[0]
    return values


def _is_expressible(slot: Slot, shown: ShownImage) -> bool:
    """Whether a `Material` can express the scale and bias of an image."""
    if shown.scale is None or shown.bias is None:
        return False
    described = SURFACE_SLOTS[slot]
    is_scale_fit = described.fixed_scale is None or {*shown.scale[:3]} == {described.fixed_scale}
    return is_scale_fit and {*shown.bias[:3]} == {described.bias}


def _has_effect(surface: Any, name: str, neutral: float) -> bool:
    return bool(sources_of(surface, name)) and numbers_of(surface, name) != [neutral]


def _factors(images: SlotImages) -> dict[str, Any]:
    """Return the scales of images as values of the inputs that the images replace."""
    factors: dict[str, Any] = {}
    for slot, shown in images.items():
        factors |= SURFACE_SLOTS[slot].values(shown.factors)
    return factors


def _of_materialx(material: Any) -> SlotImages:
    """Return the colour images of a MaterialX surface, by slot."""
    surface = material.ComputeSurfaceSource("mtlx")[0]
    inputs = _MTLX.get(str(surface.GetIdAttr().Get()), {}) if surface else {}
    shown_in = {slot: image_at(surface, name) for slot, name in inputs.items()}
    return {slot: shown for slot, shown in shown_in.items() if shown is not None}
