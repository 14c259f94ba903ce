"""A glTF file as JSON and binary chunks: GLB or plain text, taken apart and put together again."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

from beltrami_cli.errors import InputError
from beltrami_cli.formats.changes import Bytes
from beltrami_cli.formats.gltf.entries import Entry, Tree, spelled
from beltrami_cli.formats.gltf.json_text import parsed, revised

_MAGIC = b"glTF"
JSON_CHUNK = 0x4E4F534A
BIN_CHUNK = 0x004E4942

_BOM = "\ufeff"
TRUNCATED = "the file may be cut short: copy or export it again"


@dataclass(frozen=True)
class Chunk:
    """One chunk of a GLB file: its type and its bytes without padding added by us."""

    kind: int
    data: Bytes


@dataclass(frozen=True)
class Container:
    """A glTF file taken apart."""

    name: str  # of the file, for messages
    kind: str  # "glb" or "gltf"
    data: bytes  # the whole file
    text: str  # the JSON, without byte order mark and without the padding of its chunk
    tree: Tree  # the JSON, parsed
    chunks: tuple[Chunk, ...] = ()  # after the JSON chunk: BIN, then unknown ones
    has_bom: bool = False
    tail: Bytes = b""  # bytes behind the length that the GLB header states

    @property
    def root(self) -> Entry:
        return Entry(self.name, "", self.tree)

    @property
    def binary(self) -> Bytes | None:
        """The BIN chunk, which must be the second; None without one."""
        return self.chunks[0].data if self.chunks and self.chunks[0].kind == BIN_CHUNK else None

    @property
    def unknown_chunks(self) -> tuple[Chunk, ...]:
        return self.chunks if self.binary is None else self.chunks[1:]

    def copy_of_tree(self) -> Tree:
        """Return a tree that may be changed and given to `rebuilt`."""
        return parsed(self.text, self.name)

    def rebuilt(self, tree: Tree, binary: Bytes | None) -> list[Bytes]:
        """Return the pieces of this file with another tree and BIN chunk (None: unchanged), all else kept."""
        text = ((_BOM if self.has_bom else "") + revised(self.text, tree)).encode()
        if self.kind == "gltf":
            return [text]
        chunks = self.chunks if binary is None else (Chunk(BIN_CHUNK, binary), *self.unknown_chunks)
        return [*glb_pieces([Chunk(JSON_CHUNK, text), *chunks]), self.tail]


def read_container(data: bytes, name: str) -> Container:
    """Take a glTF file apart: binary if it starts with the GLB magic, otherwise JSON text."""
    is_glb = data[:4] == _MAGIC
    chunks, tail = _glb_chunks(data, name) if is_glb else ([Chunk(JSON_CHUNK, data)], b"")
    try:
        text = bytes(chunks[0].data).decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(name, f"neither GLB nor UTF-8 text (byte {error.start})", "is it glTF?") from None
    has_bom, text = text.startswith(_BOM), text.removeprefix(_BOM)
    if is_glb:
        text = text.rstrip(" \0")
    kind, tree = "glb" if is_glb else "gltf", parsed(text, name)
    container = Container(name, kind, data, text, tree, tuple(chunks[1:]), has_bom, tail)
    asset = container.root.entry("asset")
    stored = asset.value.get("version")
    # glTF 1 had it as a number, too.
    is_old = isinstance(stored, int | float) and stored < 2
    version = spelled(stored) if is_old else asset.text("version") or ""
    if version.split(".")[0] != "2":
        cause = f"is {spelled(stored)}" if version else "is missing"
        raise asset.fault("version", f"{cause}, but only glTF 2 can be read", "export the model as glTF 2.0")
    least = asset.text("minVersion")
    if least not in (None, "2.0"):
        raise asset.fault("minVersion", f"is {least!r}, but only glTF 2.0 can be read")
    return container


def _glb_chunks(data: bytes, name: str) -> tuple[list[Chunk], Bytes]:
    """Return the chunks of a GLB file, the first being JSON, and the bytes behind its stated length."""
    if len(data) < 20:
        raise InputError(name, f"a GLB file of {len(data)} bytes has no room for its header", TRUNCATED)
    version, length = struct.unpack_from("<II", data, 4)
    if version != 2:
        cause = f"GLB version {version} cannot be read, only 2"
        raise InputError(name, cause, "export the model as glTF 2.0")
    if length > len(data):
        raise InputError(name, f"the GLB header counts {length} bytes, the file has {len(data)}", TRUNCATED)
    chunks: list[Chunk] = []
    position, view = 12, memoryview(data)
    while position < length:
        where = f"chunk {len(chunks)} at byte {position}"
        if position + 8 > length:
            raise InputError(name, f"{where}: its header is cut off", TRUNCATED)
        size, kind = struct.unpack_from("<II", data, position)
        if position + 8 + size > length:
            raise InputError(name, f"{where}: {size} bytes do not fit in the file of {length}", TRUNCATED)
        chunks.append(Chunk(kind, view[position + 8 : position + 8 + size]))
        position += 8 + size
    if not chunks or chunks[0].kind != JSON_CHUNK:
        raise InputError(name, "the first GLB chunk is not JSON", "export the model again")
    return chunks, view[length:]


def glb_pieces(chunks: Sequence[Chunk]) -> list[Bytes]:
    """Return a GLB file: header and chunks, JSON padded with spaces and the others with zeros to 4 bytes."""
    pieces: list[Bytes] = []
    for chunk in chunks:
        padding = (b" " if chunk.kind == JSON_CHUNK else b"\0") * (-len(chunk.data) % 4)
        pieces += [struct.pack("<II", len(chunk.data) + len(padding), chunk.kind), chunk.data, padding]
    return [_MAGIC + struct.pack("<II", 2, 12 + sum(len(piece) for piece in pieces)), *pieces]
