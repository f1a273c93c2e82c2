"""Search over several axes for the failing point that is nearest to the nominal one, by Optuna's ask and tell.

A generator like `bisection.bisect`: batches of places out, verdicts in. Places are shares of each axis' range, 0 to 1,
so that a distance means the same along all of them.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from typing import Any

from xitl_cli.plugins.campaign.bisection import Bisection, BoundaryFinding, Outcome, bisect
from xitl_cli.plugins.campaign.statistics import Interval, wilson_interval

Place = tuple[float, ...]
_RUNS_AT_NOMINAL = 10  # at least: whether it passes is what the rest stands on
_BEYOND = 1.3  # how far behind a failing place a bisection ends, as it may lie just on the boundary
_CANDIDATES = 5  # failing points that are tried from the nearest on, as one of few runs may have failed by chance


@dataclass(frozen=True, slots=True, kw_only=True)
class Exploration:
    """nominal: where the vessel is at home. points: places in all, of `runs_per_point` runs, `batch` at a time.

    width: of the boundary's interval, at most. most_runs: where it gives up.

    The batch is part of the search and not of the cluster: with any number of workers the places are the same.
    """

    nominal: Place
    rate: float
    confidence: float
    runs_per_point: int
    points: int
    batch: int
    seed: int
    width: float
    most_runs: int


@dataclass(frozen=True, slots=True)
class PointCount:
    """Runs with a verdict at one place, and how many of them passed."""

    place: Place
    runs: int
    passed: int

    def interval(self, confidence: float) -> Interval:
        return wilson_interval(self.passed, self.runs, confidence)


@dataclass(frozen=True, slots=True)
class ExplorationFinding:
    """nearest: where the straight way from nominal to the nearest failing place crosses the boundary; None without one.

    along: the bisection on that way, in distance from nominal. points: all places, that of nominal first. An outcome of
    `Outcome.FAILS` means that the nominal place itself does.
    """

    outcome: Outcome
    points: tuple[PointCount, ...]
    nearest: Place | None
    along: BoundaryFinding | None
    silent: int


class _Counted:
    """What came of each place, in the order in which they were asked for."""

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
    """Yields places, is sent whether each run passed, None for one without a verdict."""
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
    for asked in range(0, search.points, search.batch):
        many = min(search.batch, search.points - asked)
        if counted.spent + many * search.runs_per_point > search.most_runs:
            break
        trials = [_asked(study, len(search.nominal)) for _ in range(many)]
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
    for place in sorted(failing, key=lambda one: (math.dist(one, search.nominal), one))[:_CANDIDATES]:
        place = _beyond(search.nominal, place)
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
            found: BoundaryFinding = end.value
            return found


def _beyond(nominal: Place, place: Place) -> Place:
    """Somewhat farther from nominal, within the range of every axis."""
    shares = [_BEYOND]
    for home, there in zip(nominal, place, strict=True):
        if there != home:
            shares.append(((1.0 if there > home else 0.0) - home) / (there - home))
    return tuple(min(1.0, max(0.0, value)) for value in toward(nominal, place, max(1.0, min(shares))))


def toward(start: Place, end: Place, share: float) -> Place:
    """The place at `share` of the straight way."""
    return tuple(a + share * (b - a) for a, b in zip(start, end, strict=True))


def _study(search: Exploration) -> Any:
    """Nearest to nominal among those that fail: distance is the objective, failing the constraint."""
    import optuna

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    beginning = max(search.points // 4, search.batch)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        sampler = optuna.samplers.TPESampler(
            seed=search.seed, multivariate=True, constant_liar=True, n_startup_trials=beginning
        )
    return optuna.create_study(direction="minimize", sampler=sampler)


def _asked(study: Any, axes: int) -> tuple[Any, Place]:
    import optuna

    share = optuna.distributions.FloatDistribution(0.0, 1.0)
    trial = study.ask({str(axis): share for axis in range(axes)})
    return trial, tuple(float(trial.params[str(axis)]) for axis in range(axes))
