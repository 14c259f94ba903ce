"""Fingerprints of documents, by which two files are compared: colours and images, and everything else."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

from beltrami_cli.arrays import Float32s
from beltrami_cli.surface import records


@dataclass(frozen=True)
class Fingerprint:
    """A file with its colours and images separated from everything else."""

    # Everything but colours and images, by place in the file. Placeholders replace these and the names of images, so
    # that files that differ only in colours have equal parts.
    parts: Mapping[str, bytes]
    colours: Mapping[str, Float32s] = field(default_factory=dict)  # full scale 1, shape (n, C)
    images: Mapping[str, records.Texture] = field(default_factory=dict)  # by where they are used
    faults: Sequence[str] = ()  # violations of the format that some readers do not accept


def labelled(files: Mapping[str, str], read: Callable[[str], bytes]) -> dict[str, records.Texture]:
    """Return image files as textures, by where they are used, for a fingerprint."""
    return {
        label: records.Texture(file, file.rpartition("/")[2], partial(read, file))
        for label, file in files.items()
    }
