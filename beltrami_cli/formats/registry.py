"""The known formats: how each is recognised, and which module reads and writes it.

A new mesh format is a folder in this package and a line of `FORMATS`. The module of a format is imported on demand, so
that the command line starts fast.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from beltrami_cli.errors import InputError
from beltrami_cli.formats.files.access import DEFAULT_ACCESS, Access, read_source

if TYPE_CHECKING:
    from beltrami_cli.formats.document import Document
    from beltrami_cli.surface.records import Slot

    Recogniser = Callable[[bytes, str], bool]

Kind = Literal["image", "volume", "model"]

_ZIP = b"PK"
_VOLUMES = (b"NRRD", b" BDV", _ZIP)  # first bytes of their files

# Formats that are not read: extensions, a pattern of the first bytes, and the remedy.
_BLENDER, _UNPACK = "open it in Blender, and export it as glTF", "unpack it, and give the model"
_PARAVIEW = (
    "convert it to PLY with ParaView, or with PyVista: pyvista.read(...).save('model.ply', texture='RGB')"
)
_TILES = "extract the model with: npx 3d-tiles-tools b3dmToGlb -i tile.b3dm -o tile.glb"
_UNREAD: dict[str, tuple[tuple[str, ...], bytes, str]] = {
    "FBX file": ((".fbx",), rb"Kaydara FBX Binary|; FBX", _BLENDER),
    "Blender file": ((".blend",), rb"BLENDER", _BLENDER),
    "VTK file": ((".vtk", ".vtp", ".vtu"), rb"# vtk DataFile|(?:<\?xml[^>]*>\s*)?<VTKFile", _PARAVIEW),
    "3D Tiles file": ((".b3dm", ".i3dm", ".pnts", ".cmpt"), rb"b3dm|i3dm|pnts|cmpt", _TILES),
    "material library": ((".mtl",), rb"\s*(?:#[^\n]*\n\s*)*newmtl\s", "give the .obj file that names it"),
    "ZIP archive": ((), rb"PK\x03\x04", _UNPACK),
    "empty ZIP archive": ((), rb"PK\x05\x06", _UNPACK),
    "gzip archive": ((), rb"\x1f\x8b", _UNPACK),
    "bzip2 archive": ((), rb"BZh", _UNPACK),
    "xz archive": ((), rb"\xfd7zXZ\0", _UNPACK),
    "Zstandard archive": ((), rb"\x28\xb5\x2f\xfd", _UNPACK),
    "7z archive": ((), rb"7z\xbc\xaf\x27\x1c", _UNPACK),
    "RAR archive": ((), rb"Rar!\x1a\x07", _UNPACK),
    "tar archive": ((), rb"[\0-\xff]{257}ustar", _UNPACK),
}
_HEAD = 512  # bytes in which the mark of a format is looked for
_JSON = rb"(?:\xef\xbb\xbf)?[ \t\r\n]*\{"
_PCD = rb"# \.PCD|VERSION 0?\.7"
_COMMON_IMAGES = (".png", ".jpg", ".jpeg")
_TEXTS = ("xyzrgb", "asc", "txt")
READ_ONLY = ("off", "stl", "3mf", "dae", "zae")


@dataclass(frozen=True)
class Format:
    """A line of the registry. Classes and functions are found in `module`, relative to this package."""

    name: str  # `Document.format`; with a writer also the value of --format and the suffix of OUTPUT
    # Recognises the bytes and, if need be, the name of a file; None: the files have no mark, or that of another line.
    mark: Recogniser | None
    module: str
    reader: str  # a `Document`; for volumes a function that returns a `Volume`
    writer: str = ""  # (MeshContents, stem) -> Written; empty: none
    has_textures: bool = False  # whether the writer writes textures
    sidecars: str = ""  # suffixes of the sidecar files that the writer makes without textures
    textured_sidecars: str = ""  # and with textures; ".*" is the suffix of the texture
    images: tuple[str, ...] = ()  # suffixes of the images that the format can hold; empty: any
    slots: tuple[Slot, ...] = ()  # slots that the writer can write; empty: any
    aliases: tuple[str, ...] = ()  # further suffixes, without the dot
    by_name: bool = False  # whether files without any mark are recognised by these suffixes
    keeps_form: bool = False  # whether only documents of this format are written in it
    kind: Kind = "model"  # the content; meshes and point clouds are models

    @property
    def suffixes(self) -> tuple[str, ...]:
        return tuple(f".{name}" for name in (self.name, *self.aliases))

    def load(self, name: str) -> Any:
        return _loaded(f"{self.module}.{name}")


def _by_start(pattern: bytes) -> Recogniser:
    compiled = re.compile(pattern)
    return lambda data, name: compiled.match(data) is not None


def _by_function(function: str, *starts: bytes) -> Recogniser:
    """Recognise by a function of this package, imported only for files with one of the `starts` (none: all files)."""
    return lambda data, name: data.startswith(starts or b"") and bool(_loaded(function)(data, name))


def _loaded(name: str) -> Any:
    module, _, attribute = f"beltrami_cli.formats.{name}".rpartition(".")
    return getattr(importlib.import_module(module), attribute)


def _is_usdz(data: bytes, name: str) -> bool:
    if not data.startswith(_ZIP):
        return False
    length = int.from_bytes(data[26:28], "little")  # of the name of the first file
    is_layer = data[30 : 30 + length].lower().endswith((b".usd", b".usda", b".usdc"))
    return is_layer or name.lower().endswith(".usdz")


def _is_foreign(data: bytes, name: str) -> bool:
    # OBJ files are recognised by their names alone, and may start with comments, as OFF files do.
    return not name.lower().endswith(".obj") and _loaded("read_only.document.kind_of")(data, name) is not None


def _textured(name: str, mark: Recogniser | None, reader: str, form: str = "", **more: Any) -> Format:
    """Return a line of a textured format; the writer is named after the format, or after `form`."""
    module, _, document = reader.partition(".")
    writer = f"writer.write_{form or name}"
    return Format(name, mark, module, f"document.{document}", writer, has_textures=True, **more)


# The first line whose mark matches is taken. Names are considered only if no mark matches.
FORMATS = (
    Format("image", _by_function("image.file_formats.is_image"), "image_document", "ImageDocument", kind="image"),
    Format("volume", _by_function("volume.is_volume", *_VOLUMES), "volume", "read_volume", kind="volume"),
    _textured("ply", _by_start(rb"ply[\n\r \t]"), "ply.PlyDocument", textured_sidecars=".*", slots=("baseColor",)),
    _textured(
        "obj", None, "obj.ObjDocument", by_name=True, textured_sidecars=".mtl .*",
        slots=("baseColor", "emissive", "normal", "metallicRoughness"),
    ),
    _textured("glb", _by_start(rb"glTF"), "gltf.GltfDocument", images=_COMMON_IMAGES),
    Format("vrm", None, "gltf", "document.GltfDocument", keeps_form=True),  # a GLB with an avatar
    _textured(
        "gltf", _by_start(_JSON), "gltf.GltfDocument", sidecars=".bin", textured_sidecars=".bin .*",
        images=_COMMON_IMAGES,
    ),
    _textured("usdz", _is_usdz, "usd.UsdDocument", images=_COMMON_IMAGES),
    _textured("usda", _by_start(rb"#usda"), "usd.UsdDocument", textured_sidecars=".*"),
    _textured("usdc", _by_start(rb"PXR-USDC"), "usd.UsdDocument", textured_sidecars=".*"),
    # A .usd file has one of the two forms above.
    _textured("usd", None, "usd.UsdDocument", form="usdc", textured_sidecars=".*"),
    *(
        Format(
            name, None, "points.text_document", "TextPointsDocument", f"write_{name}", aliases=aliases, by_name=True
        )
        for name, aliases in (("xyz", _TEXTS), ("pts", ()), ("csv", ()))
    ),
    *(
        Format(name, mark, "points.survey", "SurveyDocument", keeps_form=True)
        for name, mark in (
            ("las", _by_start(rb"LASF")), ("laz", None), ("e57", _by_start(rb"ASTM-E57")), ("pcd", _by_start(_PCD))
        )
    ),
    Format("npz", _by_function("files.numpy_files.is_npz", _ZIP), "points.npz", "NpzPointsDocument", "write_npz"),
    Format("foreign", _is_foreign, "read_only", "document.ReadOnlyDocument", aliases=READ_ONLY),
)  # fmt: skip


def _extensions(*packages: str) -> str:
    return ", ".join(s for line in FORMATS if line.module.split(".")[0] in packages for s in line.suffixes)


_READABLE = (
    f"beltrami reads {_extensions('ply', 'obj', 'gltf', 'usd')}; points in {_extensions('points')}; "
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
    document: Document = line.load(line.reader)(data, name, folder, access)
    return document


def recognised(data: bytes, name: str) -> Format | None:
    """Return the format of a file by its bytes, or else by its name; None: unknown."""
    marked = next((line for line in FORMATS if line.mark is not None and line.mark(data, name)), None)
    if marked is not None or not data or _unread(data, name):
        return marked
    named = (line for line in FORMATS if line.by_name and name.lower().endswith(line.suffixes))
    return next(named, None)


def _refusal(data: bytes, name: str) -> InputError:
    if known := _unread(data, name):
        return InputError(name, f"it is a {known}, which is not read", _UNREAD[known][2])
    if not data:
        return InputError(name, "the file is empty", _READABLE)
    if not Path(name).suffix:  # standard input among them
        remedy = "give OBJ files, and points in .xyz and .pts, by their names"
        return InputError(name, "the content has no mark of a known format", remedy)
    return InputError(name, "the content is of no known format", _READABLE)


def _unread(data: bytes, name: str) -> str | None:
    for kind, (suffixes, start, _) in _UNREAD.items():
        if (suffixes and name.lower().endswith(suffixes)) or re.match(start, data[:_HEAD]):
            return kind
    return None
