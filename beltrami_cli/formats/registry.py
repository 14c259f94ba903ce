"""The known formats: how each is recognised, and what a new file of it holds.

A new mesh format is a folder in this package, a line of `FORMATS`, and its reader and writer in `loading.py`.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from beltrami_cli.errors import InputError
from beltrami_cli.formats.files.access import DEFAULT_ACCESS, Access, read_source
from beltrami_cli.formats.image.file_formats import is_image
from beltrami_cli.formats.loading import Reader, Writer, document_class
from beltrami_cli.formats.unread import unread_format

if TYPE_CHECKING:
    from beltrami_cli.formats.document import Document
    from beltrami_cli.surface.records import Slot

    Recogniser = Callable[[bytes, str], bool]

Kind = Literal["image", "volume", "model"]

_ZIP = b"PK"
_VOLUMES = (b"NRRD", b" BDV", _ZIP)  # first bytes of their files
_JSON = rb"(?:\xef\xbb\xbf)?[ \t\r\n]*\{"
_PCD = rb"# \.PCD|VERSION 0?\.7"
_COMMON_IMAGES = (".png", ".jpg", ".jpeg")
READ_ONLY = ("off", "stl", "3mf", "dae", "zae")


@dataclass(frozen=True)
class Format:
    """A line of the registry."""

    name: str  # `Document.format`; if it is written also the value of --format and the suffix of OUTPUT
    # Recognises the bytes and, if need be, the name of a file; None: the files have no mark, or that of another line.
    mark: Recogniser | None
    reader: Reader | None  # for `document_class`; None: a volume, which becomes a document with settings
    writer: Writer | None = None  # for `mesh_writer`; None: meshes are not written in it
    has_textures: bool = False  # whether the writer writes textures
    sidecars: tuple[str, ...] = ()  # suffixes of the sidecar files that the writer makes without textures
    textured_sidecars: tuple[str, ...] = ()  # and with textures; ".*" is the suffix of the texture
    images: tuple[str, ...] = ()  # suffixes of the images that the format can hold; empty: any
    slots: tuple[Slot, ...] = ()  # slots that the writer can write; empty: any
    aliases: tuple[str, ...] = ()  # further suffixes, without the dot
    by_name: bool = False  # whether files without any mark are recognised by these suffixes
    keeps_form: bool = False  # whether only documents of this format are written in it
    kind: Kind = "model"  # the content; meshes and point clouds are models

    @property
    def suffixes(self) -> tuple[str, ...]:
        return tuple(f".{name}" for name in (self.name, *self.aliases))


def _by_start(pattern: bytes) -> Recogniser:
    compiled = re.compile(pattern)
    return lambda data, name: compiled.match(data) is not None


def _is_volume(data: bytes, name: str) -> bool:
    if not data.startswith(_VOLUMES):
        return False
    from beltrami_cli.formats.volume import is_volume

    return is_volume(data, name)


def _is_npz(data: bytes, name: str) -> bool:
    del name
    if not data.startswith(_ZIP):
        return False
    from beltrami_cli.formats.files.numpy_files import is_npz

    return is_npz(data)


def _is_usdz(data: bytes, name: str) -> bool:
    if not data.startswith(_ZIP):
        return False
    length = int.from_bytes(data[26:28], "little")  # of the name of the first file
    is_layer = data[30 : 30 + length].lower().endswith((b".usd", b".usda", b".usdc"))
    return is_layer or name.lower().endswith(".usdz")


def _is_foreign(data: bytes, name: str) -> bool:
    from beltrami_cli.formats.read_only.document import kind_of

    # OBJ files are recognised by their names alone, and may start with comments, as OFF files do.
    return not name.lower().endswith(".obj") and kind_of(data, name) is not None


_textured = partial(Format, has_textures=True)

# The first line whose mark matches is taken. Names are considered only if no mark matches.
FORMATS = (
    Format("image", is_image, "image", kind="image"),
    Format("volume", _is_volume, None, kind="volume"),
    _textured("ply", _by_start(rb"ply[\n\r \t]"), "ply", "ply", textured_sidecars=(".*",), slots=("baseColor",)),
    _textured(
        "obj", None, "obj", "obj", by_name=True, textured_sidecars=(".mtl", ".*"),
        slots=("baseColor", "emissive", "normal", "metallicRoughness"),
    ),
    _textured("glb", _by_start(rb"glTF"), "gltf", "glb", images=_COMMON_IMAGES),
    Format("vrm", None, "gltf", keeps_form=True),  # a GLB with an avatar
    _textured(
        "gltf", _by_start(_JSON), "gltf", "gltf", sidecars=(".bin",), textured_sidecars=(".bin", ".*"),
        images=_COMMON_IMAGES,
    ),
    _textured("usdz", _is_usdz, "usd", "usdz", images=_COMMON_IMAGES),
    _textured("usda", _by_start(rb"#usda"), "usd", "usda", textured_sidecars=(".*",)),
    _textured("usdc", _by_start(rb"PXR-USDC"), "usd", "usdc", textured_sidecars=(".*",)),
    _textured("usd", None, "usd", "usdc", textured_sidecars=(".*",)),  # in one of the two forms above
    Format("xyz", None, "text points", "xyz", aliases=("xyzrgb", "asc", "txt"), by_name=True),
    Format("pts", None, "text points", "pts", by_name=True),
    Format("csv", None, "text points", "csv", by_name=True),
    Format("las", _by_start(rb"LASF"), "survey", keeps_form=True),
    Format("laz", None, "survey", keeps_form=True),
    Format("e57", _by_start(rb"ASTM-E57"), "survey", keeps_form=True),
    Format("pcd", _by_start(_PCD), "survey", keeps_form=True),
    Format("npz", _is_npz, "npz points", "npz"),
    Format("foreign", _is_foreign, "read only", aliases=READ_ONLY),
)  # fmt: skip


def _extensions(*readers: Reader) -> str:
    return ", ".join(s for line in FORMATS if line.reader in readers for s in line.suffixes)


_READABLE = (
    f"beltrami reads {_extensions('ply', 'obj', 'gltf', 'usd')}; "
    f"points in {_extensions('text points', 'survey', 'npz points')}; "
    "images such as .png, .jpg, .tif and .exr; level sets in .nrrd and .npz; and the colours of "
    f".{', .'.join(READ_ONLY)}"
)
WRITERS = {line.name: line for line in FORMATS if line.writer}
OUTPUT_FORMATS = {name: name for name in WRITERS} | {
    alias: line.name for line in WRITERS.values() for alias in line.aliases
}
"""Formats that models can be written in, by the suffix of OUTPUT without its dot."""
KEPT_FORMATS = tuple(line.name for line in FORMATS if line.keeps_form)
"""Formats that only documents of the same format are written in."""


def open_document(source: str, access: Access = DEFAULT_ACCESS, data: bytes | None = None) -> Document:
    """Open a file, or standard input for "-", as the model that it is; InputError if it is none or damaged.

    `data` are its bytes, if they have been read already.
    """
    data = read_source(source, access) if data is None else data
    return open_bytes(data, *name_and_folder(source), access)


def name_and_folder(source: str) -> tuple[str, Path | None]:
    """Return the name of a source for messages, and the folder of its sidecar files; standard input has none."""
    return ("<stdin>", None) if source == "-" else (source, Path(source).parent)


def open_bytes(data: bytes, name: str, folder: Path | None, access: Access = DEFAULT_ACCESS) -> Document:
    """Open the bytes of a model whose sidecars lie in a folder (None: nowhere); InputError as `open_document`."""
    line = recognised(data, name)
    if line is not None and line.kind != "model":
        what = "an image" if line.kind == "image" else "a level set"
        raise InputError(
            name, f"it is {what}, not a model", "give a mesh or points, such as .ply, .obj or .glb"
        )
    return open_as(line, data, name, folder, access)


def open_as(line: Format | None, data: bytes, name: str, folder: Path | None, access: Access) -> Document:
    """Open the bytes of a model or image in a recognised format; InputError if it was not recognised."""
    if line is None:
        raise _refusal(data, name)
    assert line.reader is not None
    return document_class(line.reader)(data, name, folder, access)


def recognised(data: bytes, name: str) -> Format | None:
    """Return the format of a file by its bytes, or else by its name; None: unknown."""
    marked = next((line for line in FORMATS if line.mark is not None and line.mark(data, name)), None)
    if marked is not None or not data or unread_format(data, name) is not None:
        return marked
    named = (line for line in FORMATS if line.by_name and name.lower().endswith(line.suffixes))
    return next(named, None)


def _refusal(data: bytes, name: str) -> InputError:
    if (unread := unread_format(data, name)) is not None:
        return InputError(name, f"it is a {unread.what}, which is not read", unread.remedy)
    if not data:
        return InputError(name, "the file is empty", _READABLE)
    if not Path(name).suffix:  # standard input among them
        remedy = "give OBJ files, and points in .xyz and .pts, by their names"
        return InputError(name, "the content has no mark of a known format", remedy)
    return InputError(name, "the content is of no known format", _READABLE)
