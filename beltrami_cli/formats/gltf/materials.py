"""Which textures the slots of materials name, and how each is laid on the surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, get_args

import numpy as np

from beltrami_cli.mesh.textured import Slot

if TYPE_CHECKING:
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
"""Where a material holds the textureInfos of a slot; the first that is there is the one that is smoothed on."""

_TRANSFORM = "KHR_texture_transform"


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
    """Return the textureInfos that a material has for a slot, the one that counts first."""
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


def paintings(root: Entry, slot: Slot) -> list[Painting | None]:
    """Return what each material has in a slot.

    Raises
    ------
    InputError
        If a texture does not exist, or its transform is not made of finite numbers.
    """
    count = len(root.entries("textures"))
    found: list[Painting | None] = []
    for index, material in enumerate(root.entries("materials")):
        info = next(iter(infos(material, slot)), None)
        name = material.text("name") or f"material {index}"
        hides = material.text("alphaMode") in ("MASK", "BLEND")
        found.append(None if info is None else _painting(name, info, count, hides))
    return found


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
