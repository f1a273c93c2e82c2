"""Execution of a campaign: points in, rows out, all results kept at once. A search uses `Campaign.submit`."""

from __future__ import annotations

import errno
import itertools
import os
import shutil
import time
import uuid
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from xitl_cli.plugins.campaign.axes import RunPoint
from xitl_cli.plugins.campaign.execution import (
    FAILED,
    KILLED,
    RAN,
    RETRIED,
    Row,
    RunTask,
    run_point,
)  # fmt: skip
from xitl_cli.plugins.campaign.expression import ExpressionError
from xitl_cli.plugins.campaign.figures import absent_figure, null_group
from xitl_cli.plugins.campaign.plan import CampaignPlan
from xitl_cli.plugins.campaign.results import RUNS, CampaignFolder, FullDiskError

_PROBE_S = 0.1
_STRUCTURE = ("extends", "world", "vessels", "companion", "sensors", "driver", "autopilot", "mission")
"""Groups of the profile that determine the sections of a summary."""
_NO_ROOM = tuple(os.strerror(number) for number in (errno.ENOSPC, errno.EDQUOT))


class Workers(Protocol):
    """Executors of runs."""

    @property
    def capacity(self) -> int:
        """Number of runs to keep running or waiting."""

    def submit(self, task: RunTask) -> None:
        """Queue a run."""

    def next(self, wait_s: float) -> tuple[int, Row | None] | None:
        """Return number and row of an ended run; the row is None if its worker was lost. None: no run ended in time.

        Raises UserError if the workers are not reachable.
        """


@dataclass
class CampaignProgress:
    """Progress of a campaign."""

    total: int | None
    """None while a search does not know it."""
    statuses: Counter[str] = field(default_factory=Counter)
    """Statuses of ended runs, now or before."""
    passed: int = 0
    running: int = 0
    ended_now: int = 0
    """Runs that ended in this session."""
    begun_s: float = field(default_factory=time.monotonic)

    @property
    def done(self) -> int:
        """Number of runs that ended, now or before."""
        return self.statuses.total()

    @property
    def rate_hz(self) -> float | None:
        """Runs per second in this session."""
        elapsed_s = time.monotonic() - self.begun_s
        return self.ended_now / elapsed_s if self.ended_now and elapsed_s > 0 else None

    @property
    def left_s(self) -> float | None:
        """Estimated remaining time at this rate."""
        if self.total is None or not self.rate_hz:
            return None
        return (self.total - self.done) / self.rate_hz

    def add(self, row: Row, now: bool) -> None:
        """Count a row. now: it was carried out in this session and not read."""
        self.statuses[row["status"]] += 1
        self.passed += bool(row["passed"])
        self.ended_now += now


