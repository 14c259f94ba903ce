"""The materials of a glTF file, and the textures that they show in their slots."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Float64s
from beltrami_cli.formats.colours import display_colour, emission_and_strength
from beltrami_cli.formats.gltf.entries import Entry
from beltrami_cli.surface.records import AlphaMode, Material, Slot

SLOT_PATHS: dict[Slot, tuple[tuple[str, ...], ...]] = {
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

EMISSIVE_STRENGTH = "KHR_materials_emissive_strength"
_TRANSFORM = "KHR_texture_transform"
_VARIANTS = "KHR_materials_variants"
_MAX_VARIANTS = 1 << 16  # variants need only be distinct, and no file has as many
_ALPHA: dict[str, AlphaMode] = {"MASK": "mask", "BLEND": "blend"}


@dataclass(frozen=True)
class TextureUse:
    """A texture as one slot of one material uses it."""

    material: str  # name, for messages
    info: Entry  # the textureInfo
    texture: int
    coordinates: str  # the attribute with its texture coordinates, "TEXCOORD_0" or another
    transform: tuple[float, float, float, float, float, float]  # u' = a u + b v + c, v' = d u + e v + f
    alpha_hides: bool  # whether the material's alphaMode makes anything of opacity; OPAQUE does not

    def placed(self, uv: Float64s) -> Float64s:
        """Return texture coordinates, shape (n, 2), with the transform applied."""
        a, b, c, d, e, f = self.transform
        with np.errstate(over="ignore", invalid="ignore"):
            moved: Float64s = uv @ np.array([[a, d], [b, e]]) + np.array([c, f])
        if not np.isfinite(moved).all():
            raise self.info.fault("extensions", "its transform moves texture coordinates to infinity")
        return moved


def present_slots(root: Entry) -> tuple[Slot, ...]:
    """Return the slots for which some material has a texture, the base colour first."""
    materials = root.entries("materials")
    return tuple(slot for slot in SLOT_PATHS if any(_infos(material, slot) for material in materials))


def texture_uses(root: Entry, slot: Slot) -> list[list[TextureUse]]:
    """Return the images of each material in a slot: none, one, or several alternatives."""
    count = len(root.entries("textures"))
    uses: list[list[TextureUse]] = []
    for index, material in enumerate(root.entries("materials")):
        name = material.text("name") or f"material {index}"
        hides = material.text("alphaMode") in ("MASK", "BLEND")
        uses.append([])
        for info in _infos(material, slot):
            transform = info.entry("extensions").entry(_TRANSFORM)
            owner = transform if "texCoord" in transform else info
            texture = info.integer("index", below=count)
            coordinates = f"TEXCOORD_{owner.integer('texCoord', default=0)}"
            uses[-1].append(TextureUse(name, info, texture, coordinates, _affine(transform), hides))
    return uses


def looks(primitive: Entry, materials: Sequence[Sequence[TextureUse]]) -> list[tuple[int, TextureUse | None]]:
    """Return how a primitive can be shown, as (look, use); primitives show the same look at the same time."""
    # Look 0 is what viewers show by default; then an extension's material in place of the core one, and variants.
    default = _of_material(primitive, materials)
    shown: list[tuple[int, TextureUse | None]] = [(0, default[0] if default else None)]
    shown += [(1, use) for use in default[1:]]
    for mapping in primitive.entry("extensions").entry(_VARIANTS).entries("mappings"):
        chosen = _of_material(mapping, materials)[:1]
        variants = mapping.integers("variants", below=_MAX_VARIANTS)
        shown += [(2 + variant, use) for variant in variants for use in chosen]
    return shown


def _infos(material: Entry, slot: Slot) -> list[Entry]:
    """Return the textureInfos that a material has for a slot, that of core glTF first."""
    infos = []
    for *parents, last in SLOT_PATHS[slot]:
        holder = material
        for key in parents:
            holder = holder.entry(key)
        if last in holder:
            infos.append(holder.entry(last))
    return infos


def _of_material(holder: Entry, materials: Sequence[Sequence[TextureUse]]) -> Sequence[TextureUse]:
    return materials[holder.integer("material", below=len(materials))] if "material" in holder else ()


def _affine(transform: Entry) -> tuple[float, float, float, float, float, float]:
    """Return scale, then rotation, then offset."""
    # The rotation is counter-clockwise as seen in the image, where v points down; the specification's text and
    # examples mean that, though its GLSL turns the other way when read column by column.
    x, y = transform.numbers("offset", 2) or (0.0, 0.0)
    width, height = transform.numbers("scale", 2) or (1.0, 1.0)
    angle = transform.number("rotation", default=0.0)
    cosine, sine = float(np.cos(angle)), float(np.sin(angle))
    return cosine * width, sine * height, x, -sine * width, cosine * height, y


def read_material(entry: Entry) -> Material:
    """Return a material without its maps."""
    base = entry.entry("pbrMetallicRoughness")
    factor = base.numbers("baseColorFactor", 4) or [1.0] * 4
    alpha, cutoff = _ALPHA.get(entry.text("alphaMode") or "", "opaque"), Material.cutoff
    if alpha == "mask":
        given = entry.number("alphaCutoff", default=cutoff)
        alpha, cutoff = ("mask", given) if given > 0 else ("opaque", cutoff)  # at 0 all is seen
    factors = entry.numbers("emissiveFactor", 3) or [0.0] * 3
    times = entry.entry("extensions").entry(EMISSIVE_STRENGTH).number("emissiveStrength", default=1.0)
    emission, strength = emission_and_strength([times * each for each in factors])
    return Material(
        name=entry.text("name") or "",
        colour=display_colour(factor[:3]),
        emission=display_colour(emission),
        emission_strength=strength,
        opacity=1.0 if alpha == "opaque" else factor[3],
        metalness=base.number("metallicFactor", default=1.0),
        roughness=base.number("roughnessFactor", default=1.0),
        alpha=alpha,
        cutoff=cutoff,
    )
