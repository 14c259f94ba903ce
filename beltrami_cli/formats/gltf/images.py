"""The images and textures of a glTF file; bytes are read when they are asked for."""

from __future__ import annotations

from collections.abc import Hashable
from pathlib import PurePosixPath

from beltrami_cli.errors import install_hint
from beltrami_cli.formats.gltf.accessors import Accessors
from beltrami_cli.formats.gltf.entries import Entry
from beltrami_cli.formats.gltf.uris import file_key, is_data, locate_uri, read_uri
from beltrami_cli.formats.image.extra_codecs import EXTRA, EXTRA_CODECS, missing_package
from beltrami_cli.formats.image.file_formats import FORMATS, format_of, label_of
from beltrami_cli.formats.sidecars.model_folder import ModelFolder, UnfitReferenceError
from beltrami_cli.surface.records import Wrap

WEBP = "EXT_texture_webp"
IMAGE_EXTENSIONS = {
    WEBP: "image/webp",
    "KHR_texture_basisu": "image/ktx2",
    "EXT_texture_avif": "image/avif",
    "MSFT_texture_dds": "image/vnd-ms.dds",
}
"""Extensions of textures that name an image of another type than core glTF has."""

_UNREAD = ("MSFT_texture_dds",)  # whose images are not read

_EMBEDDED_FORMATS = ("png", "jpeg", "webp", "ktx2", "avif")
MEDIA = {suffix: f"image/{known}" for known in _EMBEDDED_FORMATS for suffix in FORMATS[known].suffixes}
"""Media types of the images that glTF can hold, by suffix."""

WRAPS: dict[Wrap, int] = {"repeat": 10497, "mirror": 33648, "clamp": 33071}
"""The numbers by which samplers say what lies beyond an image."""
_NEAREST = 9728  # the filter of samplers that blends no texels
_KINDS = {number: kind for kind, number in WRAPS.items()}


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
        return self._canonical[index] if index < len(self) else index

    def name(self, index: int) -> str:
        """Return the name of an image for messages: that of its file, or its own."""
        image, uri = self.entries[index], self.entries[index].text("uri")
        if uri is not None and not is_data(uri):
            try:
                return PurePosixPath(locate_uri(uri, self._folder, must_exist=False)).name
            except UnfitReferenceError:
                return uri
        return image.text("name") or f"image {index}"

    def shown(self, texture: int) -> int:
        """Return the image that a texture shows; UnfitReferenceError if there is none that is read."""
        # WebP comes before plain images; a plain one is the better source where the other loses more.
        entry = self.textures[texture]
        extensions = entry.entry("extensions")
        readable = [name for name in IMAGE_EXTENSIONS if name not in (WEBP, *_UNREAD)]
        for holder in (extensions.entry(WEBP), entry, *map(extensions.entry, readable)):
            if "source" in holder:
                return holder.integer("source", below=len(self))
        for extension in _UNREAD:
            if extension in extensions:
                raise UnfitReferenceError(
                    f"is a {image_type(extension)} image ({extension}), which is not read"
                )
        raise UnfitReferenceError("has no image")

    def _sampler(self, texture: int) -> Entry | None:
        entry = self.textures[texture]
        has_sampler = "sampler" in entry
        return self._samplers[entry.integer("sampler", below=len(self._samplers))] if has_sampler else None

    def has_sharp_texels(self, texture: int) -> bool:
        sampler = self._sampler(texture)
        return sampler is not None and sampler.integer("magFilter", default=0) == _NEAREST

    def wrap(self, texture: int) -> tuple[Wrap, Wrap]:
        sampler = self._sampler(texture)
        if sampler is None:
            return "repeat", "repeat"
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
            data = read_uri(uri, self._folder)
        else:
            raise UnfitReferenceError("has neither a uri nor a bufferView")
        if not data:
            raise UnfitReferenceError("is empty")
        file_format = format_of(data, "") or ""
        package = missing_package(file_format) if file_format in EXTRA_CODECS else None
        if package is not None:
            raise UnfitReferenceError(
                f"is a {label_of(file_format)} image and needs the package {package}; {install_hint(EXTRA)}"
            )
        return data


def image_key(image: int) -> str:
    """Return the key of an image's texture, under which a new image is handed back."""
    return f"image {image}"


def image_type(extension: str) -> str:
    """Return the image type that an extension of textures allows, such as "DDS", for messages."""
    return IMAGE_EXTENSIONS[extension].rpartition("/")[2].rpartition(".")[2].upper()


def media_type(data: bytes) -> str | None:
    """Return the media type that the first bytes of an image show, if it is one that glTF knows."""
    file_format = format_of(data, "")
    return f"image/{file_format}" if file_format in _EMBEDDED_FORMATS else None
