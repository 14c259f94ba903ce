"""How a job is done: what it may read, how it reports progress, and what it may write."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from beltrami_cli.formats.access import EVERYTHING_INSIDE, Access

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from beltrami_cli.jobs.writing.output import FileSet, Output

    Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Job:
    """How a job is done, besides its parameters.

    Attributes
    ----------
    access : Access
        What may be read, and how much memory may be used.
    progress : callable, optional
        Called with a label of the current part, the work done so far and the total work; may raise to stop.
    overwrite : bool
        Whether the output, and the files beside it that it refers to, may be replaced.
    dry_run : bool
        Compute everything and write nothing.
    format : str or None
        Format to write, if the name of the output does not have its extension: "ply", "obj", "glb", "gltf", "png", ...
    files : FileSet or None
        Only for callers that write further files, such as a report, together with the output.
    """

    access: Access = EVERYTHING_INSIDE
    progress: Progress | None = None
    overwrite: bool = False
    dry_run: bool = False
    format: str | None = None
    files: FileSet | None = None

    def output(self, target: str) -> Output | None:
        """Check where OUTPUT goes; None on a dry run."""
        from beltrami_cli.jobs.writing.output import Output

        return None if self.dry_run else Output(target, overwrite=self.overwrite, files=self.files)

    def access_besides(self, output: Output | None, guarded: Iterable[str]) -> Access:
        """Return the access to files that no output replaces, nor the `guarded` files."""
        if output is None:
            return self.access
        output.files.guard(guarded)
        return output.files.watching(self.access)

    def progress_of(self, label: str) -> Callable[[int, int], None] | None:
        """Return the callback for the progress of one part of the job."""
        return None if self.progress is None else partial(self.progress, label)


PLAIN_JOB = Job()
