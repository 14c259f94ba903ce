"""The images and textures of a glTF file, and new images put in the place of old ones, in one slot and nowhere else.

An image whose every use is replaced by the same new file just gets other bytes. Where it is still used by another
slot, another texture or an extension, the new file becomes a new image, and only what belongs to the slot is
pointed at it. Textures are treated likewise: changed if all that name them follow, copied otherwise.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Hashable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import PurePosixPath
from typing import Any

from beltrami_cli.errors import BeltramiError, OutputError
from beltrami_cli.formats.document import NewImages
from beltrami_cli.formats.gltf.accessors import Accessors
from beltrami_cli.formats.gltf.buffers import file_key, is_data, read, relative_name
from beltrami_cli.formats.gltf.container import Entry, Tree, objects
from beltrami_cli.formats.gltf.edit import Edit
from beltrami_cli.formats.gltf.saving import MEDIA, ImageStorage, media_type
from beltrami_cli.formats.image import format_of, label_of, read_image, write_image
from beltrami_cli.formats.image.extra_codecs import EXTRA_CODECS, INSTALL, missing_package
from beltrami_cli.formats.image.picture import suffix_for
from beltrami_cli.formats.model_folder import ModelFolder, UnfitReferenceError
from beltrami_cli.surface.records import ImageFile, PlannedImage, Slot, Wrap

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

_KINDS = {number: kind for kind, number in WRAPS.items()}
_WITHOUT_TEXTURES = ("accessors", "animations", "bufferViews", "buffers", "images", "skins", "textures")


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
        """Return the name of an image for messages: that of its file, or its own."""
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
                raise UnfitReferenceError(
                    f"is a {_kind_of(extension)} image ({extension}), which is not read"
                )
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


def _kind_of(extension: str) -> str:
    """Return the common name of the image type of an extension."""
    return IMAGE_EXTENSIONS[extension].rpartition("/")[2].rpartition(".")[2].upper()


def _named_images(texture: Tree) -> set[int]:
    """Return all images that a texture of the JSON names, shown or not."""
    extensions = texture.get("extensions")
    holders = [texture, *(extensions.values() if isinstance(extensions, dict) else ())]
    found = {holder.get("source") for holder in holders if isinstance(holder, dict)}
    return {index for index in found if isinstance(index, int)}


def texture_infos(value: Any, place: str, *, is_texture: bool | None = None) -> Iterator[tuple[str, Tree]]:
    """Find the textureInfos in a part of the JSON, with their places; `is_texture` if not as its place says."""
    is_texture = _names_texture(place) if is_texture is None else is_texture
    if isinstance(value, list):
        for index, child in enumerate(value):
            yield from texture_infos(child, f"{place}[{index}]", is_texture=is_texture)
    elif isinstance(value, dict):
        for key, child in list(value.items()):
            known = key != "extras" and (is_texture or _names_texture(key))
            yield from texture_infos(child, f"{place}.{key}", is_texture=known)
        if is_texture and isinstance(value.get("index"), int):
            yield place, value


def _names_texture(name: str) -> bool:
    # In materials every `index` is that of a texture. Elsewhere, and in data of applications, it may be that of
    # anything, such as a morph target in VRM.
    return name.startswith("materials") or "texture" in name.lower()


@dataclass(frozen=True)
class _Change:
    """A texture that is to show a new file in place of an image."""

    texture: int
    image: int
    file: ImageFile


def repaint(edit: Edit, images: Images, new: NewImages) -> ImageStorage:
    """Show new images, as for `Document.patch`, and return what stores them; ValueError if a slot lacks an image."""
    repainting, wanted = _Repainting(edit, images), _wanted(edit, images, new)
    if wanted:
        repainting.show(wanted)
    return repainting.storage


def _wanted(edit: Edit, images: Images, new: NewImages) -> dict[tuple[Slot, int], ImageFile]:
    """Return the files that differ from the present ones, by slot and image."""
    indices = {image_key(index): index for index in range(len(images))}
    wanted = {}
    for (slot, key), file in new.items():
        if key not in indices or images.canonical(indices[key]) != indices[key]:
            raise ValueError(f"there is no image called {key!r}")
        if file.suffix.lower() not in MEDIA:
            cause = f"glTF cannot hold {file.suffix} textures ({images.name(indices[key])})"
            remedy = "choose PNG, JPEG, WebP, KTX2 or AVIF with --texture-format"
            raise OutputError(edit.container.name, cause, remedy)
        if file.data != images.data(indices[key]):
            wanted[slot, indices[key]] = file
    return wanted


class _Repainting:
    """Changes of the textures in the tree of an edit, whose new images go into a storage."""

    def __init__(self, edit: Edit, images: Images) -> None:
        self.edit, self.tree, self.images = edit, edit.tree, images
        self.storage = ImageStorage(edit, images.same)
        self._renewed: dict[tuple[int, ImageFile], int | None] = {}

    def show(self, wanted: Mapping[tuple[Slot, int], ImageFile]) -> None:
        """Show new files in place of images in slots."""
        before = self._extensions()
        changes: dict[int, list[_Change]] = defaultdict(list)
        for change in self._changes(wanted):
            changes[change.image].append(change)
        for image, members in changes.items():
            files = list(dict.fromkeys(change.file for change in members))
            free = not self._is_used_elsewhere(image, {change.texture for change in members})
            targets = {}
            for number, file in enumerate(files):
                put = self.storage.replace if free and not number else self.storage.add
                targets[file] = put(image, file)
            for change in members:
                together = {each.texture for each in members if each.file == change.file}
                self._point(change, targets[change.file], self._renew(change, together))
        self._declare(before)

    def _changes(self, wanted: Mapping[tuple[Slot, int], ImageFile]) -> list[_Change]:
        """Decide which textures show the new files; copy textures with other users, and point infos at the copies."""
        users: dict[int, list[tuple[Tree, ImageFile | None]]] = defaultdict(list)
        shown: dict[int, int] = {}
        for index in range(len(self.images.textures)):
            with suppress(UnfitReferenceError):
                shown[index] = self.images.canonical(self.images.shown(index))
        for info, slot in _infos(self.tree):
            image = shown.get(info["index"])
            file = None if slot is None or image is None else wanted.get((slot, image))
            users[info["index"]].append((info, file))
        changes = []
        for texture, uses in users.items():
            files = list(dict.fromkeys(file for _, file in uses if file is not None))
            free = all(file is not None for _, file in uses)
            for number, file in enumerate(files):
                index = texture
                if number or not free:
                    index = len(self.tree["textures"])
                    self.tree["textures"].append(dict(self.tree["textures"][texture]))
                    for info in (info for info, new in uses if new == file):
                        info["index"] = index
                changes.append(_Change(index, shown[texture], file))
        if {(change.image, change.file) for change in changes} != {(i, f) for (_, i), f in wanted.items()}:
            raise ValueError("an image is not used in the slot that it was handed back for")
        return changes

    def _is_used_elsewhere(self, image: int, changing: set[int]) -> bool:
        """Whether something else needs an image as it was: another texture, or an image-based light."""
        group = set(self.images.same(image))
        textures = enumerate(self.tree["textures"])
        if any(_named_images(texture) & group for index, texture in textures if index not in changing):
            return True
        lights = self.tree.get("extensions", {}).get("EXT_lights_image_based", {})
        stack: list[Any] = [light.get("specularImages") for light in objects(lights.get("lights"))]
        while stack:
            value = stack.pop()
            if isinstance(value, list):
                stack += value
            elif value in group:
                return True
        return False

    def _renew(self, change: _Change, together: set[int]) -> dict[str, int]:
        """Give the new colours to the images of a texture for other viewers; return them by extension, "" for plain."""
        texture = self.tree["textures"][change.texture]
        if change.file.is_chosen:
            return {}
        extensions = texture.get("extensions", {})
        holders = {"": texture} | {name: extensions[name] for name in IMAGE_EXTENSIONS if name in extensions}
        found: dict[str, int] = {}
        for name, holder in holders.items():
            index = holder.get("source")
            if index is None or index >= len(self.images) or self.images.canonical(index) == change.image:
                continue
            other = self.images.canonical(index)
            if (other, change.file) not in self._renewed:
                file = _recoloured(self.images, other, change.file)
                put = self.storage.add if self._is_used_elsewhere(other, together) else self.storage.replace
                self._renewed[other, change.file] = None if file is None else put(other, file)
                self.edit.notices += () if file is None else file.notices
            new = self._renewed[other, change.file]
            found |= {} if new is None else {name: new}
        return found

    def _point(self, change: _Change, image: int, renewed: Mapping[str, int]) -> None:
        """Make a texture show another image, in the way that its type asks for."""
        texture = self.tree["textures"][change.texture]
        extensions = dict(texture.get("extensions", {}))
        media = MEDIA[change.file.suffix.lower()]
        own = next((name for name, kind in IMAGE_EXTENSIONS.items() if kind == media), None)
        was_plain = media_type(self.images.data(change.image)) == media and own not in extensions
        # Of several descriptions of the same image, the texture keeps the one that it names.
        holders = [*(extensions.get(name, {}) for name in IMAGE_EXTENSIONS), texture]
        named = [source for holder in holders if (source := holder.get("source")) is not None]
        same = (i for i in named if i < len(self.images) and self.images.canonical(i) == image)
        image = int(next(same, image))
        present = [name for name in IMAGE_EXTENSIONS if name in extensions]
        shown = WEBP if WEBP in present or "source" in texture else next(iter(present), None)
        for extension in present:
            if extension in renewed:
                extensions[extension] = extensions[extension] | {"source": renewed[extension]}
            elif extension != own:
                del extensions[extension]
            if extension not in (own, shown, *renewed):
                lost = f"textures[{change.texture}] loses its {_kind_of(extension)} image ({extension})"
                self.edit.notices.append(f"{lost}, which would show the old colours.")
        if own is None or was_plain:
            texture["source"] = image
        elif own == WEBP and WEBP in extensions:
            extensions[own] = extensions[own] | {"source": image}
            if "" in renewed:
                texture["source"] = renewed[""]
            elif "source" in texture:
                kept = f"textures[{change.texture}] keeps its fallback"
                self.edit.notices.append(f"{kept} for viewers without WebP as it was.")
        else:
            extensions[own] = extensions.get(own, {}) | {"source": image}
            texture.pop("source", None)
        texture["extensions"] = extensions
        if not extensions:
            del texture["extensions"]

    def _extensions(self) -> set[str]:
        textures = objects(self.tree.get("textures"))
        used = {name for texture in textures for name in texture.get("extensions", {})}
        return used & IMAGE_EXTENSIONS.keys()

    def _declare(self, before: set[str]) -> None:
        """Update the lists of extensions that are used and required; `before` are the former ones for images."""
        after = self._extensions()
        known = {name for name, kind in IMAGE_EXTENSIONS.items() if kind in MEDIA.values()}
        for extension in sorted(after & known):
            holders = [t for t in objects(self.tree["textures"]) if extension in t.get("extensions", {})]
            is_required = any("source" not in texture for texture in holders)
            for key in ("extensionsUsed", *(["extensionsRequired"] if is_required else [])):
                if extension not in self.tree.setdefault(key, []):
                    self.tree[key].append(extension)
        for key in ("extensionsUsed", "extensionsRequired") if before - after else ():
            kept = [name for name in self.tree.get(key, []) if name not in before - after]
            self.tree[key] = kept
            if not kept:
                del self.tree[key]


def _infos(tree: Tree) -> Iterator[tuple[Tree, Slot | None]]:
    """Find all textureInfos, also in extensions, each with the slot that it belongs to if any."""
    slots: dict[int, Slot] = {}
    for material in objects(tree.get("materials")):
        for slot, paths in SLOT_PATHS.items():
            for path in paths:
                holder: Any = material
                for key in path:
                    holder = holder.get(key) if isinstance(holder, dict) else None
                slots[id(holder)] = slot
    for key, value in tree.items():
        if key not in _WITHOUT_TEXTURES:
            for _, info in texture_infos(value, key):
                yield info, slots.get(id(info))


def _recoloured(images: Images, image: int, shown: ImageFile) -> ImageFile | None:
    """Return an image of a texture in its own type with the colours of the new one; None if that cannot be."""
    name = images.name(image)
    if isinstance(shown, PlannedImage):
        return replace(shown, suffix=suffix_for(images.data(image), name) or shown.suffix)
    try:
        old, new = read_image(images.data(image), name), read_image(shown.data, name)
        same_layout = old.pixels.dtype == new.pixels.dtype and old.pixels.shape[:2] == new.pixels.shape[:2]
        if not same_layout or len(old.channels) > len(new.channels) or old.colour != new.colour:
            return None
        return write_image(old, new.pixels[..., : len(old.channels)])
    except (BeltramiError, UnfitReferenceError):
        return None
