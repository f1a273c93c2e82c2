"""Limits of time and memory of a run, on a made clock, and the memory of a made tree of processes."""

from __future__ import annotations

import os
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from xitl_cli.plugins.campaign import execution
from xitl_cli.plugins.campaign.execution import (
    COMPLETED,
    CRASHED,
    ERRORS,
    MEMORY,
    SUMMARY,
    TIMEOUT,
    FreshRun,
    Row,
    RunTask,
    memory_of_tree_mb,
    run_point,
)


class MadeRun:
    """A run that takes some seconds of a made clock and needs 10 MB more in each."""

    pid = 7

    def __init__(self, takes_s: float, folder: Path) -> None:
        self.now_s = 1000.0
        self._end_s, self._folder = self.now_s + takes_s, folder
        self._released = False

    @property
    def memory_mb(self) -> float:
        return 10.0 * (self.now_s - 1000.0)

    def ends_within(self, wait_s: float) -> bool:
        assert 0.0 <= wait_s <= 1.0
        self.now_s = min(self.now_s + wait_s, self._end_s)
        return self.now_s >= self._end_s

    def wait(self) -> int:
        if self.now_s < self._end_s:
            return -9
        (self._folder / SUMMARY).write_text('{"mission": {"cross_track_rms_m": 0.5}}')
        return 0

    def release(self) -> None:
        assert not self._released
        self._released = True


def task(folder: Path, **limits: Any) -> RunTask:
    settings: dict[str, Any] = {"time_s": 60.0, "memory_mb": None, "directory": str(folder), **limits}
    return RunTask(
        number=3, profile="", name="sitl", arguments=(), keep=("mission.cross_track_rms_m",), campaign="c", **settings
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "a" / "run"


def carried_out(made: MadeRun, planned: RunTask, monkeypatch: pytest.MonkeyPatch) -> Row:
    monkeypatch.setattr(execution, "_started", lambda *_: made)
    monkeypatch.setattr(execution, "_watched_over", lambda *_: nullcontext())
    monkeypatch.setattr(execution, "memory_of_tree_mb", lambda pid: made.memory_mb if pid == made.pid else 1e9)
    monkeypatch.setattr(execution, "time", SimpleNamespace(monotonic=lambda: made.now_s))
    return run_point(planned)


@pytest.mark.parametrize(
    ("takes_s", "limits", "status", "wall_s"),
    [
        (10.0, {}, COMPLETED, 10.0),
        (10.0, {"time_s": 10.5}, COMPLETED, 10.0),
        (10.0, {"time_s": 9.5}, TIMEOUT, 9.5),
        (10.0, {"time_s": 9.05}, TIMEOUT, 9.05),
        (10.0, {"memory_mb": 101.0}, COMPLETED, 10.0),
        (10.0, {"memory_mb": 51.0}, MEMORY, pytest.approx(5.2, abs=0.01)),
        (10.0, {"memory_mb": 90.0, "time_s": 4.0}, TIMEOUT, 4.0),
    ],
)
def test_a_run_ends_at_the_first_limit(
    takes_s: float, limits: dict[str, float], status: str, wall_s: float, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    row = carried_out(MadeRun(takes_s, folder), task(folder, **limits), monkeypatch)
    assert (row["number"], row["status"], row["wall_s"]) == (3, status, pytest.approx(wall_s))
    ended = status == COMPLETED
    assert (row["exit_code"], row["began"]) == ((0, True) if ended else (-9, False))
    assert row["mission.cross_track_rms_m"] == (0.5 if ended else None)
    assert {path.name for path in folder.iterdir()} == ({ERRORS, SUMMARY} if ended else {ERRORS})


def test_the_last_line_of_the_errors_is_cut(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Silent(MadeRun):
        def wait(self) -> int:
            (folder / ERRORS).write_text("first\nerror: " + 9000 * "x")
            return 3

    row = carried_out(Silent(0.0, folder), task(folder), monkeypatch)
    assert (row["status"], len(row["error"])) == (CRASHED, 500)


def process(proc: Path, pid: int, pages: int, shared: int, *threads: list[int]) -> None:
    """Write the files of a process as in proc(5): sizes in pages, and the children of each thread."""
    for number, children in enumerate(threads):
        (proc / f"{pid}/task/{pid + number}").mkdir(parents=True)
        (proc / f"{pid}/task/{pid + number}/children").write_text("".join(f"{child} " for child in children))
    (proc / f"{pid}/statm").write_text(f"9999 {pages} {shared} 1 0 50 0\n")


def test_memory_is_that_of_the_process_and_what_its_descendants_do_not_share(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    process(tmp_path, 100, 1000, 300, [200], [300, 400])
    process(tmp_path, 200, 500, 100, [500])
    process(tmp_path, 300, 80, 30, [])
    process(tmp_path, 500, 60, 20, [])  # 400 has ended
    process(tmp_path, 600, 7000, 0, [])  # no child
    monkeypatch.setattr(execution, "PROC", tmp_path)
    page_mb = os.sysconf("SC_PAGE_SIZE") / 1e6
    assert memory_of_tree_mb(100) == pytest.approx((1000 + 400 + 50 + 40) * page_mb)
    assert memory_of_tree_mb(200) == pytest.approx((500 + 40) * page_mb)
    assert memory_of_tree_mb(400) == 0.0


@pytest.mark.medium
@pytest.mark.parametrize("watched", [True, False])
def test_a_fresh_run_tells_its_end(watched: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(pid: int) -> int:
        raise OSError

    if not watched:
        monkeypatch.setattr(os, "pidfd_open", refused)
    with (tmp_path / "errors").open("wb") as errors:
        run = FreshRun(["--version"], os.environ, errors)
    assert not run.ends_within(0.0)
    assert run.ends_within(60.0)
    assert run.wait() == 0
    run.release()
    run.release()
