"""Execution of a campaign: points in, rows out, all results kept at once. `carry_out` takes a plan to its table."""

from __future__ import annotations

import contextlib
import errno
import itertools
import os
import shutil
import time
import uuid
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import field
from pathlib import Path
from typing import Any, Protocol

from sim_core.dataclass import dataclass
from xitl_cli.plugins.campaign.axes import RunPoint
from xitl_cli.plugins.campaign.cluster import TlsFiles, local_workers, workers_at
from xitl_cli.plugins.campaign.execution import FAILED, KILLED, RAN, RETRIED, Row, RunTask, end_preparation, run_point
from xitl_cli.plugins.campaign.expression import ExpressionError
from xitl_cli.plugins.campaign.figures import absent_figure, null_group
from xitl_cli.plugins.campaign.plan import CampaignPlan
from xitl_cli.plugins.campaign.results import RUNS, CampaignFolder, FullDiskError, ResultTable

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
                run = under_way[point.number] = _UnderWay(point, key, self._task(point))
                self._workers.submit(run.task)
            if not under_way:
                return
            self.progress.running = len(under_way)
            self._watch(self.progress)
            if (ended := self._workers.next(0.5)) is None:
                continue
            number, result = ended
            run = under_way[number]
            run.attempts += 1
            # Another attempt after a crash, a limit or a kill, if the worker was lost, or if the run failed after its
            # start, for example because an autopilot stopped responding.
            retry = result is None or result["status"] in RETRIED or (result["status"] == FAILED and result["began"])
            if retry and run.attempts < self.plan.spec.limits.attempts:
                self._workers.submit(run.task)
                continue
            del under_way[number]
            row = self._row(run, result)
            self.folder.append(row)
            self.progress.add(row, now=True)
            self._watch(self.progress)
            yield row

    def _task(self, point: RunPoint) -> RunTask:
        plan, limits = self.plan, self.plan.spec.limits
        overrides = plan.base.overrides(point, self._origins)
        directory = self._directory(point.number)
        return RunTask(
            number=point.number,
            profile=plan.base.text(overrides.parts),
            name=plan.base.name,
            arguments=tuple(overrides.arguments),
            keep=plan.keep,
            time_s=limits.time_s,
            memory_mb=limits.memory_mb,
            directory=None if plan.spec.recordings == "none" else str(directory.absolute()),
            campaign=self.name,
            whole=not self._checked,
        )

    def _directory(self, number: int) -> Path:
        return self.folder.path / RUNS / f"{number:04d}"

    def _row(self, run: _UnderWay, result: Row | None) -> Row:
        plan, point = self.plan, run.point
        if result is None:
            result = dict.fromkeys(plan.keep)
            result |= {"status": KILLED, "exit_code": None, "error": "its worker was killed", "wall_s": None}
        status, error = result["status"], result["error"]
        if status == FAILED and any(text in (error or "") for text in _NO_ROOM):
            kept = f"{len(self.folder.done)} runs are kept; continue with --resume"
            raise FullDiskError(f"{self.folder.path}: {error}: {kept}")
        # The first summary shows whether the runs have the figures of the plan.
        summary = result.pop("summary", None)
        if not self._checked and summary is not None and status in RAN:
            check_figures(plan, summary)
            self._checked = True
        try:
            verdicts = {verdict.text: verdict.holds(result) for verdict in plan.verdicts}
        except ExpressionError as problem:
            raise plan.problem("verdicts", f"verdicts: {problem}") from None
        passed = all(verdicts.values())
        directory: Path | None = self._directory(point.number)
        if passed and plan.spec.recordings == "failures":
            shutil.rmtree(self._directory(point.number), ignore_errors=True)
            directory = None
        elif plan.spec.recordings == "none":
            directory = None
        values = {**plan.base_values, **point.values}
        values = {key: list(value) if isinstance(value, tuple) else value for key, value in values.items()}
        return {
            "number": point.number,
            "key": run.key,
            **{key: values.get(key) for key in plan.axis_keys},
            "seed": point.seed,
            **{path: result[path] for path in plan.keep},
            **verdicts,
            "status": status,
            "exit_code": result["exit_code"],
            "error": error,
            "passed": passed,
            "attempts": run.attempts,
            "wall_s": result["wall_s"],
            "directory": None if directory is None else str(directory),
            "command": plan.base.command(point),
        }


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
            raise plan.problem("verdicts", f"verdicts: {path}: runs of {plan.base.name} have no {group}; remove it")


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
    overrides = plan.base.overrides(point)
    row = run_point(
        RunTask(
            number=0,
            profile=plan.base.text(overrides.parts),
            name=plan.base.name,
            arguments=(*overrides.arguments, "--duration", f"{duration_s:g}"),
            keep=(),
            time_s=min(60.0, plan.spec.limits.time_s),
            memory_mb=None,
            directory=None if folder is None else str(folder),
            campaign=uuid.uuid4().hex,
            whole=True,
        )
    )
    if row["status"] == FAILED:
        raise plan.problem("base", f"base: {plan.base.name} does not run: {row['error']}")
    if row["summary"] is not None and row["status"] in RAN:
        check_figures(plan, row["summary"])
    return row


class CampaignWatch(Protocol):
    """Receives the progress of a campaign."""

    def began(self, threads: int, on: str | None, dashboard: str | None) -> None:
        """Called at the start with the number of parallel runs, the scheduler, and the address of Dask's dashboard if
        any.
        """

    def __call__(self, progress: CampaignProgress) -> None:
        """Called at intervals."""


class NoWatch:
    """Ignores the progress."""

    def began(self, threads: int, on: str | None, dashboard: str | None) -> None:
        """See CampaignWatch."""

    def __call__(self, progress: CampaignProgress) -> None:
        """See CampaignWatch."""


def carry_out(
    plan: CampaignPlan,
    folder: CampaignFolder,
    on: str | None = None,
    workers: int | None = None,
    total: int | None = None,
    watch: CampaignWatch | None = None,
    tls: TlsFiles | None = None,
) -> ResultTable:
    """Carry out the runs of a plan that its folder lacks, here or on a scheduler. Return the table of all runs.

    tls: files for a scheduler at a `tls://` address; by default those of Dask's configuration.
    Raises UserError for a problem that the user has to fix. Completed runs are kept, also after a KeyboardInterrupt.
    """
    from xitl_cli.plugins.campaign.search import carry_out as carry_out_search  # needs scipy, which a dry run does not

    watch = watch or NoWatch()
    name = uuid.uuid4().hex[:12]
    run_folders = None if plan.spec.recordings == "none" else folder.path
    if not folder.done:
        try_first_run(plan)
        end_preparation()  # further runs are those of workers
    try:
        with workers_at(on, name, run_folders, tls) if on is not None else local_workers(workers, name) as dask_workers:
            watch.began(dask_workers.threads, on, dask_workers.dashboard)
            campaign = Campaign(plan, folder, dask_workers, total, watch, name)
            if plan.search is not None:
                carry_out_search(plan.search, campaign.submit)
            else:
                for _ in campaign.run():
                    pass
    finally:
        folder.close()
        if folder.done:
            with contextlib.suppress(FullDiskError):  # the table is returned anyway
                folder.write_table()
    return folder.table()
