"""The images and textures of a glTF file, and which of them the slots of materials use in which way."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any

import numpy as np

from beltrami_cli.arrays import Float64s
from beltrami_cli.formats.gltf.accessors import Accessors
from beltrami_cli.formats.gltf.buffers import file_key, is_data, read, relative_name
from beltrami_cli.formats.gltf.container import Entry, Tree
from beltrami_cli.formats.image import format_of, label_of
from beltrami_cli.formats.image.extra_codecs import EXTRA_CODECS, INSTALL, missing_package
from beltrami_cli.formats.image.picture import FORMATS
from beltrami_cli.formats.model_folder import ModelFolder, UnfitReferenceError
from beltrami_cli.surface.records import Slot, Wrap

WEBP = "EXT_texture_webp"
IMAGE_EXTENSIONS = {
    WEBP: "image/webp",
    "KHR_texture_basisu": "image/ktx2",
    "EXT_texture_avif": "image/avif",
    "MSFT_texture_dds": "image/vnd-ms.dds",
}
"""Extensions of textures that name an image of another type than core glTF has."""

UNREAD = ("MSFT_texture_dds",)  # whose images are not read
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

WRAPS: dict[Wrap, int] = {"repeat": 10497, "mirror": 33648, "clamp": 33071}
"""The numbers by which samplers say what lies beyond an image."""

_HELD = ("png", "jpeg", "webp", "ktx2", "avif")
MEDIA = {suffix: f"image/{known}" for known in _HELD for suffix in FORMATS[known].suffixes}
"""Media types of the images that glTF can hold, by suffix."""

_KINDS = {number: kind for kind, number in WRAPS.items()}
_TRANSFORM = "KHR_texture_transform"
_VARIANTS = "KHR_materials_variants"
_MOST_VARIANTS = 1 << 16


class Images:
    """All images and textures of one file; bytes are read when they are asked for."""

    def __init__(self, root: Entry, accessors: Accessors, folder: ModelFolder) -> None:
        self._accessors, self._folder = accessors, folder
        self.entries = root.entries("images")
        self.textures = root.entries("textures")
        self._samplers = root.entries("samplers")
        self._loaded: dict[int, bytes] = {}
        first: dict[Hashable, int] = {}
        self._canonical = [first.setdefault(self._key(index), index) for index in range(len(self))]

    def __len__(self) -> int:
        return len(self.entries)

    def _key(self, index: int) -> Hashable:
        image = self.entries[index]
        if "bufferView" in image:
            return "view", image.integer("bufferView", below=len(self._accessors.views))
        return file_key(image.text("uri"), index, self._folder)

    def canonical(self, index: int) -> int:
        """Return the first image over the same bytes as this one, usually itself."""
        return self._canonical[index]

    def same(self, canonical: int) -> tuple[int, ...]:
        """Return all images over the same bytes, by the first of them."""
        return tuple(index for index in range(len(self)) if self._canonical[index] == canonical)

    def name(self, index: int) -> str:
        """Return what people know an image by: its file, or its own name."""
        image, uri = self.entries[index], self.entries[index].text("uri")
        if uri is not None and not is_data(uri):
            try:
                return PurePosixPath(relative_name(uri, self._folder, outside=True)).name
            except UnfitReferenceError:
                return uri
        return image.text("name") or f"image {index}"

    def shown(self, texture: int) -> int:
        """Return the image that a texture shows; UnfitReferenceError if there is none that is read."""
        # WebP comes before plain images; a plain one is the better source where the other loses more.
        entry = self.textures[texture]
        extensions = entry.entry("extensions")
        readable = [name for name in IMAGE_EXTENSIONS if name not in (WEBP, *UNREAD)]
        for holder in (extensions.entry(WEBP), entry, *map(extensions.entry, readable)):
            if "source" in holder:
                return holder.integer("source", below=len(self))
        for extension in UNREAD:
            if extension in extensions:
                raise UnfitReferenceError(f"is a {kind_of(extension)} image ({extension}), which is not read")
        raise UnfitReferenceError("has no image")

    def wrap(self, texture: int) -> tuple[Wrap, Wrap]:
        entry = self.textures[texture]
        if "sampler" not in entry:
            return "repeat", "repeat"
        sampler = self._samplers[entry.integer("sampler", below=len(self._samplers))]
        kinds = {key: sampler.integer(key, default=WRAPS["repeat"]) for key in ("wrapS", "wrapT")}
        for key, kind in kinds.items():
            if kind not in _KINDS:
                raise sampler.fault(key, f"is {kind}, which glTF does not define")
        return _KINDS[kinds["wrapS"]], _KINDS[kinds["wrapT"]]

    def data(self, index: int) -> bytes:
        """Return the image file as it is stored; UnfitReferenceError if it is not there, or not read."""
        if index not in self._loaded:
            self._loaded[index] = self._read(index)
        return self._loaded[index]

    def _read(self, index: int) -> bytes:
        image, uri = self.entries[index], self.entries[index].text("uri")
        if "bufferView" in image:
            view = self._accessors.views[image.integer("bufferView", below=len(self._accessors.views))]
            data = self._accessors.buffers.viewed(view)
        elif uri is not None:
            data = read(uri, self._folder)
        else:
            raise UnfitReferenceError("has neither a uri nor a bufferView")
        if not data:
            raise UnfitReferenceError("is empty")
        known = format_of(data, "") or ""
        package = missing_package(known) if known in EXTRA_CODECS else None
        if package is not None:
            raise UnfitReferenceError(
                f"is a {label_of(known)} image and needs the package {package}; {INSTALL}"
            )
        return data


def image_key(image: int) -> str:
    """Return the key of an image's texture, under which a new image is handed back."""
    return f"image {image}"


