"""Formats that are recognised, but not read: what each is called, and what users can do instead."""

from __future__ import annotations

import re
from typing import NamedTuple

_HEAD = 512  # bytes in which the mark of a format is looked for


class UnreadFormat(NamedTuple):
    what: str
    suffixes: tuple[str, ...]
    start: bytes  # a pattern of the first bytes
    remedy: str


_BLENDER, _UNPACK = "open it in Blender, and export it as glTF", "unpack it, and give the model"
_PARAVIEW = (
    "convert it to PLY with ParaView, or with PyVista: pyvista.read(...).save('model.ply', texture='RGB')"
)
_TILES = "extract the model with: npx 3d-tiles-tools b3dmToGlb -i tile.b3dm -o tile.glb"
_UNREAD = (
    UnreadFormat("FBX file", (".fbx",), rb"Kaydara FBX Binary|; FBX", _BLENDER),
    UnreadFormat("Blender file", (".blend",), rb"BLENDER", _BLENDER),
    UnreadFormat(
        "VTK file", (".vtk", ".vtp", ".vtu"), rb"# vtk DataFile|(?:<\?xml[^>]*>\s*)?<VTKFile", _PARAVIEW
    ),
    UnreadFormat("3D Tiles file", (".b3dm", ".i3dm", ".pnts", ".cmpt"), rb"b3dm|i3dm|pnts|cmpt", _TILES),
    UnreadFormat(
        "material library", (".mtl",), rb"\s*(?:#[^\n]*\n\s*)*newmtl\s", "give the .obj file that names it"
    ),
    UnreadFormat("ZIP archive", (), rb"PK\x03\x04", _UNPACK),
    UnreadFormat("empty ZIP archive", (), rb"PK\x05\x06", _UNPACK),
    UnreadFormat("gzip archive", (), rb"\x1f\x8b", _UNPACK),
    UnreadFormat("bzip2 archive", (), rb"BZh", _UNPACK),
    UnreadFormat("xz archive", (), rb"\xfd7zXZ\0", _UNPACK),
    UnreadFormat("Zstandard archive", (), rb"\x28\xb5\x2f\xfd", _UNPACK),
    UnreadFormat("7z archive", (), rb"7z\xbc\xaf\x27\x1c", _UNPACK),
    UnreadFormat("RAR archive", (), rb"Rar!\x1a\x07", _UNPACK),
    UnreadFormat("tar archive", (), rb"[\0-\xff]{257}ustar", _UNPACK),
)


def unread_format(data: bytes, name: str) -> UnreadFormat | None:
    for each in _UNREAD:
        if (each.suffixes and name.lower().endswith(each.suffixes)) or re.match(each.start, data[:_HEAD]):
            return each
    return None
