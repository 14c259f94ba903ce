"""Sidecar files in OUTPUT's folder: the existing OUTPUT's may be replaced, other models' may not."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import cached_property
from pathlib import Path


class SidecarNames:
    """The names of sidecar files in a folder: which the existing OUTPUT refers to, and which are taken.

    `read` reads the names of the existing OUTPUT; `read_first`, if given, does so the first time. Later another run may
    have replaced it.
    """

    def __init__(
        self,
        folder: Path | None,
        read: Callable[[], frozenset[str]],
        read_first: Callable[[], frozenset[str]] | None = None,
    ) -> None:
        self._folder, self.read, self._read_first = folder, read, read_first or read
        self.taken = dict[str, None]()  # in the order in which they were asked for

    @cached_property
    def before(self) -> frozenset[str]:
        return self._read_first()

    def note_if_taken(self, name: str) -> bool:
        """Whether the folder has a file of that name that another model may need; it is noted in `taken`."""
        is_taken = self._exists(name) and name not in self.before
        if is_taken:
            self.taken[name] = None
        return is_taken

    def replaces(self, name: str) -> bool:
        """Whether there is a file of that name, which the existing OUTPUT refers to."""
        return self._exists(name) and name in self.before

    def _exists(self, name: str) -> bool:
        return self._folder is not None and os.path.lexists(self._folder / name)


NO_SIDECARS = SidecarNames(None, frozenset)
