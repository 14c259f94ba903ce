"""An image whose temporary file is cut off is refused, whatever its encoder says, and its old file stays."""

import contextlib
import errno
import os
import resource
import signal
from pathlib import Path

import numpy as np
import pytest

from beltrami_cli.errors import OutputError
from beltrami_cli.formats.image.decoded_image import new_image
from beltrami_cli.formats.image.file_formats import FORMATS
from beltrami_cli.formats.image.reading import read_image
from beltrami_cli.formats.image.writing import write_image

NOISE = np.random.default_rng(1).integers(1, 256, (40, 48, 3), np.uint8)
SUFFIXES = [traits.suffixes[0] for traits in FORMATS.values() if traits.writable and 3 in traits.channels]
WITHOUT_FILES = (".ktx2", ".avif")  # encoded and decoded in memory alone
SHARES = (0, 0.01, 0.2, 0.5, 0.8, 0.97, 1)  # of the length of the file; of all of it the last byte is cut off


@contextlib.contextmanager
def files_of_at_most(size):
    """Let no file of this process, also in memory, become longer, as on a full disk."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, before)


@pytest.mark.parametrize("in_memory", [True, False])
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_an_image_that_is_cut_off_is_refused(suffix, in_memory, monkeypatch):
    if not in_memory:
        monkeypatch.delattr(os, "memfd_create", raising=False)
    image = new_image(NOISE, "skin.png")
    whole = write_image(image, NOISE, suffix=suffix).data
    own = read_image(whole, f"skin{suffix}")
    for convert, source in ((suffix, image), (None, own)):
        pixels = source.pixels[::-1].copy()
        expected = write_image(source, pixels, suffix=convert).data
        outcomes = []
        for share in SHARES:
            made = None
            with files_of_at_most(max(0, int(share * len(expected)) - 1)), contextlib.suppress(OutputError):
                made = write_image(source, pixels, suffix=convert).data
            outcomes.append(made)
        assert all(each in (None, expected) for each in outcomes), outcomes
        assert (outcomes[0] is None) == (suffix not in WITHOUT_FILES)


def test_a_temporary_file_that_cannot_be_read_names_the_picture(monkeypatch):
    def fail(path):
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr(Path, "read_bytes", fail)
    with pytest.raises(OutputError, match=r"skin\.png: .* cannot be read back"):
        write_image(new_image(NOISE, "skin.png"), NOISE)
