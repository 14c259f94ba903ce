"""The bar that shows on a terminal how far a command is: one for all that it does, see `jobs/progress.py`."""

from __future__ import annotations

from collections.abc import Iterable

from rich.console import Console, RenderableType
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn

from beltrami_cli.errors import one_line
from beltrami_cli.jobs.progress import Work


class ProgressBar(Progress):
    """Shows the state of some work, which is asked for ten times a second."""

    def __init__(self, work: Work) -> None:
        self._work = work
        # Names of files may have brackets.
        columns = (
            TextColumn("{task.description}", markup=False), BarColumn(), TaskProgressColumn(),
            TextColumn("{task.fields[left]}"),
        )  # fmt: skip
        super().__init__(*columns, console=Console(stderr=True), transient=True)
        self._task = self.add_task("starting", total=1.0, left="")

    def get_renderables(self) -> Iterable[RenderableType]:
        if self.task_ids:
            state = self._work.state()
            label, left = one_line(state.label) or "starting", _left(state.seconds_left)
            self.update(self._task, description=label, completed=state.share, left=left)
        yield from super().get_renderables()


def _left(seconds: float | None) -> str:
    if seconds is None:
        return ""
    if seconds < 90:
        return f"{seconds:.0f} s left"
    return f"{seconds / 60:.0f} min left" if seconds < 5400 else f"{seconds / 3600:.1f} h left"
