"""The interface of pools of workers, which may die: processes of this machine, this process, or a Dask cluster."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from typing import Any

Task = Callable[..., Any]  # called with the arguments that it was started with, and a progress


@dataclass(frozen=True)
class Advance:
    """Progress of a task."""

    label: str
    done: float
    total: float


@dataclass(frozen=True)
class Lost:
    """The result of a task whose worker died or failed: the cause, in words."""

    cause: str
    wants_memory: bool = False  # whether more memory might help


class Pool(ABC):
    """Workers for tasks."""

    @property
    @abstractmethod
    def is_full(self) -> bool:
        """Whether it takes no more tasks at present."""

    @abstractmethod
    def start(self, key: int, task: Task, *arguments: Any, part: Callable[[], Any] | None = None) -> None:
        """Start a task; `part` returns a large first argument, which workers keep for tasks with the same key."""

    @abstractmethod
    def events(self) -> Iterator[tuple[int, Any]]:
        """Wait for a while, and yield keys of tasks, each with an `Advance`, a `Lost`, or its result."""

    @abstractmethod
    def give_up(self) -> None:
        """Cancel the running tasks."""

    def kept(self) -> Collection[int]:
        """Return the keys of the parts that the next worker has, if that is known."""
        return ()

    def forget(self) -> None:
        """Make workers drop the parts that they keep, if they keep any."""
        return

    def close(self) -> None:
        """End the workers, after they have cleaned up."""
        self.give_up()
