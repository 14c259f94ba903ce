"""New images of a glTF file, put in the place of old ones, in one slot and nowhere else.

An image whose every use is replaced by the same new file just gets other bytes. Where it is still used by another
slot, or as data by an extension, the new file becomes a new image, and only what belongs to the slot is pointed at it,
with colours of extensions that show the same image. Textures are treated likewise: changed if all that name them
follow, copied otherwise (`Edit.separate`).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any

from beltrami_cli.errors import BeltramiError, OutputError
from beltrami_cli.formats.changes import NewImages
from beltrami_cli.formats.gltf.edit import Edit
from beltrami_cli.formats.gltf.entries import Tree
from beltrami_cli.formats.gltf.images import (
    IMAGE_EXTENSIONS,
    MEDIA,
    WEBP,
    Images,
    image_key,
    image_type,
    media_type,
)
from beltrami_cli.formats.gltf.materials import SLOT_PATHS
from beltrami_cli.formats.gltf.references import image_uses, objects, objects_within, texture_infos
from beltrami_cli.formats.gltf.uris import data_uri, is_data
from beltrami_cli.formats.image.file_formats import suffix_for
from beltrami_cli.formats.image.reading import read_image
from beltrami_cli.formats.image.writing import write_image
from beltrami_cli.formats.sidecars.model_folder import UnfitReferenceError
from beltrami_cli.formats.sidecars.new_files import stale_use_notice
from beltrami_cli.surface.records import ImageFile, PlannedImage, Slot

# Members of extensions, of any vendor, that name colours, as KHR_materials_sheen and VRMC_materials_mtoon do.
_COLOURS = re.compile(
    r".*(albedo|colou?r|diffuse|emissive|matcap|rimMultiply|shade|shadeMultiply)(map|texture)", re.IGNORECASE
)

Wanted = Mapping[tuple[Slot, int], ImageFile]  # new files by slot and image


def show_images(edit: Edit, images: Images, new: NewImages) -> None:
    """Show new images, as for `Document.patch`; ValueError if a slot lacks an image."""
    wanted = _wanted(edit, images, new)
    if not wanted:
        return
    before, shown = _extensions(edit.tree), dict[int, int]()
    for index in range(len(images.textures)):
        with suppress(UnfitReferenceError):
            shown[index] = images.canonical(images.shown(index))
    changed = edit.separate("textures", _texture_uses(edit, images, wanted, shown))
    replaced = {(shown[texture], file) for texture, file in changed}
    if replaced != {(image, file) for (_, image), file in wanted.items()}:
        raise ValueError("an image is not used in the slot that it was handed back for")
    showing = _ShownImages(edit, images)
    for (old, file), texture in changed.items():
        showing.show(edit.tree["textures"][texture], old, file, f"textures[{texture}]")
    _put_images(edit, _separate_images(edit, images, showing.files))
    _declare(edit.tree, before)


def _wanted(edit: Edit, images: Images, new: NewImages) -> Wanted:
    """Return the files that differ from the present ones."""
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


def _texture_uses(
    edit: Edit, images: Images, wanted: Wanted, shown: Mapping[int, int]
) -> list[tuple[Any, Any, ImageFile | None]]:
    """Return the textureInfos of a file, each with the new file that it is to show; `shown`: images of textures."""
    uses, stale = list[tuple[Any, Any, ImageFile | None]](), dict[str, str]()
    slots = _slots_of_infos(edit.tree)
    for place, info in texture_infos(edit.tree):
        slot, image = slots.get(id(info)), shown.get(info["index"], -1)
        files = [wanted[each, image] for each in SLOT_PATHS if (each, image) in wanted]
        if slot is not None:
            file = wanted.get((slot, image))
        elif files and not _COLOURS.fullmatch(place.rpartition(".")[2]):
            file, stale[re.sub(r"\[\d+\]", "", place)] = None, images.name(image)
        else:
            file = next(iter(files), None)
        uses.append((info, "index", file))
    edit.notices += [stale_use_notice(place, name) for place, name in stale.items()]
    return uses


def _slots_of_infos(tree: Tree) -> dict[int, Slot]:
    """Return the slots of textureInfos in materials, by the identity of these."""
    slots: dict[int, Slot] = {}
    for material in objects(tree.get("materials")):
        for slot, paths in SLOT_PATHS.items():
            for path in paths:
                holder: Any = material
                for key in path:
                    holder = holder.get(key) if isinstance(holder, dict) else None
                slots[id(holder)] = slot
    return slots


class _ShownImages:
    """New files in textures of the tree of an edit: they name the old images, and `files` says what these become."""

    def __init__(self, edit: Edit, images: Images) -> None:
        self._edit, self._images = edit, images
        self.files: dict[int, ImageFile] = {}  # by the identity of the object that names the image
        self._renewed: dict[tuple[int, ImageFile], ImageFile | None] = {}

    def show(self, texture: Tree, old: int, file: ImageFile, place: str) -> None:
        """Make a texture show a file, in the way that its type asks for, and let no other image keep the old colours.

        `old` is the texture of the file that it was or is a copy of.
        """
        first = self._images.shown(old)
        image = self._images.canonical(first)
        extensions = texture.pop("extensions", {})
        # By extension, "" for the plain image, the objects that name the images of the texture.
        holders = {"": texture} | {name: extensions[name] for name in IMAGE_EXTENSIONS if name in extensions}
        media = MEDIA[file.suffix.lower()]
        fitting = next((name for name, kind in IMAGE_EXTENSIONS.items() if kind == media), "")
        was_plain = media_type(self._images.data(image)) == media and fitting not in extensions
        target = "" if was_plain else fitting
        named = {
            name: source for name, each in holders.items() if isinstance(source := each.get("source"), int)
        }
        present = next((name for name in (WEBP, "", *IMAGE_EXTENSIONS) if name in named), "")
        for name in [each for each in named if each != target]:
            is_fallback = not name and target == WEBP and WEBP in extensions
            renewed = self._renew(named[name], image, file)
            if renewed is not None and (name or is_fallback):
                self.files[id(holders[name])] = renewed
            elif is_fallback:
                self._edit.notices.append(f"{place} keeps its fallback for viewers without WebP as it was.")
            elif not name:
                del texture["source"]
            else:
                del extensions[name]
                if name not in (fitting, present):
                    lost = f"{place} loses its {image_type(name)} image ({name})"
                    self._edit.notices.append(f"{lost}, which would show the old colours.")
        # Of several descriptions of the same image, the texture keeps the one that it names.
        kept = named.get(target, first)
        holder = texture if not target else extensions.setdefault(target, {})
        holder["source"] = kept if self._images.canonical(kept) == image else first
        self.files[id(holder)] = file
        if extensions:
            texture["extensions"] = extensions

    def _renew(self, index: int, image: int, file: ImageFile) -> ImageFile | None:
        """Return another image than the shown one with the new colours; None if that cannot be."""
        if file.is_chosen or index >= len(self._images) or self._images.canonical(index) == image:
            return None
        key = self._images.canonical(index), file
        if key not in self._renewed:
            self._renewed[key] = renewed = _recoloured(self._images, key[0], file)
            self._edit.notices += () if renewed is None else renewed.notices
        return self._renewed[key]


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


def _separate_images(edit: Edit, images: Images, file_of: Mapping[int, ImageFile]) -> dict[int, ImageFile]:
    """Give new files images that nothing else uses, and return these; `file_of`: by identity of what names an image."""
    uses = [(holder, member, file_of.get(id(holder))) for holder, member in image_uses(edit.tree)]
    named = {holder[member] for holder, member, _ in uses}
    files = {index: file for (_, file), index in edit.separate("images", uses).items()}
    # An image that nothing shows follows those over the same bytes.
    by_bytes = {images.canonical(index): file for index, file in files.items()}
    unused = set(range(len(images))) - named
    return files | {n: by_bytes[images.canonical(n)] for n in unused if images.canonical(n) in by_bytes}


def _put_images(edit: Edit, files: Mapping[int, ImageFile]) -> None:
    """Give images new files, stored as the old ones are: in a buffer, in a data URI, or as a file."""
    images = edit.tree["images"]
    for index, file in files.items():
        image, media = images[index], MEDIA[file.suffix.lower()]
        if "bufferView" in image or "mimeType" in image:
            image["mimeType"] = media
        if "bufferView" not in image and is_data(image["uri"]):
            is_same = image["uri"][5:].partition(",")[0].partition(";")[0].lower() == media
            image["uri"] = data_uri(image["uri"] if is_same else f"data:{media};base64,", file.data)
        elif "bufferView" not in image:
            edit.images[index] = file
    file_of = {id(images[index]): file for index, file in files.items()}
    holders = [*images, *objects_within({key: value for key, value in edit.tree.items() if key != "images"})]
    # What an extension says of a view is not known to be true of other bytes.
    holders += [
        {"bufferView": n} for n, view in enumerate(edit.tree.get("bufferViews", [])) if "extensions" in view
    ]
    named = [holder for holder in holders if isinstance(holder.get("bufferView"), int)]
    uses = [(holder, "bufferView", file_of.get(id(holder))) for holder in named]
    for (old, file), view in edit.separate("bufferViews", uses, copied=lambda _: {}).items():
        home = edit.growing_buffer([edit.tree["bufferViews"][old]["buffer"]])
        edit.put(home, (view, None), file.data)


def _declare(tree: Tree, before: set[str]) -> None:
    """Update the lists of extensions that are used and required; `before` are the former ones for images."""
    after = _extensions(tree)
    for extension in sorted(name for name in after if IMAGE_EXTENSIONS[name] in MEDIA.values()):
        holders = [t for t in objects(tree["textures"]) if extension in t.get("extensions", {})]
        is_required = any("source" not in texture for texture in holders)
        for key in ("extensionsUsed", *(["extensionsRequired"] if is_required else [])):
            if extension not in tree.setdefault(key, []):
                tree[key].append(extension)
    for key in ("extensionsUsed", "extensionsRequired") if before - after else ():
        tree[key] = [name for name in tree.get(key, []) if name not in before - after]
        if not tree[key]:
            del tree[key]


def _extensions(tree: Tree) -> set[str]:
    used = {name for texture in objects(tree.get("textures")) for name in texture.get("extensions", {})}
    return used & IMAGE_EXTENSIONS.keys()
