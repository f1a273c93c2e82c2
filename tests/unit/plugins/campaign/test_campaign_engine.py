"""A campaign with workers that are made up: what is tried again, what is kept, and how one goes on."""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.golden import Golden
from xitl_cli.errors import UserError
from xitl_cli.plugins.campaign import results
from xitl_cli.plugins.campaign.engine import Campaign, CampaignProgress
from xitl_cli.plugins.campaign.execution import CRASHED, FAILED, KILLED, TIMEOUT, Row, RunTask, left_undone
from xitl_cli.plugins.campaign.plan import CampaignPlan, PlanError, read_plan
from xitl_cli.plugins.campaign.results import LINES, NOT_COMPARED, CampaignFolder, FullDiskError, ResultTable

TEXT = """
base: mitl
axes: {environment.wind.mean_mps: [0, 4, 8]}
seeds: 1-4
verdicts: [mission.cross_track_rms_m < 6, driver.completed]
recordings: none
"""


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> CampaignPlan:
    path = tmp_path_factory.mktemp("plan") / "winds.yaml"
    path.write_text(TEXT, encoding="utf-8")
    return read_plan(path)


def test_a_plan_has_axes_of_a_tide(tmp_path: Path) -> None:
    tide = "constituents: [{name: M2, amplitude_m: 1.5, phase_deg: 20}]"
    environment = (
        f"{{start_utc: 2026-03-01, water: {{tide: {{{tide}}}}}, current: {{tide: {{flood_deg: 0, peak_mps: 1}}}}}}"
    )
    (tmp_path / "sea.yaml").write_text(f"extends: mitl\nenvironment: {environment}\n", encoding="utf-8")
    path = tmp_path / "tides.yaml"
    key = "environment.water.tide.constituents.0.amplitude_m"
    axes = f"{{{key}: [0.5, 2.0], environment.current.tide.peak_mps: [0.2, 0.8]}}"
    path.write_text(TEXT.replace("mitl", "sea.yaml").replace("{environment.wind.mean_mps: [0, 4, 8]}", axes))
    assert len(list(read_plan(path).points())) == 16


