"""What was done to a file, as a record that can be written as JSON."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from beltrami_cli.samples.reports import ImageReport, SlotReport, VertexReport

_HEAD = re.compile(rb'\{\n  "input": ".*",\n  "output": ".*",\n  "format": "\w+",\n  "parameters": \{')


@dataclass(frozen=True)
class SmoothReport:
    """What was done to a file; `dataclasses.asdict` gives JSON types.

    Attributes
    ----------
    input, output, format : str
        Where from, where to, and the format written.
    parameters : dict
        The parameters that were asked for; those named in "free" were left to be chosen, and what was chosen is with
        what it was chosen for.
    vertices : VertexReport or None
        For vertex colours, if they were smoothed.
    textures : list of SlotReport
        For the texture slots that were smoothed.
    stages : dict
        "wall" and "cpu" seconds per stage.
    peak_memory : int or None
        Largest resident size of the process in bytes.
    written : list of str
        The files that were written; none on a dry run.
    warnings : list of str
        What the user should know.
    image : ImageReport or None
        For an image, if it was smoothed.
    """

    input: str
    output: str
    format: str
    parameters: dict[str, object]
    vertices: VertexReport | None
    textures: list[SlotReport]
    stages: dict[str, dict[str, float]]
    peak_memory: int | None
    written: list[str]
    warnings: list[str]
    image: ImageReport | None = None


def is_report(head: bytes) -> bool:
    """Return whether a file is a `SmoothReport` as JSON, by its first bytes."""
    return _HEAD.match(head) is not None
