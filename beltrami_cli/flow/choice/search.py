"""Coordinate descent over schedules of iterations, by their estimated error."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

from beltrami_cli.flow.choice.risk import Risk, RiskEstimate, State
from beltrami_cli.flow.manifolds.iteration import Step
from beltrami_cli.flow.parameters import growth_at

# Improvements below this share of the noise variance are due to chance: some 0.1 dB of a good result.
_MIN_IMPROVEMENT = 5e-4


@dataclass(frozen=True)
class Schedule:
    """Beta and its growth, the time step, and the numbers of regularised and of plain iterations."""

    beta: float
    growth: float
    t: float
    regularised: int
    plain: int

    def step(self, iteration: int) -> Step:
        beta = self.beta * growth_at(iteration, self.growth)
        return Step(beta, self.t, iteration < self.regularised)


class Place(NamedTuple):
    """Indices of the values of a schedule among the candidates."""

    beta: int
    growth: int
    regularised: int


@dataclass(frozen=True)
class Candidates:
    """The candidate values of each parameter, ascending, and the starts of the search."""

    betas: tuple[float, ...]
    growths: tuple[float, ...]
    t: float
    regularised: tuple[int, ...]
    iterations: int | None  # exact number; None: up to `max_iterations`
    max_iterations: int
    starts: tuple[Place, ...]
    least_gain: float = 0.0  # a path ends with an iteration that gains less than this share of the error

    def at(self, place: Place) -> Schedule:
        beta, growth, regularised = place
        return Schedule(self.betas[beta], self.growths[growth], self.t, self.regularised[regularised], 0)

    def neighbour(self, place: Place, axis: int, way: int) -> Place | None:
        """Return the next place along an axis, or None at its end."""
        size = len((self.betas, self.growths, self.regularised)[axis])
        if not 0 <= place[axis] + way < size:
            return None
        return Place(*(at + way if k == axis else at for k, at in enumerate(place)))


class Search:
    """Coordinate descent over candidate schedules; `tick` is called before each iteration, and may raise to stop."""

    def __init__(
        self,
        estimate: RiskEstimate,
        candidates: Candidates,
        weight: float = 1.0,
        tick: Callable[[], None] | None = None,
    ) -> None:
        self.tried: dict[Schedule, Risk] = {}
        self._estimate, self._candidates, self._tick = estimate, candidates, tick
        self._gain, self._weight = _MIN_IMPROVEMENT * estimate.mean_variance, weight
        self._least: dict[Place, float] = {}
        self._regularised_states: dict[Schedule, State] = {}

    def run(self) -> Schedule:
        """Return the schedule with the least weighted risk."""
        if self._candidates.iterations is None:
            self._try(
                replace(self._candidates.at(self._candidates.starts[0]), regularised=0), self._estimate.start
            )
        least = float("inf")
        for start in self._candidates.starts:
            # Skip starts no better than the result of an earlier descent.
            if self._path(start) < least - self._gain:
                least = self._descend(start)
        # Every weight chooses from the same schedules, so that a larger one never chooses a gentler one.
        return min(self.tried, key=lambda schedule: self.tried[schedule].weighted(self._weight))

    def _descend(self, place: Place) -> float:
        """Move along one axis after another until none improves; return the least risk."""
        least, moved = self._path(place), True
        while moved:
            moved = False
            for axis in (0, 1, 2):
                for way in (1, -1):
                    ahead = self._candidates.neighbour(place, axis, way)
                    while ahead is not None and self._path(ahead) < least - self._gain:
                        place, least, moved = ahead, self._path(ahead), True
                        ahead = self._candidates.neighbour(place, axis, way)
        return least

    def _path(self, place: Place) -> float:
        """Try a place with more and more plain iterations; return the least risk."""
        if place not in self._least:
            self._least[place] = self._walk(self._candidates.at(place))
        return self._least[place]

    def _walk(self, schedule: Schedule) -> float:
        exact = self._candidates.iterations
        if exact is not None and schedule.regularised > exact:
            return float("inf")
        state = self._after_regularised(schedule)
        risks: list[float] = []
        while True:
            done = schedule.regularised + schedule.plain
            if exact is None or done == exact:
                risks.append(self._try(schedule, state))
            if done >= (self._candidates.max_iterations if exact is None else exact) or self._ends(risks):
                return min(risks)
            state = self._step(state, schedule.step(done))
            schedule = replace(schedule, plain=schedule.plain + 1)

    def _ends(self, risks: list[float]) -> bool:
        return len(risks) > 1 and risks[-2] - risks[-1] < self._candidates.least_gain * abs(risks[-2])

    def _try(self, schedule: Schedule, state: State) -> float:
        self.tried[schedule] = self._estimate.risk(state)
        return self.tried[schedule].value

    def _after_regularised(self, schedule: Schedule) -> State:
        """Return the state after the regularised iterations, which longer schedules share."""
        if schedule.regularised == 0:
            return self._estimate.start
        # The first iteration is the same whatever comes after it.
        key = replace(schedule, growth=1.0) if schedule.regularised == 1 else schedule
        if key not in self._regularised_states:
            before = self._after_regularised(replace(schedule, regularised=schedule.regularised - 1))
            self._regularised_states[key] = self._step(before, schedule.step(schedule.regularised - 1))
        return self._regularised_states[key]

    def _step(self, state: State, step: Step) -> State:
        if self._tick is not None:
            self._tick()
        return self._estimate.step(state, step)
