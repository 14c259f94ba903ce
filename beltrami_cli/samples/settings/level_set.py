"""What smoothing on level sets is told, with the defaults; light enough for the command line to import."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

from beltrami_cli.errors import UsageError

Inside = Literal["below", "above"]
# Rows and columns of the marching cubes are counted in 32 bits.
MOST_VOXELS = 1 << 31


@dataclass(frozen=True)
class LevelSetSettings:
    """The surface in a volume, and its colours.

    Attributes
    ----------
    level : float or None
        Value on the surface. None: as the file says, or 0.
    inside : {"below", "above"}
        Which values are inside: below the level, as for signed distances, or above it, as for densities. Triangles
        face outwards.
    colours : str or None
        Path of a file with the colours: a volume, an archive of points, or a mesh or cloud with vertex colours near
        the surface. None: they are in the volume's own file.
    max_voxels : int
        Larger grids are refused before they are read.

    Raises
    ------
    UsageError
        If a value is out of its range.
    """

    level: float | None = None
    inside: Inside = "below"
    colours: str | None = None
    max_voxels: int = 1 << 28

    def __post_init__(self) -> None:
        if self.level is not None and not math.isfinite(self.level):
            raise UsageError(f"level is {self.level}, but must be a finite number")
        if self.inside not in get_args(Inside):
            raise UsageError(f"inside is {self.inside}, but must be {' or '.join(get_args(Inside))}")
        if not 8 <= self.max_voxels <= MOST_VOXELS:
            raise UsageError(f"max_voxels is {self.max_voxels}, but must be between 8 and {MOST_VOXELS}")

    @property
    def given(self) -> tuple[str, ...]:
        """Return the options that are not as by default, for messages."""
        return tuple(
            "--" + name.replace("_", "-")
            for name in ("level", "inside", "colours", "max_voxels")
            if getattr(self, name) != getattr(LevelSetSettings, name)
        )
