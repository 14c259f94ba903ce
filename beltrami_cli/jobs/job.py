"""How a job is done: what it may read and replace, and its progress callback."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from beltrami_cli.formats.files.access import DEFAULT_ACCESS, Access
from beltrami_cli.jobs.progress import Expected, PhaseProgress, Progress, Work

if TYPE_CHECKING:
    from beltrami_cli.flow.chunks import Chunking
    from beltrami_cli.formats.document import Document
    from beltrami_cli.jobs.writing.file_set import FileSet


@dataclass(frozen=True)
class Job:
    """How a job is done.

    Attributes
    ----------
    access : Access
        What may be read, and how much memory may be used.
    progress : callable, optional
        Called with a label of the current part, the work done so far and the total work; may raise to stop.
    overwrite : bool
        Whether the output, and the sidecar files that it refers to, may be replaced.
    dry_run : bool
        Compute everything and write nothing.
    format : str or None
        Format to write, if the name of the output does not have its extension: "ply", "obj", "glb", "gltf", "png", ...
    files : FileSet or None
        Only for callers that write further files, such as a report, together with the output.
    check : callable, optional
        Only for callers that do more with the document: called with it before anything is computed; may raise.
    chunking : Chunking, optional
        Only for batches: into how many chunks surfaces are cut, and who works on them.
    """

    access: Access = DEFAULT_ACCESS
    progress: Progress | None = None
    overwrite: bool = False
    dry_run: bool = False
    format: str | None = None
    files: FileSet | None = None
    check: Callable[[Document], None] | None = None
    chunking: Chunking | None = None

    def check_document(self, document: Document) -> None:
        if self.check is not None:
            self.check(document)

    def expect(self, phases: Iterable[Expected]) -> None:
        if isinstance(self.progress, Work):
            self.progress.expect(phases)

    def begin(self, label: str) -> None:
        if self.progress is not None:
            self.progress(label, 0, 1)

    def progress_of(self, label: str) -> PhaseProgress | None:
        return None if self.progress is None else partial(self.progress, label)


PLAIN_JOB = Job()
