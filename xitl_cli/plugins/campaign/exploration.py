"""Search over several axes for the failing point nearest to the nominal one, by Optuna's ask and tell.

A generator like `bisection.bisect`: it yields batches of places and receives verdicts. Places are shares of each axis'
range, 0 to 1, so that a distance means the same along all of them.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Generator, Sequence
from typing import Any

from sim_core.dataclass import dataclass
from xitl_cli.plugins.campaign.bisection import Bisection, BoundaryFinding, Outcome, bisect
from xitl_cli.plugins.campaign.statistics import Interval, wilson_interval

Place = tuple[float, ...]
_RUNS_AT_NOMINAL = 10  # at least: all further results depend on its verdict
_BEYOND = 1.3  # a bisection ends this factor beyond a failing place, which may lie exactly on the boundary
_CANDIDATES = 5  # nearest failing points to try, because some of few runs may have failed by chance


@dataclass(frozen=True, slots=True, kw_only=True)
class Exploration:
    """Settings of an exploration.

    The batch belongs to the search and not to the cluster: the places are the same for any number of workers.
    """

    nominal: Place
    """Nominal place of the vessel."""
    rate: float
    confidence: float
    runs_per_point: int
    points: int
    """Total number of places."""
    batch: int
    """Number of places per batch."""
    seed: int
    width: float
    """Largest width of the boundary's interval."""
    most_runs: int
    """Limit of runs."""


@dataclass(frozen=True, slots=True)
class PointCount:
    """Runs with a verdict at one place, and the number of passed runs."""

    place: Place
    runs: int
    passed: int

    def interval(self, confidence: float) -> Interval:
        return wilson_interval(self.passed, self.runs, confidence)


@dataclass(frozen=True, slots=True)
class ExplorationFinding:
    """Result of an exploration. `Outcome.FAILS` means that the nominal place fails."""

    outcome: Outcome
    points: tuple[PointCount, ...]
    """All places, the nominal one first."""
    nearest: Place | None
    """Crossing of the boundary on the straight line from nominal to the nearest failing place; None without one."""
    along: BoundaryFinding | None
    """Bisection on that line, in distance from nominal."""
    silent: int
    """Number of runs without a verdict."""


class _Counted:
    """Results of each place, in the order of the requests."""

    def __init__(self) -> None:
        self.points: dict[Place, PointCount] = {}
        self.silent = 0

    def add(self, places: Sequence[Place], answers: Sequence[bool | None]) -> None:
        for place, answer in zip(places, answers, strict=True):
            before = self.points.setdefault(place, PointCount(place, 0, 0))
            if answer is None:
                self.silent += 1
            else:
                self.points[place] = PointCount(place, before.runs + 1, before.passed + answer)

    @property
    def spent(self) -> int:
        return self.silent + sum(point.runs for point in self.points.values())


def explore(search: Exploration) -> Generator[list[Place], Sequence[bool | None], ExplorationFinding]:
    """Yield places. Receive True or False for each run, None for a run without a verdict."""
    counted = _Counted()

    def ended(outcome: Outcome, along: BoundaryFinding | None = None, to: Place | None = None) -> ExplorationFinding:
        nearest = None
        if along is not None and along.estimate is not None and to is not None:
            nearest = toward(search.nominal, to, along.estimate.value / math.dist(search.nominal, to))
        return ExplorationFinding(outcome, tuple(counted.points.values()), nearest, along, counted.silent)

    at_nominal = [search.nominal] * max(2 * search.runs_per_point, _RUNS_AT_NOMINAL)
    counted.add(at_nominal, (yield at_nominal))
    home = counted.points[search.nominal]
    if not home.runs:
        return ended(Outcome.WITHOUT_VERDICT)
    if home.passed / home.runs < search.rate:
        return ended(Outcome.FAILS)
    study = _study(search)
    for begun in range(0, search.points, search.batch):
        size = min(search.batch, search.points - begun)
        if counted.spent + size * search.runs_per_point > search.most_runs:
            break
        trials = [_next_trial(study, len(search.nominal)) for _ in range(size)]
        batch = [place for _, place in trials for _ in range(search.runs_per_point)]
        answers = yield batch
        counted.add(batch, answers)
        for trial, place in trials:
            point = counted.points[place]
            passes = not point.runs or point.passed / point.runs >= search.rate
            trial.set_constraint("fails", 1.0 if passes else -1.0)
            study.tell(trial, math.dist(place, search.nominal))
    failing = [
        point.place for point in counted.points.values() if point.runs and point.passed / point.runs < search.rate
    ]
    failing = [place for place in failing if place != search.nominal]
    for place in sorted(failing, key=lambda failed: (math.dist(failed, search.nominal), failed))[:_CANDIDATES]:
        # A place slightly farther from nominal, within the range of every axis
        shares = [_BEYOND]
        for share, place_share in zip(search.nominal, place, strict=True):
            if place_share != share:
                shares.append(((1.0 if place_share > share else 0.0) - share) / (place_share - share))
        place = tuple(min(1.0, max(0.0, value)) for value in toward(search.nominal, place, max(1.0, min(shares))))
        along = yield from _bisect_toward(search, place, counted)
        if along.outcome in (Outcome.FOUND, Outcome.UNDECIDED) and not along.rising:
            return ended(along.outcome, along, place)
    return ended(Outcome.UNDECIDED if failing else Outcome.PASSES)


def _bisect_toward(
    search: Exploration, place: Place, counted: _Counted
) -> Generator[list[Place], Sequence[bool | None], BoundaryFinding]:
    distance = math.dist(place, search.nominal)
    line = bisect(
        Bisection(
            low=0.0,
            high=distance,
            rate=search.rate,
            confidence=search.confidence,
            width=search.width,
            runs_per_point=max(search.runs_per_point, 5),
            points=3,
            most_runs=max(0, search.most_runs - counted.spent),
        )
    )
    batch = next(line)
    while True:
        places = [toward(search.nominal, place, at / distance) for at in batch]
        answers = yield places
        counted.add(places, answers)
        try:
            batch = line.send(answers)
        except StopIteration as end:
            finding: BoundaryFinding = end.value
            return finding


def toward(start: Place, end: Place, share: float) -> Place:
    """Return the place at a share of the straight line."""
    return tuple(a + share * (b - a) for a, b in zip(start, end, strict=True))


def _study(search: Exploration) -> Any:
    """Return a study that searches near nominal among failing places: distance is the objective, failure the
    constraint.
    """
    import optuna

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    beginning = max(search.points // 4, search.batch)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        sampler = optuna.samplers.TPESampler(
            seed=search.seed, multivariate=True, constant_liar=True, n_startup_trials=beginning
        )
    return optuna.create_study(direction="minimize", sampler=sampler)


def _next_trial(study: Any, axes: int) -> tuple[Any, Place]:
    import optuna

    share = optuna.distributions.FloatDistribution(0.0, 1.0)
    trial = study.ask({str(axis): share for axis in range(axes)})
    return trial, tuple(float(trial.params[str(axis)]) for axis in range(axes))
