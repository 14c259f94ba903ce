"""Members of archives that hold more than they announce."""

import contextlib
import io
import struct
import tracemalloc
import zipfile
import zlib

import numpy as np
import pytest

from beltrami_cli.errors import InputError
from beltrami_cli.formats.archives import NpzArchive

HELD, ANNOUNCED = 25_165_937, 100


def archive_with_a_longer_member(checksum):
    """Write an archive of an array and of zeros, of which it announces too few."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        with archive.open("points.npy", "w") as file:
            np.save(file, np.zeros((4, 3)))
        archive.writestr("zeros.bin", bytes(HELD))
    # Sizes stand after checksums, in headers and in the directory: PKWARE's APPNOTE.TXT, section 4.3.
    was = struct.pack("<I", HELD)
    assert buffer.getvalue().count(was) == 2
    found = struct.pack("<I", zlib.crc32(bytes(HELD)))
    return (
        buffer.getvalue()
        .replace(was, struct.pack("<I", ANNOUNCED))
        .replace(found, struct.pack("<I", checksum))
    )


@pytest.mark.parametrize("checksum", [zlib.crc32(bytes(HELD)), zlib.crc32(bytes(ANNOUNCED))])
def test_of_a_member_no_more_is_unpacked_than_it_announces(checksum):
    archive = NpzArchive(archive_with_a_longer_member(checksum), "points.npz")
    tracemalloc.start()
    with contextlib.suppress(InputError):  # for its checksum
        assert len(archive.members()["zeros.bin"]) == ANNOUNCED
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < HELD / 8
