"""Headers and footers of TGA files; a new file keeps their statements about alpha."""

from __future__ import annotations

END = b"TRUEVISION-XFILE.\0"  # after the addresses of the extension and developer areas
_ALPHA = 494  # byte of the extension area


def has_palette(data: bytes) -> bool:
    """Whether pixels are indices into a colour map, raw or run-length encoded."""
    return data[1:3] in (b"\1\1", b"\1\x09")


def carried_over(source: bytes, encoded: bytes) -> bytes:
    """Replace what the header and the extension area of a TGA file say about alpha: whether there is any."""
    made = bytearray(encoded)
    if source[16] == made[16]:  # bits of a pixel; the next byte says how many of them are alpha
        made[17] = made[17] & 0xF0 | source[17] & 0x0F
    old, new = (int.from_bytes(data[-26:-22], "little") + _ALPHA for data in (source, encoded))
    if source.endswith(END) and encoded.endswith(END) and _ALPHA < old < len(source) - 26:
        made[new] = source[old]
    return bytes(made)


def metadata_names(data: bytes) -> dict[str, bool]:
    return {"developer area": False} if data.endswith(END) and any(data[-22:-18]) else {}
