"""One file of a batch: the task and the outcome."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import time
from dataclasses import dataclass, field
from importlib.metadata import version
from typing import TYPE_CHECKING, Any, Literal

from beltrami_cli.jobs.settings import BakeSettings
from beltrami_cli.layers.reported_noise import noise_size

if TYPE_CHECKING:
    from beltrami_cli.layers.settings import SmoothSettings


Status = Literal["started", "done", "skipped", "uncoloured", "failed", "not started"]


@dataclass(frozen=True)
class Item:
    """A file to be smoothed; it can be sent to another process."""

    source: str
    target: str
    settings: SmoothSettings
    unwrap: BakeSettings | None = None
    outside: bool = False  # whether files outside the model's folder may be read
    overwrite: bool = False
    skip_uncoloured: bool = False  # whether a file without the selected colours is skipped instead of failing
    columns: tuple[str, ...] = ()  # names of the columns of points in text files
    # Whether an interrupted attempt may have written files; existing ones must then be equal.
    is_retry: bool = False

    @property
    def parameters_sha256(self) -> str:
        """Hash of the settings and the program version, on which the result depends besides the files."""
        settings = dataclasses.asdict(self.settings)
        del settings["kernel"]["threads"]  # the result is the same for any number
        unwrap = None if self.unwrap is None else dataclasses.asdict(self.unwrap)
        everything = [version("beltrami-cli"), settings, unwrap, self.outside]
        if self.columns:
            everything.append({"columns": self.columns})
        return hashlib.sha256(json.dumps(everything, sort_keys=True).encode()).hexdigest()


@dataclass(frozen=True)
class Outcome:
    """The outcome of one file; as JSON it is a line of the record."""

    input: str
    output: str
    status: Status  # "skipped": the result of an earlier run is still valid
    parameters_sha256: str = ""
    time: float = field(default_factory=time.time)  # of writing this outcome, in seconds since 1970
    seconds: float = 0.0
    error: str = ""
    exit_code: int = 0  # the same as that of `beltrami smooth` for this file
    read: dict[str, str] = field(default_factory=dict)  # SHA-256 of every file that was read, by its name
    written: dict[str, str] = field(default_factory=dict)
    report: dict[str, Any] | None = None  # of `beltrami smooth`

    def figures(self) -> tuple[float, float, bool] | None:
        """Return the strongest noise, the largest mean change, and whether no iterations were chosen."""
        report = self.report or {}
        parts = [
            each
            for each in (report.get("vertices"), report.get("image"), *report.get("textures", ()))
            if each
        ]
        if self.status == "failed" or not parts:
            return None
        noise = max(map(noise_size, parts))
        is_chosen = "iterations" in report.get("parameters", {}).get("free", ())
        is_left = is_chosen and not any(part["iterations"] for part in parts)
        return noise, max(float(part["change"]["mean"]) for part in parts), is_left


@dataclass(frozen=True)
class Attempt:
    """The answer of a worker: the outcome, whether more memory might help, and the traceback of an unexpected error."""

    outcome: Outcome
    wants_memory: bool = False
    traceback: str = ""
    chunks: int = 0  # most chunks of a surface of the file; 0: no surface was cut


def outcome_of(item: Item, status: Status, **values: Any) -> Outcome:
    return Outcome(item.source, item.target, status, parameters_sha256=item.parameters_sha256, **values)


def failed(item: Item, error: str, exit_code: int, seconds: float = 0.0) -> Outcome:
    return outcome_of(item, "failed", seconds=round(seconds, 3), error=error, exit_code=exit_code)
