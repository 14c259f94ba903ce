"""Which textures the slots of materials name, and how each is laid on the surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, get_args

import numpy as np

from beltrami_cli.surface.records import Slot

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from beltrami_cli.formats.gltf.tree import Entry

SLOTS: tuple[Slot, ...] = get_args(Slot)
"""All slots, the base colour first."""

PATHS: dict[Slot, tuple[tuple[str, ...], ...]] = {
    "baseColor": (
        ("pbrMetallicRoughness", "baseColorTexture"),
        ("extensions", "KHR_materials_pbrSpecularGlossiness", "diffuseTexture"),
    ),
    "emissive": (("emissiveTexture",),),
    "normal": (("normalTexture",),),
    "occlusion": (("occlusionTexture",),),
    "metallicRoughness": (("pbrMetallicRoughness", "metallicRoughnessTexture"),),
}
"""Where a material holds the textureInfos of a slot; where there are several, a viewer shows one or the other."""

_TRANSFORM = "KHR_texture_transform"
_VARIANTS = "KHR_materials_variants"
_MOST_VARIANTS = 1 << 16


@dataclass(frozen=True)
class Painting:
    """A texture as one slot of one material uses it.

    Attributes
    ----------
    material : str
        The material's name, for messages.
    info : Entry
        The textureInfo.
    texture : int
        Index of the texture.
    coordinates : str
        The attribute with its texture coordinates, "TEXCOORD_0" or another.
    transform : tuple of float
        The rows (a, b, c) and (d, e, f) of u' = a u + b v + c, v' = d u + e v + f.
    alpha_hides : bool
        Whether the material's alphaMode makes anything of opacity; the default, OPAQUE, does not.
    """

    material: str
    info: Entry
    texture: int
    coordinates: str
    transform: tuple[float, float, float, float, float, float]
    alpha_hides: bool

    def placed(self, uv: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return texture coordinates, shape (n, 2), with the transform applied; overflow gives infinity."""
        a, b, c, d, e, f = self.transform
        with np.errstate(over="ignore", invalid="ignore"):
            moved: NDArray[np.float64] = uv @ np.array([[a, d], [b, e]]) + np.array([c, f])
        return moved


def infos(material: Entry, slot: Slot) -> list[Entry]:
    """Return the textureInfos that a material has for a slot, that of core glTF first."""
    found = []
    for *parents, last in PATHS[slot]:
        holder = material
        for key in parents:
            holder = holder.entry(key)
        if last in holder:
            found.append(holder.entry(last))
    return found


def present_slots(root: Entry) -> tuple[Slot, ...]:
    """Return the slots for which some material has a texture."""
    materials = root.entries("materials")
    return tuple(slot for slot in SLOTS if any(infos(material, slot) for material in materials))


def paintings(root: Entry, slot: Slot) -> list[list[Painting]]:
    """Return what each material has in a slot: none, one, or several of which a viewer shows one.

    Raises
    ------
    InputError
        If a texture does not exist, or its transform is not made of finite numbers.
    """
    count = len(root.entries("textures"))
    found: list[list[Painting]] = []
    for index, material in enumerate(root.entries("materials")):
        name = material.text("name") or f"material {index}"
        hides = material.text("alphaMode") in ("MASK", "BLEND")
        found.append([_painting(name, info, count, hides) for info in infos(material, slot)])
    return found


def looks(primitive: Entry, palette: Sequence[Sequence[Painting]]) -> list[tuple[int, Painting | None]]:
    """Return what a primitive can be painted with.

    Parameters
    ----------
    primitive : Entry
        The primitive.
    palette : sequence of sequence of Painting
        What each material has.

    Returns
    -------
    list of (int, Painting or None)
        First look 0, which viewers show by default, then others, of which primitives with the same number are shown
        together: an extension's material in place of the core one, and variants of materials.

    Raises
    ------
    InputError
        If a material does not exist.
    """
    default = _palette(primitive, palette)
    found: list[tuple[int, Painting | None]] = [(0, default[0] if default else None)]
    found += [(1, painting) for painting in default[1:]]
    for mapping in primitive.entry("extensions").entry(_VARIANTS).entries("mappings"):
        chosen = _palette(mapping, palette)[:1]
        variants = mapping.integers("variants", below=_MOST_VARIANTS)
        found += [(2 + variant, painting) for variant in variants for painting in chosen]
    return found


def _palette(holder: Entry, palette: Sequence[Sequence[Painting]]) -> Sequence[Painting]:
    return palette[holder.integer("material", below=len(palette))] if "material" in holder else ()


def _painting(name: str, info: Entry, count: int, alpha_hides: bool) -> Painting:
    transform = info.entry("extensions").entry(_TRANSFORM)
    owner = transform if "texCoord" in transform else info
    return Painting(
        material=name,
        info=info,
        texture=info.integer("index", below=count),
        coordinates=f"TEXCOORD_{owner.integer('texCoord', default=0)}",
        transform=_affine(transform),
        alpha_hides=alpha_hides,
    )


def _affine(transform: Entry) -> tuple[float, float, float, float, float, float]:
    """Return scale, then rotation, then offset.

    The rotation is counter-clockwise as seen in the image, where v points down; the specification's text and
    examples mean that, though its GLSL turns the other way when read column by column.
    """
    x, y = transform.numbers("offset", 2) or (0.0, 0.0)
    width, height = transform.numbers("scale", 2) or (1.0, 1.0)
    angle = transform.number("rotation", default=0.0)
    cosine, sine = float(np.cos(angle)), float(np.sin(angle))
    return cosine * width, sine * height, x, -sine * width, cosine * height, y
