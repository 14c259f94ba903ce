"""What a smoothing job is told, with the defaults; light enough for the command line to import."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import get_args

from beltrami_cli.errors import UsageError
from beltrami_cli.flow.parameters import KernelParameters, Space

OUTPUT_FORMATS = ("ply", "obj", "glb", "gltf")


@dataclass(frozen=True)
class SmoothSettings:
    """What `smooth` is told about the colours, besides the kernel.

    Attributes
    ----------
    kernel : KernelParameters
        Iterations, time step, beta and the rest.
    space : {"srgb", "linear", "oklab", "data"}
        What colour distances and averages are taken in; "data" takes the stored numbers as they are.
    channels : tuple of str or None
        Names of the channels to smooth, which alone enter the metric; None: all. Alpha is always kept.

    Raises
    ------
    UsageError
        If `space` is not one of the four, or contradicts `channels`.
    """

    kernel: KernelParameters = field(default_factory=KernelParameters)
    space: Space = "srgb"
    channels: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        if self.space not in get_args(Space):
            raise UsageError(f"space is {self.space}, but must be {', '.join(get_args(Space))}")
        if self.space == "oklab" and self.channels is not None:
            raise UsageError("the space oklab mixes the channels, so --channels cannot choose among them")


DEFAULTS = SmoothSettings()