class Campaign:
    """A plan on workers, with its folder.

    `submit` takes points, from a plan or from a search, and yields their rows as they end. Runs that the folder already
    contains are not repeated.
    """

    def __init__(
        self,
        plan: CampaignPlan,
        folder: CampaignFolder,
        workers: Workers,
        total: int | None = None,
        watch: Callable[[CampaignProgress], None] = lambda _: None,
        name: str | None = None,
    ) -> None:
        self.plan, self.folder, self.progress = plan, folder, CampaignProgress(total)
        self.name = name or uuid.uuid4().hex[:12]
        self._workers, self._watch = workers, watch
        self._checked = bool(folder.done)
        self._base = plan.base.digest
        self._origins = {axis.key: axis.origin for axis in plan.axes}

    def run(self) -> Iterator[Row]:
        """Carry out all runs of the plan."""
        return self.submit(self.plan.points())

    def submit(self, points: Iterable[RunPoint]) -> Iterator[Row]:
        """Yield rows of these points as their runs end. Points are requested when workers are free, so they may be
        endless.

        Raises UserError if results cannot be kept, workers are not reachable, or the first run lacks a figure of the
        plan. Completed runs are kept.
        """
        coming, under_way = iter(points), dict[int, _UnderWay]()
        exhausted = False
        while True:
            while not exhausted and len(under_way) < self._workers.capacity:
                point = next(coming, None)
                if point is None:
                    exhausted = True
                    break
                key = point.key(self._base)
                if (row := self.folder.done.get(key)) is not None:
                    self.progress.add(row, now=False)
                    yield row
                    continue
                if point.number in under_way:  # requested again: one row is sufficient
                    coming = itertools.chain([point], coming)
                    break
                one = under_way[point.number] = _UnderWay(point, key, self._task(point))
                self._workers.submit(one.task)
            if not under_way:
                return
            self.progress.running = len(under_way)
            self._watch(self.progress)
            if (ended := self._workers.next(0.5)) is None:
                continue
            number, found = ended
            one = under_way[number]
            one.attempts += 1
            if self._again(one, found):
                self._workers.submit(one.task)
                continue
            del under_way[number]
            row = self._row(one, found)
            self.folder.append(row)
            self.progress.add(row, now=True)
            self._watch(self.progress)
            yield row

    def _task(self, point: RunPoint) -> RunTask:
        plan, limits = self.plan, self.plan.spec.limits
        made = plan.base.overrides(point, self._origins)
        kept = self._directory(point.number)
        return RunTask(
            number=point.number,
            profile=plan.base.text(made.parts),
            name=plan.base.name,
            arguments=tuple(made.arguments),
            keep=plan.keep,
            time_s=limits.time_s,
            memory_mb=limits.memory_mb,
            directory=None if plan.spec.recordings == "none" else str(kept.absolute()),
            campaign=self.name,
            whole=not self._checked,
        )

    def _directory(self, number: int) -> Path:
        return self.folder.path / RUNS / f"{number:04d}"

    def _again(self, one: _UnderWay, found: Row | None) -> bool:
        """Return True if a run gets another attempt: after a crash, a limit or a kill, or if its worker was lost."""
        if one.attempts >= self.plan.spec.limits.attempts:
            return False
        if found is None or found["status"] in RETRIED:
            return True
        return bool(found["status"] == FAILED and found["began"])  # for example, an autopilot stopped responding

    def _row(self, one: _UnderWay, found: Row | None) -> Row:
        plan, point = self.plan, one.point
        if found is None:
            blank = dict.fromkeys(plan.keep)
            found = {
                "status": KILLED,
                "exit_code": None,
                "error": "its worker was killed with it",
                "wall_s": None,
                **blank,
            }
        if found["status"] == FAILED and any(text in (found["error"] or "") for text in _NO_ROOM):
            kept = f"{len(self.folder.done)} runs are kept; --resume goes on with the others"
            raise FullDiskError(f"{self.folder.path}: {found['error']}: {kept}")
        self._check_figures(found.pop("summary", None), found["status"])
        values = {**plan.base_values, **point.values}
        verdicts = self._verdicts(found)
        passed = all(verdicts.values())
        directory = self._kept_directory(point.number, passed)
        return {
            "number": point.number,
            "key": one.key,
            **{key: _plain(values.get(key)) for key in plan.axis_keys},
            "seed": point.seed,
            **{path: found[path] for path in plan.keep},
            **verdicts,
            "status": found["status"],
            "exit_code": found["exit_code"],
            "error": found["error"],
            "passed": passed,
            "attempts": one.attempts,
            "wall_s": found["wall_s"],
            "directory": directory,
            "command": plan.base.command(point),
        }

    def _verdicts(self, found: Row) -> dict[str, bool | None]:
        try:
            return {verdict.text: verdict.holds(found) for verdict in self.plan.verdicts}
        except ExpressionError as error:
            raise self.plan.problem("verdicts", f"verdicts: {error}") from None

    def _kept_directory(self, number: int, passed: bool) -> str | None:
        if self.plan.spec.recordings == "none":
            return None
        path = self._directory(number)
        if passed and self.plan.spec.recordings == "failures":
            shutil.rmtree(path, ignore_errors=True)
            return None
        return str(path)

    def _check_figures(self, summary: Mapping[str, Any] | None, status: str) -> None:
        """Raises PlanError if the first summary lacks a figure of the plan."""
        if self._checked or summary is None or status not in RAN:
            return
        check_figures(self.plan, summary)
        self._checked = True


@dataclass(slots=True)
class _UnderWay:
    point: RunPoint
    key: str
    task: RunTask
    attempts: int = 0


def check_figures(plan: CampaignPlan, summary: Mapping[str, Any]) -> None:
    """Raises PlanError if a summary of this plan lacks one of its figures."""
    needed = [name for verdict in plan.verdicts for name in verdict.names]
    for key, paths in (("verdicts", needed), ("keep", plan.spec.keep or ())):
        if (absent := absent_figure(summary, paths)) is not None:
            raise plan.problem(key, f"{key}: {absent[0]} {absent[1]}")
    if any(axis.key.split(".")[0] in _STRUCTURE for axis in plan.axes):
        return
    for path in needed:
        if (group := null_group(summary, path)) is not None:
            raise plan.problem(
                "verdicts", f"verdicts: {path}: the runs of {plan.base.name} have no {group}; leave it out"
            )


def try_first_run(plan: CampaignPlan, duration_s: float = _PROBE_S, folder: Path | None = None) -> Row | None:
    """Carry out the beginning of the first run, here, to check that it runs and has the requested figures.

    Only for runs that take about a second: in lockstep, all in one process. Otherwise, return None. duration_s:
    simulated time. folder: folder for the run's files, which are discarded if it is None. Raises UserError.
    """
    point = next(plan.points())
    loaded = plan.base.check(point, {axis.key: axis.origin for axis in plan.axes})
    for vessel in loaded.profile.run_profiles():
        inside = vessel.autopilot.kind == "none" or vessel.autopilot.runs == "in-process"
        if not inside or vessel.clock.mode != "lockstep" or vessel.companion is not None:
            return None
    made = plan.base.overrides(point)
    arguments = (*made.arguments, "--duration", f"{duration_s:g}")
    text = plan.base.text(made.parts)
    row = run_point(
        RunTask(
            0,
            text,
            plan.base.name,
            arguments,
            (),
            min(60.0, plan.spec.limits.time_s),
            None,
            None if folder is None else str(folder),
            uuid.uuid4().hex,
            whole=True,
        )
    )
    if row["status"] == FAILED:
        raise plan.problem("base", f"base: {plan.base.name} does not run: {row['error']}")
    if row["summary"] is not None and row["status"] in RAN:
        check_figures(plan, row["summary"])
    return row


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value
