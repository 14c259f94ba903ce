"""TIFF and EXR files of the tests' own, written and read byte by byte, without any code of the package."""

import struct

CODES = {1: "B", 2: "B", 3: "H", 4: "I", 5: "II", 6: "b", 7: "B", 8: "h", 9: "i", 10: "ii", 11: "f", 12: "d", 13: "I",
         16: "Q", 17: "q", 18: "Q"}  # fmt: skip
SIZES = {kind: struct.calcsize("=" + code) for kind, code in CODES.items()}
POINTERS = (330, 34665, 34853, 40965)
# Tags that say how pixels are stored, by TIFF 6.0: sizes, types, compression, strips, tiles, palette.
STRUCTURE = {256, 257, 258, 259, 262, 266, 273, 277, 278, 279, 284, 317, 320, 322, 323, 324, 325, 338, 339}


def tiff_file(pixels, tags, order="<", *, is_big=False):
    """Return an uncompressed TIFF file of 8 bits; a tag is its type and its numbers, or those of a directory."""
    height, width, channels = pixels.shape
    start = 16 if is_big else 8
    data = bytearray(start) + pixels.tobytes()
    basic = {
        256: (4, [width]), 257: (4, [height]), 258: (3, [8] * channels), 259: (3, [1]),
        262: (3, [2 if channels >= 3 else 1]), 273: (4, [start]), 277: (3, [channels]), 278: (4, [height]),
        279: (4, [pixels.nbytes]),
    }  # fmt: skip
    at = _directory(data, {**basic, **tags}, order, is_big)
    data[:4] = {"<": b"II", ">": b"MM"}[order] + struct.pack(f"{order}H", 43 if is_big else 42)
    if is_big:
        struct.pack_into(f"{order}HHQ", data, 4, 8, 0, at)
    else:
        struct.pack_into(f"{order}I", data, 4, at)
    return bytes(data)


def _directory(data, tags, order, is_big):
    address, room = ("Q", 8) if is_big else ("I", 4)
    entries = b""
    for tag, (kind, values) in sorted(tags.items()):
        if isinstance(values, dict):
            values = [_directory(data, values, order, is_big)]
        code = CODES.get(kind, "B")
        packed = struct.pack(f"{order}{len(values) // len(code) * code}", *values)
        count = len(values) // len(code)
        if len(packed) > room:
            data += bytes(-len(data) % 8)
            packed, at = struct.pack(f"{order}{address}", len(data)), packed
            data += at
        entries += struct.pack(f"{order}HH{address}", tag, kind, count) + packed.ljust(room, b"\0")
    data += bytes(-len(data) % 8)
    place = len(data)
    data += struct.pack(f"{order}{'Q' if is_big else 'H'}", len(tags)) + entries + bytes(room)
    return place


def tiff_tags(data):
    """Return the type and the numbers of every tag of the first image; of a directory, its tags."""
    order = "<" if data[:2] == b"II" else ">"
    is_big = data[2:4] in (b"+\0", b"\0+")
    address = f"{order}{'Q' if is_big else 'I'}"

    def directory(at):
        (count,) = struct.unpack_from(f"{order}{'Q' if is_big else 'H'}", data, at)
        at += 8 if is_big else 2
        room, found = struct.calcsize(address), {}
        for place in range(at, at + count * (4 + 2 * room), 4 + 2 * room):
            tag, kind = struct.unpack_from(f"{order}HH", data, place)
            (number,) = struct.unpack_from(address, data, place + 4)
            inside = place + 4 + room
            if number * SIZES[kind] > room:
                (inside,) = struct.unpack_from(address, data, inside)
            values = [*struct.unpack_from(f"{order}{number * CODES[kind]}", data, inside)]
            is_pointer = tag in POINTERS or kind in (13, 18)
            found[tag] = [directory(value) for value in values] if is_pointer else (kind, values)
        return found

    return directory(struct.unpack_from(address, data, 8 if is_big else 4)[0])


def described(data):
    """Return the tags of the first image that do not say how its pixels are stored."""
    return {tag: value for tag, value in tiff_tags(data).items() if tag not in STRUCTURE}


def exr_file(channels, attributes=None):
    """Return an EXR file of one part without compression; each channel is an array (H, W) of float16 or float32."""
    height, width = next(iter(channels.values())).shape
    kinds = {"float16": 1, "float32": 2}
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    listed = b"".join(
        name.encode() + b"\0" + struct.pack("<iB3xii", kinds[str(plane.dtype)], 0, 1, 1)
        for name, plane in sorted(channels.items())
    )
    needed = {
        "channels": ("chlist", listed + b"\0"), "compression": ("compression", b"\0"), "dataWindow": ("box2i", window),
        "displayWindow": ("box2i", window), "lineOrder": ("lineOrder", b"\0"),
        "pixelAspectRatio": ("float", struct.pack("<f", 1)), "screenWindowCenter": ("v2f", struct.pack("<ff", 0, 0)),
        "screenWindowWidth": ("float", struct.pack("<f", 1)),
    }  # fmt: skip
    every = {**needed, **(attributes or {})}
    is_long = any(len(name) > 31 for name in (*every, *channels))
    head = b"v/1\x01" + struct.pack("<I", 2 | (0x400 if is_long else 0))
    for name, (kind, value) in every.items():
        head += name.encode("latin-1") + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(value)) + value
    head += b"\0"
    rows = [
        b"".join(
            channels[name][row].astype(channels[name].dtype.newbyteorder("<")).tobytes()
            for name in sorted(channels)
        )
        for row in range(height)
    ]
    first = len(head) + 8 * height
    places = [first + row * (8 + len(rows[0])) for row in range(height)]
    chunks = (struct.pack("<ii", row, len(pixels)) + pixels for row, pixels in enumerate(rows))
    return head + struct.pack(f"<{height}Q", *places) + b"".join(chunks)


def exr_attributes(data):
    """Return the types and values of the attributes of a file of one part."""
    at, found = 8, {}
    while data[at]:
        name, kind, _ = data[at:].split(b"\0", 2)
        at += len(name) + len(kind) + 2
        (size,) = struct.unpack_from("<i", data, at)
        found[name.decode("latin-1")] = kind.decode(), data[at + 4 : at + 4 + size]
        at += 4 + size
    return found
