"""Searches of a plan: execution with new runs, or evaluation from a table of results."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from typing import Any

from sim_core.dataclass import dataclass
from xitl_cli.plugins.campaign.axes import AxisValue, RunPoint
from xitl_cli.plugins.campaign.bisection import Bisection, BoundaryFinding, bisect
from xitl_cli.plugins.campaign.execution import RAN
from xitl_cli.plugins.campaign.exploration import Exploration, ExplorationFinding, explore
from xitl_cli.plugins.campaign.search_spec import MOST_RUNS_ONE_AXIS, MOST_RUNS_SEVERAL, Search

Row = Mapping[str, Any]
Submit = Callable[[Sequence[RunPoint]], Iterator[Row]]

_POINTS_ONE_AXIS, _POINTS_SEVERAL = 5, 96
_RUNS_ONE_AXIS, _RUNS_SEVERAL = 10, 3
_WIDTH_SHARE = 0.05


@dataclass(frozen=True, slots=True)
class SearchFinding:
    """Finding of one group."""

    group: Mapping[str, AxisValue]
    """Values of the axes that are not searched."""
    found: BoundaryFinding | ExplorationFinding | None
    """Result of the search; None while runs are missing."""


class MissingRunError(LookupError):
    """A table lacks a run that a search requests."""


def carry_out(search: Search, submit: Submit) -> list[SearchFinding]:
    """Request points, round by round and for all groups at once, until every group has its finding.

    The verdicts alone determine the requested points, with their numbers and seeds. Failed executions do not count.
    """
    groups = [_Group(search, group) for group in search.groups]
    number = 0
    while live := [group for group in groups if group.batch]:
        points: list[RunPoint] = []
        for group in live:
            points += group.requested(number + len(points) + 1)
        number += len(points)
        passed = {row["number"]: verdict(row) for row in submit(points)}
        answers = iter([passed.get(point.number) for point in points])
        for group in live:
            group.answer(answers)
    return [SearchFinding(group.values, group.found) for group in groups]


def first_points(search: Search) -> Iterator[RunPoint]:
    """Yield the points of the first round, before any result is known."""
    number = 1
    for group in search.groups:
        for point in _Group(search, group).requested(number):
            yield point
            number += 1


def verdict(row: Row) -> bool | None:
    """Return True if a run passed; None if its execution failed, which gives no information about the vessel."""
    return bool(row.get("passed")) if row.get("status") in RAN else None


def evaluate(search: Search, rows: Iterable[Row]) -> list[SearchFinding]:
    """Evaluate the search from a table. Groups with missing runs have no finding."""
    by_number = {row["number"]: row for row in rows}

    def recorded(points: Sequence[RunPoint]) -> Iterator[Row]:
        for point in points:
            if point.number not in by_number:
                raise MissingRunError(point.number)
            yield by_number[point.number]

    try:
        return carry_out(search, recorded)
    except MissingRunError:
        return [SearchFinding(group, None) for group in search.groups]


class _Group:
    """The running search of one group."""

    def __init__(self, search: Search, values: Mapping[str, AxisValue]) -> None:
        self.values = values
        self.found: BoundaryFinding | ExplorationFinding | None = None
        self._ranges = search.ranges
        self._next_seed = search.first_seed
        self._search: Generator[list[Any], Any, Any] = (
            bisect(bisection(search)) if len(search.ranges) == 1 else explore(exploration(search))
        )
        self.batch: list[Any] = next(self._search)

    def requested(self, first: int) -> list[RunPoint]:
        """Return the runs of the batch, numbered from `first`."""
        points = []
        for number, place in enumerate(self.batch, first):
            if len(self._ranges) == 1:
                at = {self._ranges[0].key: float(f"{place:.12g}")}
            else:
                at = {axis.key: axis.value(share) for axis, share in zip(self._ranges, place, strict=True)}
            points.append(RunPoint(number, {**self.values, **at}, self._next_seed))
            self._next_seed += 1
        return points

    def answer(self, passed: Iterator[bool | None]) -> None:
        """Pass one answer per requested run to the search."""
        answers = [next(passed) for _ in self.batch]
        try:
            self.batch = self._search.send(answers)
        except StopIteration as end:
            self.batch, self.found = [], end.value


def bisection(search: Search) -> Bisection:
    """Return the settings of a search over one axis."""
    spec, (axis,) = search.spec, search.ranges
    return Bisection(
        low=axis.low,
        high=axis.high,
        rate=spec.pass_rate,
        confidence=spec.confidence,
        width=spec.width or _WIDTH_SHARE * (axis.high - axis.low),
        runs_per_point=spec.runs_per_point or _RUNS_ONE_AXIS,
        points=spec.points or _POINTS_ONE_AXIS,
        most_runs=spec.most_runs or MOST_RUNS_ONE_AXIS,
        logarithmic=axis.log,
    )


def exploration(search: Search) -> Exploration:
    """Return the settings of a search over several axes."""
    spec = search.spec
    return Exploration(
        nominal=search.nominal,
        rate=spec.pass_rate,
        confidence=spec.confidence,
        runs_per_point=spec.runs_per_point or _RUNS_SEVERAL,
        points=spec.points or _POINTS_SEVERAL,
        batch=spec.batch,
        seed=search.seed,
        width=spec.width or _WIDTH_SHARE,
        most_runs=spec.most_runs or MOST_RUNS_SEVERAL,
    )
