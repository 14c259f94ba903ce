"""The images of a glTF file: where their bytes are, which are one and the same, and which one a texture shows."""

from __future__ import annotations

from pathlib import PurePosixPath
from typing import TYPE_CHECKING

from beltrami_cli.formats.gltf.files import is_data, read, relative_name
from beltrami_cli.formats.model_folder import UnfitReferenceError

if TYPE_CHECKING:
    from collections.abc import Hashable

    from beltrami_cli.formats.gltf.accessors import Accessors
    from beltrami_cli.formats.gltf.json_text import Tree
    from beltrami_cli.formats.gltf.tree import Entry
    from beltrami_cli.formats.model_folder import ModelFolder
    from beltrami_cli.surface.records import Wrap

WEBP = "EXT_texture_webp"
"""The extension of textures whose image is WebP."""

FOREIGN = {"KHR_texture_basisu": "KTX2", "EXT_texture_avif": "AVIF", "MSFT_texture_dds": "DDS"}
"""Extensions of textures that name an image of a type that is not read."""

_WRAPS: dict[int, Wrap] = {10497: "repeat", 33648: "mirror", 33071: "clamp"}
_MEDIA = ((b"\x89PNG", "image/png"), (b"\xff\xd8\xff", "image/jpeg"), (b"\xabKTX 20", "image/ktx2"))


class Pictures:
    """All images and textures of one file; bytes are read when they are asked for.

    Raises
    ------
    InputError
        If an image is described wrongly.
    """

    def __init__(self, root: Entry, accessors: Accessors, beside: ModelFolder) -> None:
        self._accessors, self._beside = accessors, beside
        self.images = root.entries("images")
        self.textures = root.entries("textures")
        self._samplers = root.entries("samplers")
        self._loaded: dict[int, bytes] = {}
        first: dict[Hashable, int] = {}
        self._canonical = [first.setdefault(self._place(index), index) for index in range(len(self.images))]

    def _place(self, index: int) -> tuple[str, str | int]:
        image = self.images[index]
        if "bufferView" in image:
            return "view", image.integer("bufferView", below=len(self._accessors.views))
        uri = image.text("uri")
        if uri is None or is_data(uri):
            return "own", index
        try:
            return "file", relative_name(uri, outside=self._beside.access.outside)
        except UnfitReferenceError:
            return "own", index

    def canonical(self, index: int) -> int:
        """Return the first image over the same bytes as this one, usually itself."""
        return self._canonical[index]

    def name(self, index: int) -> str:
        """Return what people know an image by: its file, or its own name."""
        image, uri = self.images[index], self.images[index].text("uri")
        if uri is not None and not is_data(uri):
            try:
                return PurePosixPath(relative_name(uri, outside=True)).name
            except UnfitReferenceError:
                return uri
        return image.text("name") or f"image {index}"

    def shown(self, texture: int) -> int:
        """Return the image that a texture shows: its WebP image, otherwise its plain one.

        Raises
        ------
        UnfitReferenceError
            If it has neither; the reason names the type that it has instead.
        """
        entry = self.textures[texture]
        holder = entry.entry("extensions").entry(WEBP)
        holder = holder if "source" in holder else entry
        if "source" in holder:
            return holder.integer("source", below=len(self.images))
        for extension, kind in FOREIGN.items():
            if extension in entry.entry("extensions"):
                raise UnfitReferenceError(f"is a {kind} image ({extension}), which is not read")
        raise UnfitReferenceError("has no image")

    def wrap(self, texture: int) -> tuple[Wrap, Wrap]:
        """Return what lies beyond 0 and 1 along u and v."""
        entry = self.textures[texture]
        if "sampler" not in entry:
            return "repeat", "repeat"
        sampler = self._samplers[entry.integer("sampler", below=len(self._samplers))]
        both: list[Wrap] = []
        for key in ("wrapS", "wrapT"):
            kind = sampler.integer(key, default=10497)
            if kind not in _WRAPS:
                raise sampler.fault(key, f"is {kind}, which glTF does not define")
            both.append(_WRAPS[kind])
        return both[0], both[1]

    def media(self, index: int) -> str | None:
        """Return the media type of an image, as its bytes show it."""
        return media_type(self.data(index))

    def data(self, index: int) -> bytes:
        """Return the image file as it is stored.

        Raises
        ------
        UnfitReferenceError
            If its file is missing, outside the folder or damaged as a data URI, or its type is not read.
        InputError
            If the buffer that holds it cannot be read.
        """
        if index not in self._loaded:
            self._loaded[index] = self._read(index)
        return self._loaded[index]

    def _read(self, index: int) -> bytes:
        image, uri = self.images[index], self.images[index].text("uri")
        if "bufferView" in image:
            number = image.integer("bufferView", below=len(self._accessors.views))
            view = self._accessors.views[number]
            octets = self._accessors.buffers.stored(view.buffer)
            data = bytes(octets[view.offset : view.offset + view.length])
        elif uri is not None:
            data = read(uri, self._beside)
        else:
            raise UnfitReferenceError("has neither a uri nor a bufferView")
        if not data:
            raise UnfitReferenceError("is empty")
        if media_type(data) == "image/ktx2":
            raise UnfitReferenceError("is a KTX2 image (KHR_texture_basisu), which is not read")
        return data


def media_type(data: bytes) -> str | None:
    """Return the media type that the first bytes of an image show, if it is one that glTF knows."""
    for magic, kind in _MEDIA:
        if data.startswith(magic):
            return kind
    return "image/webp" if data[:4] == b"RIFF" and data[8:12] == b"WEBP" else None


def named_images(texture: Tree) -> set[int]:
    """Return all images that a texture of the JSON names, shown or not."""
    extensions = texture.get("extensions")
    holders = [texture, *(extensions.values() if isinstance(extensions, dict) else ())]
    found = {holder.get("source") for holder in holders if isinstance(holder, dict)}
    return {index for index in found if isinstance(index, int)}
