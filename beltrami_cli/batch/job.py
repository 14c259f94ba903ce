"""One file of a batch: what is to be done, and what came of it."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import time
from dataclasses import dataclass, field
from importlib.metadata import version
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from beltrami_cli.samples.settings.bake import BakeSettings
    from beltrami_cli.samples.settings.smooth import SmoothSettings

Status = Literal["started", "done", "skipped", "failed", "not started"]


@dataclass(frozen=True)
class Job:
    """What is to be done with one file; it can be sent to another process.

    Attributes
    ----------
    source, target : str
        Where from, where to.
    settings : SmoothSettings
        What smoothing is told.
    unwrap : BakeSettings or None
        How a new texture is made; None: none is wanted.
    outside : bool
        Whether files are followed that the model names beyond its own folder.
    overwrite : bool
        Whether existing files may be replaced.
    """

    source: str
    target: str
    settings: SmoothSettings
    unwrap: BakeSettings | None = None
    outside: bool = False
    overwrite: bool = False

    @property
    def parameters(self) -> str:
        """Hash of all that the result depends on besides the files: the settings and the version of this program."""
        settings = dataclasses.asdict(self.settings)
        del settings["kernel"]["threads"]  # the result is the same for any number
        unwrap = None if self.unwrap is None else dataclasses.asdict(self.unwrap)
        told = [version("beltrami-cli"), settings, unwrap, self.outside]
        return hashlib.sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()


@dataclass(frozen=True)
class Outcome:
    """What came of one file; as JSON it is a line of the report.

    Attributes
    ----------
    input, output : str
        Where from, where to.
    status : {"started", "done", "skipped", "failed", "not started"}
        What was done; "skipped": what an earlier run did still holds.
    parameters_sha256 : str
        See `Job.parameters`.
    time : float
        When it was written, in seconds since 1970.
    seconds : float
        How long it took.
    error : str
        What went wrong.
    exit_code : int
        What `smooth` would have exited with.
    read, written : dict of str to str
        SHA-256 of every file that was read, and that was written.
    report : dict or None
        The report of `smooth`.
    """

    input: str
    output: str
    status: Status
    parameters_sha256: str = ""
    time: float = field(default_factory=time.time)
    seconds: float = 0.0
    error: str = ""
    exit_code: int = 0
    read: dict[str, str] = field(default_factory=dict)
    written: dict[str, str] = field(default_factory=dict)
    report: dict[str, object] | None = None


@dataclass(frozen=True)
class Attempt:
    """What a worker answers: the outcome, whether more memory might help, and where an unforeseen error arose."""

    outcome: Outcome
    wants_memory: bool = False
    traceback: str = ""


def outcome_of(job: Job, status: Status, **told: Any) -> Outcome:
    """Return what came of a job."""
    return Outcome(job.source, job.target, status, parameters_sha256=job.parameters, **told)


def failed(job: Job, error: str, exit_code: int, seconds: float = 0.0) -> Outcome:
    """Return the outcome of a job that failed."""
    return outcome_of(job, "failed", seconds=round(seconds, 3), error=error, exit_code=exit_code)
