"""The UsdPreviewSurface [1]_: its inputs, the slots of images that they make, and the material of other formats.

References
----------
.. [1] "UsdPreviewSurface specification", version 2.6. https://openusd.org/release/spec_usdpreviewsurface.html
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from beltrami_cli.formats.colours import display_colour, emission_and_strength, linear_colour
from beltrami_cli.surface.records import AlphaMode, Material, Slot

Values = Mapping[str, Any]
"""Numbers by input: a list of three for a colour."""


class SurfaceInput(NamedTuple):
    """An input that images have values for."""

    name: str
    type: str
    channel: str  # of the image

    @property
    def place(self) -> slice:
        """The channel among red, green and blue."""
        start = "rgb".index(self.channel[0])
        return slice(start, start + len(self.channel))


@dataclass(frozen=True)
class SurfaceSlot:
    """The inputs that one image is connected to, and how its pixels become their values."""

    inputs: tuple[SurfaceInput, ...]
    is_colour: bool  # whether pixels are stored as sRGB
    fixed_scale: int | None = None  # of pixels; None: any, it takes the place of the values of the inputs
    bias: int = 0  # added to scaled pixels

    def scale(self, values: Values) -> tuple[float, ...]:
        """Return the scale of red, green and blue that stands for values of the inputs."""
        if self.fixed_scale is not None:
            return (self.fixed_scale,) * 3
        scale = [1.0] * 3
        for each in self.inputs:
            value = values[each.name]
            scale[each.place] = value if isinstance(value, list) else [value]
        return tuple(scale)

    def values(self, scale: Sequence[float]) -> Values:
        """Return the values of the inputs that a scale stands for."""
        if self.fixed_scale is not None:
            return {}
        parts = {each.name: [*scale[each.place]] for each in self.inputs}
        return {name: part if len(part) > 1 else part[0] for name, part in parts.items()}


SURFACE_SLOTS: dict[Slot, SurfaceSlot] = {
    "baseColor": SurfaceSlot((SurfaceInput("diffuseColor", "color3f", "rgb"),), is_colour=True),
    "emissive": SurfaceSlot((SurfaceInput("emissiveColor", "color3f", "rgb"),), is_colour=True),
    "normal": SurfaceSlot(
        (SurfaceInput("normal", "normal3f", "rgb"),), is_colour=False, fixed_scale=2, bias=-1
    ),
    "occlusion": SurfaceSlot((SurfaceInput("occlusion", "float", "r"),), is_colour=False, fixed_scale=1),
    "metallicRoughness": SurfaceSlot(
        (SurfaceInput("roughness", "float", "g"), SurfaceInput("metallic", "float", "b")), is_colour=False
    ),
}
NUMBERS = {
    "diffuseColor": 3,
    "emissiveColor": 3,
    "metallic": 1,
    "roughness": 1,
    "opacity": 1,
    "opacityThreshold": 1,
}
"""How many numbers an input has without an image."""
NEUTRAL = {"useSpecularWorkflow": 0.0, "clearcoat": 0.0, "ior": 1.5, "displacement": 0.0}
"""Inputs that other formats lack, with the value by which they have no effect."""


@dataclass(frozen=True)
class MaterialInputs:
    """A material without its images."""

    name: str
    values: Values = field(default_factory=dict)
    has_alpha: bool = False  # whether the base colour image is the opacity, too
    lost: Sequence[str] = ()  # what other formats cannot hold
    is_unread: bool = False  # neither a UsdPreviewSurface nor a MaterialX surface with an image

    def material(self) -> Material:
        """Return the material of other formats; USD stores colours as linear light."""
        values = self.values
        opacity, cutoff = values.get("opacity", 1.0), values.get("opacityThreshold", 0.0)
        seen_through = self.has_alpha or opacity < 1
        alpha: AlphaMode = "mask" if seen_through and cutoff > 0 else "blend" if seen_through else "opaque"
        emission, strength = emission_and_strength(values.get("emissiveColor", [0.0] * 3))
        return Material(
            name=self.name,
            colour=display_colour(values.get("diffuseColor", [0.18] * 3)),
            emission=display_colour(emission),
            emission_strength=strength,
            opacity=opacity,
            metalness=values.get("metallic", 0.0),
            roughness=values.get("roughness", 0.5),
            alpha=alpha,
            cutoff=cutoff if alpha == "mask" else Material.cutoff,
        )


def input_values(material: Material) -> Values:
    """Return the values of the inputs for a material of another format."""
    emission = [material.emission_strength * channel for channel in linear_colour(material.emission)]
    values = {
        "diffuseColor": linear_colour(material.colour),
        "emissiveColor": emission,
        "roughness": material.roughness,
        "metallic": material.metalness,
        "opacity": material.opacity,
    }
    return values | ({"opacityThreshold": material.cutoff} if material.alpha == "mask" else {})
