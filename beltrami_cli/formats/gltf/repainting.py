"""New images put in the place of old ones, in one slot of the materials and nowhere else.

An image whose every use is replaced by the same new file just gets other bytes. Where it is still used by another
slot, another texture or an extension, the new file becomes a new image, and only what belongs to the slot is
pointed at it. Textures are treated likewise: changed if all that name them follow, copied otherwise.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from beltrami_cli.errors import OutputError
from beltrami_cli.formats.gltf.entries import objects
from beltrami_cli.formats.gltf.image_storage import MEDIA, ImageStorage
from beltrami_cli.formats.gltf.textured_surface import image_key
from beltrami_cli.formats.gltf.textures import FOREIGN, SLOT_PATHS, WEBP, media_type, named_images
from beltrami_cli.formats.model_folder import UnfitReferenceError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from beltrami_cli.formats.gltf.edit import Edit
    from beltrami_cli.formats.gltf.json_text import Tree
    from beltrami_cli.formats.gltf.textures import Images
    from beltrami_cli.surface.records import ImageFile, Slot

_WITHOUT_TEXTURES = ("accessors", "animations", "bufferViews", "buffers", "images", "skins", "textures")


@dataclass(frozen=True)
class _Change:
    """A texture that is to show a new file in place of an image."""

    texture: int
    image: int
    file: ImageFile


def repaint(edit: Edit, images: Images, new: Mapping[tuple[Slot, str], ImageFile]) -> None:
    """Replace images by new ones, as for `Document.patch`; ValueError if there is no such image in the slot."""
    wanted = _wanted(edit, images, new)
    if not wanted:
        return
    before = _extensions(edit.tree)
    changes: dict[int, list[_Change]] = defaultdict(list)
    for change in _changes(edit.tree, images, wanted):
        changes[change.image].append(change)
    storage = ImageStorage(edit, images)
    for image, members in changes.items():
        files = list(dict.fromkeys(change.file for change in members))
        free = not _used_elsewhere(edit.tree, images, image, {change.texture for change in members})
        targets = {}
        for number, file in enumerate(files):
            targets[file] = storage.replace(image, file) if free and not number else storage.add(image, file)
        for change in members:
            _point(edit, images, change, targets[change.file])
    storage.finish()
    _declare(edit.tree, before)


def _wanted(
    edit: Edit, images: Images, new: Mapping[tuple[Slot, str], ImageFile]
) -> dict[tuple[Slot, int], ImageFile]:
    """Return the files that differ from what there is, by slot and image."""
    indices = {image_key(index): index for index in range(len(images))}
    wanted = {}
    for (slot, key), file in new.items():
        if key not in indices or images.canonical(indices[key]) != indices[key]:
            raise ValueError(f"there is no image called {key!r}")
        if file.suffix.lower() not in MEDIA:
            cause = f"glTF cannot hold {file.suffix} textures ({images.name(indices[key])})"
            raise OutputError(edit.container.name, cause, "choose PNG, JPEG or WebP with --texture-format")
        if file.data != images.data(indices[key]):
            wanted[slot, indices[key]] = file
    return wanted


def _changes(tree: Tree, images: Images, wanted: Mapping[tuple[Slot, int], ImageFile]) -> list[_Change]:
    """Decide which textures show the new files; copy those that others use too, and point infos at the copies."""
    users: dict[int, list[tuple[Tree, ImageFile | None]]] = defaultdict(list)
    shown = {index: _shown(images, index) for index in range(len(images.textures))}
    for info, slot in _infos(tree):
        texture = info["index"]
        image = shown.get(texture)
        file = None if slot is None or image is None else wanted.get((slot, image))
        users[texture].append((info, file))
    changes = []
    for texture, uses in users.items():
        files = list(dict.fromkeys(file for _, file in uses if file is not None))
        image = shown.get(texture)
        free = all(file is not None for _, file in uses)
        for number, file in enumerate(files):
            index = texture if free and not number else _copy(tree, texture, uses, file)
            if image is not None:
                changes.append(_Change(index, image, file))
    if {(change.image, change.file) for change in changes} != {(i, f) for (_, i), f in wanted.items()}:
        raise ValueError("an image is not used in the slot that it was handed back for")
    return changes


def _shown(images: Images, texture: int) -> int | None:
    try:
        return images.canonical(images.shown(texture))
    except UnfitReferenceError:
        return None


def _infos(tree: Tree) -> Iterator[tuple[Tree, Slot | None]]:
    """Find all textureInfos, those of extensions too, each with the slot that it belongs to if any."""
    slots: dict[int, Slot] = {}
    for material in objects(tree.get("materials")):
        for slot, paths in SLOT_PATHS.items():
            for path in paths:
                holder: Any = material
                for key in path:
                    holder = holder.get(key) if isinstance(holder, dict) else None
                slots[id(holder)] = slot
    stack: list[Any] = [value for key, value in tree.items() if key not in _WITHOUT_TEXTURES]
    while stack:
        value = stack.pop()
        if isinstance(value, list):
            stack += value
        elif isinstance(value, dict):
            stack += value.values()
            if isinstance(value.get("index"), int):
                yield value, slots.get(id(value))


def _copy(tree: Tree, texture: int, uses: list[tuple[Tree, ImageFile | None]], file: ImageFile) -> int:
    index = len(tree["textures"])
    tree["textures"].append(dict(tree["textures"][texture]))
    for info, new in uses:
        if new == file:
            info["index"] = index
    return index


def _used_elsewhere(tree: Tree, images: Images, image: int, changing: set[int]) -> bool:
    """Return whether something else needs an image as it was: another texture, or an image-based light."""
    group = set(images.same(image))
    if any(named_images(t) & group for index, t in enumerate(tree["textures"]) if index not in changing):
        return True
    lights = tree.get("extensions", {}).get("EXT_lights_image_based", {})
    stack: list[Any] = [light.get("specularImages") for light in objects(lights.get("lights"))]
    while stack:
        value = stack.pop()
        if isinstance(value, list):
            stack += value
        elif value in group:
            return True
    return False


def _point(edit: Edit, images: Images, change: _Change, image: int) -> None:
    """Make a texture show another image, in the way that its type asks for."""
    texture = edit.tree["textures"][change.texture]
    extensions = dict(texture.get("extensions", {}))
    for extension in [name for name in FOREIGN if name in extensions]:
        del extensions[extension]
        edit.notices.append(
            f"textures[{change.texture}] loses its {FOREIGN[extension]} image ({extension}), which would show the "
            "old colours."
        )
    webp = MEDIA[change.file.suffix.lower()] == "image/webp"
    old = extensions.get(WEBP, {}).get("source", texture.get("source"))
    if old is not None and old < len(images) and images.canonical(old) == image:
        image = old  # another description of the same image
    if webp and WEBP in extensions:
        extensions[WEBP] = extensions[WEBP] | {"source": image}
        if "source" in texture:
            edit.notices.append(
                f"textures[{change.texture}] keeps its fallback for viewers without WebP as it was."
            )
    elif webp and media_type(images.data(change.image)) != "image/webp":
        extensions[WEBP] = {"source": image}
        texture.pop("source", None)
    else:
        extensions.pop(WEBP, None)
        texture["source"] = image
    if extensions:
        texture["extensions"] = extensions
    else:
        texture.pop("extensions", None)


def _extensions(tree: Tree) -> set[str]:
    """Return which of the extensions that hold images the textures use."""
    used = {name for texture in objects(tree.get("textures")) for name in texture.get("extensions", {})}
    return used & {WEBP, *FOREIGN}


def _declare(tree: Tree, before: set[str]) -> None:
    """Bring the lists of extensions up to date with the textures."""
    after = _extensions(tree)
    if WEBP in after:
        _enlist(tree, "extensionsUsed", WEBP)
        textures = [t for t in objects(tree["textures"]) if WEBP in t.get("extensions", {})]
        if any("source" not in texture for texture in textures):
            _enlist(tree, "extensionsRequired", WEBP)
    for key in ("extensionsUsed", "extensionsRequired") if before - after else ():
        kept = [name for name in tree.get(key, []) if name not in before - after]
        if kept:
            tree[key] = kept
        else:
            tree.pop(key, None)


def _enlist(tree: Tree, key: str, extension: str) -> None:
    names = tree.setdefault(key, [])
    if extension not in names:
        names.append(extension)