class ImaginedWorkers:
    """Runs that end at once, in an order of their own. becomes: what a run does at each attempt, None for its death."""

    def __init__(self, becomes: Callable[[RunTask, int], Row | None], at_once: int = 3) -> None:
        self.capacity = at_once
        self.attempts: dict[int, int] = {}
        self._becomes, self._waiting = becomes, list[RunTask]()

    def submit(self, task: RunTask) -> None:
        self._waiting.append(task)
        assert len(self._waiting) <= self.capacity

    def next(self, wait_s: float) -> tuple[int, Row | None] | None:
        task = self._waiting.pop(len(self._waiting) // 2)
        attempt = self.attempts[task.number] = self.attempts.get(task.number, 0) + 1
        return task.number, self._becomes(task, attempt)


def well(task: RunTask, attempt: int = 1) -> Row:
    """A run whose cross-track error is its number."""
    summary = {"mission": {"cross_track_rms_m": float(task.number)}, "driver": {"completed": True}}
    figures = dict.fromkeys(task.keep)
    figures |= {"mission.cross_track_rms_m": float(task.number), "driver.completed": True}
    row = {"number": task.number, "status": "completed", "exit_code": 0, "error": None, "began": True, "wall_s": 1.5}
    return {**row, **({"summary": summary} if task.whole else {}), **figures}


def ended(task: RunTask, status: str, code: int = 2, began: bool = True) -> Row:
    row = {"number": task.number, "status": status, "exit_code": code, "error": "so it was", "began": began}
    return {**row, "wall_s": 2.0, **dict.fromkeys(task.keep)}


def carried_out(plan: CampaignPlan, path: Path, workers: ImaginedWorkers, **others: Any) -> list[Row]:
    """All rows of a campaign that begins in `path`, or goes on there."""
    with (CampaignFolder.resume if path.exists() else CampaignFolder.create)(path, plan) as folder:
        rows = list(Campaign(plan, folder, workers, **others).run())
        folder.write_table()
        return rows


def compared(rows: Any) -> list[Row]:
    told = sorted(rows, key=lambda row: row["number"])
    return [{key: value for key, value in row.items() if key not in NOT_COMPARED} for row in told]


def test_every_run_is_kept_with_its_values_verdicts_and_command(plan: CampaignPlan, tmp_path: Path) -> None:
    rows = carried_out(plan, tmp_path / "a", ImaginedWorkers(well))
    table = ResultTable.read(tmp_path / "a")
    assert len(rows) == len(table) == 12
    assert table.column("number") == list(range(1, 13))
    assert table.column("environment.wind.mean_mps") == [0] * 4 + [4] * 4 + [8] * 4
    assert table.column("seed") == [1, 2, 3, 4] * 3
    assert table.column("mission.cross_track_rms_m < 6") == [number < 6 for number in range(1, 13)]
    assert table.column("passed") == [number < 6 for number in range(1, 13)]
    assert table.column("command")[4] == "xitl sim mitl --set environment.wind.mean_mps=4 --seed 1"
    assert set(table.columns) == set(rows[0])
    assert [row["number"] for row in table.worst(2)] == [12, 11]
    frame = table.to_pandas()
    assert list(frame["seed"]) == table.column("seed")
    pyarrow = pytest.importorskip("pyarrow.parquet")
    assert pyarrow.read_table(tmp_path / "a/results.parquet").to_pylist() == [
        {name: row[name] for name in table.columns} for row in table.rows
    ]


@pytest.mark.parametrize("at_once", [1, 2, 4])
def test_the_table_is_the_same_however_many_work(plan: CampaignPlan, at_once: int, tmp_path: Path) -> None:
    def unsteady(task: RunTask, attempt: int) -> Row | None:
        return well(task) if attempt > task.number % 3 else None

    calm = carried_out(plan, tmp_path / "calm", ImaginedWorkers(well))
    rows = carried_out(plan, tmp_path / "unsteady", ImaginedWorkers(unsteady, at_once))
    assert compared(rows) == compared(calm)
    assert {row["number"]: row["attempts"] for row in rows} == {number: 1 + number % 3 for number in range(1, 13)}


@pytest.mark.parametrize(
    ("becomes", "status", "attempts"),
    [
        (lambda task, attempt: None, KILLED, 3),
        (lambda task, attempt: ended(task, CRASHED, 7), CRASHED, 3),
        (lambda task, attempt: ended(task, TIMEOUT, -9), TIMEOUT, 3),
        (lambda task, attempt: ended(task, FAILED, began=True), FAILED, 3),
        (lambda task, attempt: ended(task, FAILED, began=False), FAILED, 1),
        (lambda task, attempt: ended(task, "incomplete", 1), "incomplete", 1),
    ],
)
def test_what_another_attempt_may_mend_is_tried_again_and_then_told(
    plan: CampaignPlan, becomes: Any, status: str, attempts: int, tmp_path: Path
) -> None:
    rows = carried_out(plan, tmp_path / "a", ImaginedWorkers(becomes))
    assert {row["status"] for row in rows} == {status}
    assert {row["attempts"] for row in rows} == {attempts}
    assert not any(row["passed"] for row in rows)
    assert {row["mission.cross_track_rms_m < 6"] for row in rows} == {None}


def test_one_that_was_cut_off_goes_on_with_what_is_missing(plan: CampaignPlan, tmp_path: Path) -> None:
    whole = carried_out(plan, tmp_path / "whole", ImaginedWorkers(well))
    with CampaignFolder.create(tmp_path / "cut", plan) as folder:
        coming = Campaign(plan, folder, ImaginedWorkers(well)).run()
        before = [next(coming)["number"] for _ in range(5)]
    with (tmp_path / "cut" / LINES).open("ab") as file:  # a sixth line that the kill tore
        file.write(b'{"number": 12, "key": "')
    assert len(ResultTable.read(tmp_path / "cut")) == 5
    workers, seen = ImaginedWorkers(well), list[CampaignProgress]()
    assert compared(carried_out(plan, tmp_path / "cut", workers, total=12, watch=seen.append)) == compared(whole)
    assert set(workers.attempts) == set(range(1, 13)) - set(before)
    assert seen[-1].done == 12
    assert seen[-1].ended_now == 7
    lines = (tmp_path / "cut" / LINES).read_text().splitlines()
    assert compared(map(json.loads, lines)) == compared(whole)


@pytest.mark.medium
def test_a_folder_is_no_other_plans(plan: CampaignPlan, tmp_path: Path) -> None:
    CampaignFolder.create(tmp_path / "a", plan)
    with pytest.raises(UserError, match="add --resume or choose another --out"):
        CampaignFolder.create(tmp_path / "a", plan)
    other = tmp_path / "other.yaml"
    other.write_text(TEXT.replace("1-4", "1-5"), encoding="utf-8")
    with pytest.raises(UserError, match="differs in seeds"):
        CampaignFolder.resume(tmp_path / "a", read_plan(other))
    other.write_text(TEXT + "description: the same runs\nlimits: {time_s: 5}\n", encoding="utf-8")
    CampaignFolder.resume(tmp_path / "a", read_plan(other))
    with pytest.raises(UserError, match="contains no campaign"):
        CampaignFolder.resume(tmp_path / "b", plan)


class FullFile:
    """A file on a disk with room for so many bytes more."""

    def __init__(self, file: Any, room: int) -> None:
        self._file, self._room = file, room

    def write(self, line: bytes) -> int:
        written: int = self._file.write(line[: self._room])
        self._room -= written
        if not written:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return written

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


def test_a_full_disk_stops_it_and_loses_nothing(plan: CampaignPlan, tmp_path: Path) -> None:
    with CampaignFolder.create(tmp_path / "a", plan) as folder:
        folder._file = FullFile((tmp_path / "a" / LINES).open("ab", buffering=0), 2000)  # type: ignore[assignment]
        with pytest.raises(FullDiskError, match=r"No space left on device.*runs are kept; continue with --resume"):
            list(Campaign(plan, folder, ImaginedWorkers(well)).run())
    kept = len(ResultTable.read(tmp_path / "a"))
    assert 0 < kept < 12
    assert (tmp_path / "a" / LINES).read_bytes().endswith(b"}\n")
    carried_out(plan, tmp_path / "a", ImaginedWorkers(well))
    assert len(ResultTable.read(tmp_path / "a")) == 12


def test_a_run_that_found_no_room_is_not_told_as_a_failure_of_the_boat(plan: CampaignPlan, tmp_path: Path) -> None:
    def full(task: RunTask, attempt: int) -> Row:
        return {
            **ended(task, FAILED, began=False),
            "error": "run.mcap: the recording cannot be written (No space left on device); free space and run again",
        }

    with pytest.raises(FullDiskError, match="free space and run again: 0 runs are kept") as told:
        carried_out(plan, tmp_path / "a", ImaginedWorkers(full))
    assert str(told.value).count("free space") == 1
    assert len(ResultTable.read(tmp_path / "a")) == 0


def test_the_first_run_shows_a_figure_that_is_not_there(tmp_path: Path) -> None:
    path = tmp_path / "plan.yaml"
    path.write_text(TEXT.replace("cross_track_rms_m", "cross_track_rms"), encoding="utf-8")
    wrong = read_plan(path)
    workers = ImaginedWorkers(well)
    with pytest.raises(PlanError, match=r"did you mean mission\.cross_track_rms_m"):
        carried_out(wrong, tmp_path / "a", workers)
    assert sum(workers.attempts.values()) == 1


def test_points_may_be_endless(plan: CampaignPlan, tmp_path: Path) -> None:
    """A search asks as workers get free."""

    def endless() -> Iterator[Any]:
        while True:
            yield from plan.points()

    with CampaignFolder.create(tmp_path / "a", plan) as folder:
        rows = Campaign(plan, folder, ImaginedWorkers(well)).submit(endless())
        assert [next(rows)["status"] for _ in range(60)] == ["completed"] * 60
    assert len((tmp_path / "a" / LINES).read_text().splitlines()) <= 12  # those that came again were read, not run


def test_progress_estimates_the_end(monkeypatch: pytest.MonkeyPatch, golden: Golden) -> None:
    from xitl_cli.plugins.campaign.command import progress_text

    progress = CampaignProgress(100, begun_s=0.0)
    monkeypatch.setattr("time.monotonic", lambda: 50.0)
    for number in range(25):
        row = {"status": "timeout" if number == 0 else "completed", "passed": number > 4}
        progress.add(row, now=True)
    golden("text", progress_text(progress), "25", "100 runs", "30.0", "2 min", "30 s")


def test_what_is_compared_names_columns_that_are_there() -> None:
    assert set(NOT_COMPARED) <= set(results.TAIL)


@pytest.mark.parametrize(
    ("summary", "told"),
    [
        ({}, ""),
        ({"verdict": None, "warnings": [], "companion": None}, ""),
        ({"verdict": {"why": "at waypoint 2 of 6"}}, "at waypoint 2 of 6"),
        (
            {
                "verdict": {"why": "at waypoint 2 of 6"},
                "warnings": ["the link was cut"],
                "companion": {"warnings": ["it ended by itself", ""]},
            },
            "at waypoint 2 of 6; the link was cut; it ended by itself",
        ),
        ({"warnings": ["x" * 10_000]}, "x" * 500),
    ],
)
def test_what_a_run_left_undone_is_told_by_it_and_its_companion(summary: dict[str, Any], told: str) -> None:
    assert left_undone(summary) == told
