"""Schedules of iterations, and the search for the one of least estimated error."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import sqrt
from typing import TYPE_CHECKING

from beltrami_cli.flow.risk import Risk, RiskEstimate, State, Step

if TYPE_CHECKING:
    from collections.abc import Callable

# So many iterations in a row that make the estimate worse than it was end a path.
_PATIENCE = 1

# What a schedule must gain for each step in the grid away from the start, as a share of the noise's variance: less is
# chance. Some 0.1 dB of a good result; and more where there are few samples to tell by, over their root.
_LEAST_GAIN, _GAIN_OF_ONE = 5e-4, 0.15


@dataclass(frozen=True)
class Schedule:
    """What is chosen: iterations, some of them regularised, and their parameters.

    Attributes
    ----------
    beta : float
        Of the first iteration, in units of length per unit of colour.
    growth : float
        Of beta, from one iteration to the next.
    t : float
        Time step.
    guided, plain : int
        Iterations with the regularised metric, and after them without.
    """

    beta: float
    growth: float
    t: float
    guided: int
    plain: int

    def step(self, iteration: int) -> Step:
        """Return an iteration, counted from 0."""
        return Step(self.beta * self.growth**iteration, self.t, iteration < self.guided)


@dataclass(frozen=True)
class Grid:
    """The values that each parameter may take, ascending, and where the search starts.

    Attributes
    ----------
    betas, growths, steps : tuple of float
        Values of beta, its growth and t.
    guided : tuple of int
        Numbers of regularised iterations.
    iterations : int or None
        How many iterations there must be; None: as many as pay ...
    most : int
        ... but no more than so many.
    start : tuple of int
        Where in `betas`, `growths`, `steps` and `guided` to start.
    """

    betas: tuple[float, ...]
    growths: tuple[float, ...]
    steps: tuple[float, ...]
    guided: tuple[int, ...]
    iterations: int | None
    most: int
    start: tuple[int, int, int, int]

    def at(self, place: tuple[int, int, int, int], plain: int = 0) -> Schedule:
        """Return the schedule at some place in the grid."""
        beta, growth, step, guided = place
        return Schedule(self.betas[beta], self.growths[growth], self.steps[step], self.guided[guided], plain)

    def beside(
        self, place: tuple[int, int, int, int], axis: int, way: int
    ) -> tuple[int, int, int, int] | None:
        """Return the next place along an axis; None at its end."""
        size = len((self.betas, self.growths, self.steps, self.guided)[axis])
        moved = place[axis] + way
        if not 0 <= moved < size:
            return None
        beta, growth, step, guided = (moved if k == axis else old for k, old in enumerate(place))
        return beta, growth, step, guided


class Search:
    """A descent over a grid of schedules, by an estimate of their error.

    The results on the way to a schedule are results of shorter ones, so these cost nothing more.

    Parameters
    ----------
    estimate : RiskEstimate
        Of the error.
    grid : Grid
        What may be chosen.
    noise : float
        Mean variance of the noise.
    values : int
        Samples times channels, which the estimate is a mean over.
    pause : callable
        Called before every iteration that is tried; may raise to stop.

    Attributes
    ----------
    tried : dict of Schedule to Risk
        All that was estimated.
    """

    def __init__(
        self,
        estimate: RiskEstimate,
        grid: Grid,
        noise: float,
        values: int,
        pause: Callable[[], None] | None = None,
    ) -> None:
        self.tried: dict[Schedule, Risk] = {}
        self._estimate, self._grid, self._pause = estimate, grid, pause
        self._gain = noise * max(_LEAST_GAIN, _GAIN_OF_ONE / sqrt(max(1, values)))
        self._best: dict[tuple[int, int, int, int], tuple[float, Schedule]] = {}
        self._guided_states: dict[Schedule, State] = {}

    def run(self) -> Schedule:
        """Return the best schedule found: along one axis after another, until none gets better."""
        place = self._grid.start
        best, moved = self._path(place), True
        while moved:
            moved = False
            for axis in (0, 1, 3, 2):
                for way in (1, -1):
                    ahead = self._grid.beside(place, axis, way)
                    while ahead is not None and (cost := self._path(ahead)) < best:
                        place, best, moved = ahead, cost, True
                        ahead = self._grid.beside(place, axis, way)
        best, schedule = min(self._best.values(), key=lambda found: found[0])
        if self._grid.iterations is None:
            nothing = replace(schedule, guided=0, plain=0)
            if self._try(nothing, self._estimate.start) < best:
                return nothing
        return schedule

    def _path(self, place: tuple[int, int, int, int]) -> float:
        """Try the schedules at a place, with more and more plain iterations; return the least cost."""
        if place not in self._best:
            away = sum(abs(here - there) for here, there in zip(place, self._grid.start, strict=True))
            least, schedule = self._walk(self._grid.at(place))
            self._best[place] = (least + away * self._gain, schedule)
        return self._best[place][0]

    def _walk(self, schedule: Schedule) -> tuple[float, Schedule]:
        """Iterate until that makes the estimate worse; return the least cost, and after how many it was reached."""
        wanted = self._grid.iterations
        if wanted is not None and schedule.guided > wanted:
            return float("inf"), schedule
        state = self._after_guided(schedule)
        found: list[tuple[float, Schedule]] = []
        while True:
            done = schedule.guided + schedule.plain
            if wanted is None or done == wanted:
                found.append((self._try(schedule, state), schedule))
            best = min(range(len(found)), key=lambda k: found[k][0], default=0)
            if done >= (self._grid.most if wanted is None else wanted) or len(found) > best + 1 + _PATIENCE:
                return found[best]
            state = self._step(state, schedule.step(done))
            schedule = replace(schedule, plain=schedule.plain + 1)

    def _try(self, schedule: Schedule, state: State) -> float:
        self.tried[schedule] = self._estimate.of(state)
        return self.tried[schedule].cost

    def _after_guided(self, schedule: Schedule) -> State:
        """Return the state after the regularised iterations, which longer schedules share."""
        if schedule.guided == 0:
            return self._estimate.start
        # The first iteration is the same whatever comes after it.
        key = replace(schedule, growth=1.0) if schedule.guided == 1 else schedule
        if key not in self._guided_states:
            before = self._after_guided(replace(schedule, guided=schedule.guided - 1))
            self._guided_states[key] = self._step(before, schedule.step(schedule.guided - 1))
        return self._guided_states[key]

    def _step(self, state: State, step: Step) -> State:
        if self._pause is not None:
            self._pause()
        return self._estimate.step(state, step)
