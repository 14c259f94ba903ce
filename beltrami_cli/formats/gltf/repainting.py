"""New images put in the place of old ones, in one slot of the materials and nowhere else.

An image whose every use is replaced by the same new file just gets other bytes. Where it is still used by another
slot, another texture or an extension, the new file becomes a new image, and only what belongs to the slot is
pointed at it. Textures are treated likewise: changed if all that name them follow, copied otherwise.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from beltrami_cli.errors import BeltramiError, OutputError
from beltrami_cli.formats.document import NewImages
from beltrami_cli.formats.gltf.buffers import data_uri, named_places, named_views
from beltrami_cli.formats.gltf.container import Tree, objects
from beltrami_cli.formats.gltf.edit import Edit, is_unshared
from beltrami_cli.formats.gltf.textures import (
    IMAGE_EXTENSIONS,
    MEDIA,
    SLOT_PATHS,
    WEBP,
    Images,
    image_key,
    kind_of,
    media_type,
    named_images,
    texture_infos,
)
from beltrami_cli.formats.image import read_image, write_image
from beltrami_cli.formats.image.picture import suffix_for
from beltrami_cli.formats.model_folder import UnfitReferenceError
from beltrami_cli.surface.records import ImageFile, PlannedImage, Slot

_WITHOUT_TEXTURES = ("accessors", "animations", "bufferViews", "buffers", "images", "skins", "textures")


@dataclass(frozen=True)
class _Change:
    """A texture that is to show a new file in place of an image."""

    texture: int
    image: int
    file: ImageFile


def repaint(edit: Edit, images: Images, new: NewImages) -> ImageStorage:
    """Show new images, as for `Document.patch`, and return what stores them; ValueError if a slot lacks an image."""
    storage, wanted = ImageStorage(edit, images), _wanted(edit, images, new)
    if not wanted:
        return storage
    before = _extensions(edit.tree)
    changes: dict[int, list[_Change]] = defaultdict(list)
    for change in _changes(edit.tree, images, wanted):
        changes[change.image].append(change)
    known: dict[tuple[int, ImageFile], int | None] = {}
    for image, members in changes.items():
        files = list(dict.fromkeys(change.file for change in members))
        free = not _used_elsewhere(edit.tree, images, image, {change.texture for change in members})
        targets = {}
        for number, file in enumerate(files):
            targets[file] = storage.replace(image, file) if free and not number else storage.add(image, file)
        for change in members:
            together = {each.texture for each in members if each.file == change.file}
            others = _renew(storage, edit, images, change, together, known)
            _point(edit, images, change, targets[change.file], others)
    _declare(edit.tree, before)
    return storage


def _wanted(edit: Edit, images: Images, new: NewImages) -> dict[tuple[Slot, int], ImageFile]:
    """Return the files that differ from what there is, by slot and image."""
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


def _changes(tree: Tree, images: Images, wanted: Mapping[tuple[Slot, int], ImageFile]) -> list[_Change]:
    """Decide which textures show the new files; copy textures that others use, and point infos at the copies."""
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
            index = texture
            if number or not free:
                index = len(tree["textures"])
                tree["textures"].append(dict(tree["textures"][texture]))
                for info in (info for info, new in uses if new == file):
                    info["index"] = index
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


def _renew(
    storage: ImageStorage,
    edit: Edit,
    images: Images,
    change: _Change,
    together: set[int],
    known: dict[tuple[int, ImageFile], int | None],
) -> dict[str, int]:
    """Give the new colours to the images of a texture for other viewers; return them by extension, "" for plain."""
    texture = edit.tree["textures"][change.texture]
    if change.file.is_chosen:
        return {}
    extensions = texture.get("extensions", {})
    holders = {"": texture} | {name: extensions[name] for name in IMAGE_EXTENSIONS if name in extensions}
    found: dict[str, int] = {}
    for name, holder in holders.items():
        index = holder.get("source")
        if index is None or index >= len(images) or images.canonical(index) == change.image:
            continue
        other = images.canonical(index)
        if (other, change.file) not in known:
            file = _recoloured(images, other, change.file)
            free = not _used_elsewhere(edit.tree, images, other, together)
            put = storage.replace if free else storage.add
            known[other, change.file] = None if file is None else put(other, file)
            edit.notices += () if file is None else file.notices
        new = known[other, change.file]
        found |= {} if new is None else {name: new}
    return found


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


def _point(edit: Edit, images: Images, change: _Change, image: int, renewed: Mapping[str, int]) -> None:
    """Make a texture show another image, in the way that its type asks for."""
    texture = edit.tree["textures"][change.texture]
    extensions = dict(texture.get("extensions", {}))
    media = MEDIA[change.file.suffix.lower()]
    own = next((name for name, kind in IMAGE_EXTENSIONS.items() if kind == media), None)
    was_plain = media_type(images.data(change.image)) == media and own not in extensions
    image = _described(texture, extensions, images, image)
    present = [name for name in IMAGE_EXTENSIONS if name in extensions]
    shown = WEBP if WEBP in present or "source" in texture else next(iter(present), None)
    for extension in present:
        if extension in renewed:
            extensions[extension] = extensions[extension] | {"source": renewed[extension]}
        elif extension != own:
            del extensions[extension]
        if extension not in (own, shown, *renewed):
            lost = f"textures[{change.texture}] loses its {kind_of(extension)} image ({extension})"
            edit.notices.append(f"{lost}, which would show the old colours.")
    if own is None or was_plain:
        texture["source"] = image
    elif own == WEBP and WEBP in extensions:
        extensions[own] = extensions[own] | {"source": image}
        if "" in renewed:
            texture["source"] = renewed[""]
        elif "source" in texture:
            kept = f"textures[{change.texture}] keeps its fallback"
            edit.notices.append(f"{kept} for viewers without WebP as it was.")
    else:
        extensions[own] = extensions.get(own, {}) | {"source": image}
        texture.pop("source", None)
    if extensions:
        texture["extensions"] = extensions
    else:
        texture.pop("extensions", None)


def _described(texture: Tree, extensions: Tree, images: Images, image: int) -> int:
    """Return the description of an image that a texture shows already, if there are several; else the image."""
    holders = [*(extensions.get(name, {}) for name in IMAGE_EXTENSIONS), texture]
    for source in (holder.get("source") for holder in holders):
        if source is not None and source < len(images) and images.canonical(source) == image:
            return int(source)
    return image


def _extensions(tree: Tree) -> set[str]:
    used = {name for texture in objects(tree.get("textures")) for name in texture.get("extensions", {})}
    return used & IMAGE_EXTENSIONS.keys()


def _declare(tree: Tree, before: set[str]) -> None:
    after = _extensions(tree)
    known = {name for name, kind in IMAGE_EXTENSIONS.items() if kind in MEDIA.values()}
    for extension in sorted(after & known):
        holders = [t for t in objects(tree["textures"]) if extension in t.get("extensions", {})]
        is_required = any("source" not in texture for texture in holders)
        for key in ("extensionsUsed", *(["extensionsRequired"] if is_required else [])):
            if extension not in tree.setdefault(key, []):
                tree[key].append(extension)
    for key in ("extensionsUsed", "extensionsRequired") if before - after else ():
        kept = [name for name in tree.get(key, []) if name not in before - after]
        if kept:
            tree[key] = kept
        else:
            tree.pop(key, None)


_PADDING = 8  # bytes that may lie between views only to align them


@dataclass(frozen=True)
class _Blob:
    """An image for a buffer."""

    data: bytes
    view: int | None  # which it may overwrite; None: it needs its own
    images: tuple[int, ...]  # that show it


class ImageStorage:
    """New images while they are collected; `finish` puts images in buffers into place together."""

    def __init__(self, edit: Edit, images: Images) -> None:
        self._edit, self._images = edit, images
        self._named = Counter(named_views(edit.tree))
        self.blobs: dict[int, list[_Blob]] = defaultdict(list)  # by the buffer that `finish` puts them into

    def replace(self, image: int, file: ImageFile) -> int:
        """Give an image and its duplicates other bytes; return its index."""
        group = self._images.same(image)
        view = self._edit.tree["images"][image].get("bufferView")
        alone = view is not None and self._named[view] == len(group)
        is_plain = alone and "extensions" not in self._edit.tree["bufferViews"][view]
        self._put(group, file, view if is_plain else None)
        return image

    def add(self, image: int, file: ImageFile) -> int:
        """Add an image that is stored as another one is; return its index."""
        images = self._edit.tree["images"]
        images.append(dict(images[image]))
        self._put((len(images) - 1,), file, None)
        return len(images) - 1

    def _put(self, group: tuple[int, ...], file: ImageFile, view: int | None) -> None:
        media = MEDIA[file.suffix.lower()]
        for index in group:
            image = self._edit.tree["images"][index]
            if "bufferView" in image or "mimeType" in image:
                image["mimeType"] = media
        image = self._edit.tree["images"][group[0]]
        if "bufferView" in image:
            home = self._edit.tree["bufferViews"][image["bufferView"]]["buffer"]
            buffer = self._edit.accessors.buffers.canonical(home)
            self.blobs[buffer].append(_Blob(file.data, view, group))
        elif image["uri"][:5].lower() == "data:":
            same = image["uri"][5:].partition(",")[0].partition(";")[0].lower() == media
            image["uri"] = data_uri(image["uri"] if same else f"data:{media};base64,", file.data)
        else:
            self._edit.images |= dict.fromkeys(group, file)

    def finish(self) -> None:
        for buffer, blobs in self.blobs.items():
            _store(self._edit, buffer, blobs)


def _store(edit: Edit, buffer: int, blobs: Sequence[_Blob]) -> None:
    """Put images into one buffer: first where the old ones were as far as they fit, the others at the end."""
    views, data = edit.tree["bufferViews"], edit.open(buffer)
    # A view that only an image uses may be overwritten, if no other view shares its bytes.
    own = {
        blob.view: blob
        for blob in blobs
        if blob.view is not None and is_unshared(edit, (blob.view, None), buffer, *_span(views[blob.view]))
    }
    others = [span for view, span in _spans(edit, buffer) if view not in own]
    end = _end(data, edit.tree["buffers"][buffer]["byteLength"], [_span(views[v]) for v in own], others)
    moving = [replace(blob, view=None) for blob in blobs if blob.view not in own]
    for view, blob in sorted(own.items(), key=lambda item: _span(views[item[0]])[0]):
        if _span(views[view])[0] >= end or not _fitted(edit, buffer, view, blob.data, end):
            moving.append(blob)
    del data[end:]
    edit.tree["buffers"][buffer]["byteLength"] = len(data)
    for blob in moving:
        start = edit.append(buffer, blob.data)
        place = {"buffer": buffer, "byteOffset": start, "byteLength": len(blob.data)}
        if blob.view is None:
            index = edit.add_view(place)
            for image in blob.images:
                edit.tree["images"][image]["bufferView"] = index
        else:
            views[blob.view] |= place


def _span(view: Tree) -> tuple[int, int]:
    start = view.get("byteOffset", 0)
    return start, start + view["byteLength"]


def _spans(edit: Edit, buffer: int) -> list[tuple[int | None, tuple[int, int]]]:
    """Return which bytes of a buffer are in use, each range with its view if it is one's."""
    canonical, tree = edit.accessors.buffers.canonical, edit.tree
    known = len(edit.accessors.buffers)
    same = {index for index in range(known) if canonical(index) == buffer} | {buffer}
    spans: list[tuple[int | None, tuple[int, int]]] = []
    lengths = [entry["byteLength"] for entry in tree["buffers"]]
    for (index, extension), part in named_places(tree, lengths):
        if part.buffer in same:
            spans.append((None if extension else index, (part.offset, part.end)))
    # Another buffer over the same file keeps its length, and so all of its bytes.
    return spans + [(None, (0, lengths[index])) for index in same - {buffer}]


def _end(
    data: bytearray, length: int, own: Sequence[tuple[int, int]], others: Sequence[tuple[int, int]]
) -> int:
    """Return where the bytes that must stay end: before the images to be replaced that are last in the buffer."""
    kept = max((end for _, end in others), default=0)
    if len(data) - length >= 4:  # more than the padding of a chunk: it may mean something
        return len(data)
    found, edge = len(data), length
    for start, end in sorted(own, reverse=True):
        if start < kept or not edge - _PADDING < end <= edge:
            break
        found = edge = start
    return found


def _fitted(edit: Edit, buffer: int, number: int, new: bytes, limit: int) -> bool:
    """Overwrite the old image if the new one fits before what comes next; leave zeros where it is not."""
    view, data = edit.tree["bufferViews"][number], edit.open(buffer)
    start, end = _span(view)
    after = min([limit, *(a for _, (a, _) in _spans(edit, buffer) if a >= end)])
    vacant = data.count(0, end, after) == after - end  # left by an earlier image, or padding
    fits = start + len(new) <= (after if vacant else end)
    data[start:end] = bytes(end - start)
    if fits:
        data[start : start + len(new)] = new
        view["byteLength"] = len(new)
    return fits