def media_type(data: bytes) -> str | None:
    """Return the media type that the first bytes of an image show, if it is one that glTF knows."""
    known = format_of(data, "")
    return f"image/{known}" if known in _HELD else None


def kind_of(extension: str) -> str:
    """Return what users call the images of an extension."""
    return IMAGE_EXTENSIONS[extension].rpartition("/")[2].rpartition(".")[2].upper()


def named_images(texture: Tree) -> set[int]:
    """Return all images that a texture of the JSON names, shown or not."""
    extensions = texture.get("extensions")
    holders = [texture, *(extensions.values() if isinstance(extensions, dict) else ())]
    found = {holder.get("source") for holder in holders if isinstance(holder, dict)}
    return {index for index in found if isinstance(index, int)}


def texture_infos(value: Any, place: str) -> Iterator[tuple[str, Tree]]:
    """Find the textureInfos in a part of the JSON, with their places."""
    yield from _below(value, place, is_texture=_names_texture(place))


def _below(value: Any, place: str, *, is_texture: bool) -> Iterator[tuple[str, Tree]]:
    if isinstance(value, list):
        for index, child in enumerate(value):
            yield from _below(child, f"{place}[{index}]", is_texture=is_texture)
    elif isinstance(value, dict):
        for key, child in list(value.items()):
            known = key != "extras" and (is_texture or _names_texture(key))
            yield from _below(child, f"{place}.{key}", is_texture=known)
        if is_texture and isinstance(value.get("index"), int):
            yield place, value


def _names_texture(name: str) -> bool:
    # In materials every `index` is that of a texture. Elsewhere, and in data of applications, it may be that of
    # anything, such as a morph target in VRM.
    return name.startswith("materials") or "texture" in name.lower()


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
        """Return texture coordinates, shape (n, 2), with the transform applied; overflow gives infinity."""
        a, b, c, d, e, f = self.transform
        with np.errstate(over="ignore", invalid="ignore"):
            moved: Float64s = uv @ np.array([[a, d], [b, e]]) + np.array([c, f])
        return moved


def present_slots(root: Entry) -> tuple[Slot, ...]:
    """Return the slots for which some material has a texture, the base colour first."""
    materials = root.entries("materials")
    return tuple(slot for slot in SLOT_PATHS if any(_infos(material, slot) for material in materials))


def texture_uses(root: Entry, slot: Slot) -> list[list[TextureUse]]:
    """Return the images of each material in a slot: none, one, or several alternatives."""
    count = len(root.entries("textures"))
    found: list[list[TextureUse]] = []
    for index, material in enumerate(root.entries("materials")):
        name = material.text("name") or f"material {index}"
        hides = material.text("alphaMode") in ("MASK", "BLEND")
        found.append([_use(name, info, count, hides) for info in _infos(material, slot)])
    return found


def looks(primitive: Entry, materials: Sequence[Sequence[TextureUse]]) -> list[tuple[int, TextureUse | None]]:
    """Return how a primitive can be shown, as (look, use); primitives show the same look at the same time."""
    # Look 0 is what viewers show by default; then an extension's material in place of the core one, and variants.
    default = _of_material(primitive, materials)
    found: list[tuple[int, TextureUse | None]] = [(0, default[0] if default else None)]
    found += [(1, use) for use in default[1:]]
    for mapping in primitive.entry("extensions").entry(_VARIANTS).entries("mappings"):
        chosen = _of_material(mapping, materials)[:1]
        variants = mapping.integers("variants", below=_MOST_VARIANTS)
        found += [(2 + variant, use) for variant in variants for use in chosen]
    return found


def _infos(material: Entry, slot: Slot) -> list[Entry]:
    """Return the textureInfos that a material has for a slot, that of core glTF first."""
    found = []
    for *parents, last in SLOT_PATHS[slot]:
        holder = material
        for key in parents:
            holder = holder.entry(key)
        if last in holder:
            found.append(holder.entry(last))
    return found


def _of_material(holder: Entry, materials: Sequence[Sequence[TextureUse]]) -> Sequence[TextureUse]:
    return materials[holder.integer("material", below=len(materials))] if "material" in holder else ()


def _use(name: str, info: Entry, count: int, alpha_hides: bool) -> TextureUse:
    transform = info.entry("extensions").entry(_TRANSFORM)
    owner = transform if "texCoord" in transform else info
    return TextureUse(
        material=name,
        info=info,
        texture=info.integer("index", below=count),
        coordinates=f"TEXCOORD_{owner.integer('texCoord', default=0)}",
        transform=_affine(transform),
        alpha_hides=alpha_hides,
    )


def _affine(transform: Entry) -> tuple[float, float, float, float, float, float]:
    """Return scale, then rotation, then offset."""
    # The rotation is counter-clockwise as seen in the image, where v points down; the specification's text and
    # examples mean that, though its GLSL turns the other way when read column by column.
    x, y = transform.numbers("offset", 2) or (0.0, 0.0)
    width, height = transform.numbers("scale", 2) or (1.0, 1.0)
    angle = transform.number("rotation", default=0.0)
    cosine, sine = float(np.cos(angle)), float(np.sin(angle))
    return cosine * width, sine * height, x, -sine * width, cosine * height, y
