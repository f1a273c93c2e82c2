"""Windows of the main loop, totals of tasks and missed deadlines: units, missing fields and impossible values."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from xitl_cli.logs.model.table import Column
from xitl_cli.logs.signals.deadlines import (
    LoopWindows,
    TaskTotal,
    clock_stood_still,
    loop_windows,
    missed_deadlines,
    simulated_clock_reason,
    task_totals,
)

SECOND = 1_000_000_000


def windows(at_s: Any, **columns: Any) -> LoopWindows:
    found = loop_windows(MadeLog(MadeTable("PM", np.round(np.array(at_s) * SECOND).astype(np.int64), columns)))
    assert found is not None
    return found


def test_windows_reach_from_row_to_row_and_the_first_has_the_usual_length() -> None:
    found = windows([10.0, 20.0, 31.0, 41.0], NL=[500, 500, 550, 500])
    assert found.from_ns.tolist() == [0, 10 * SECOND, 20 * SECOND, 31 * SECOND]
    assert found.until_ns.tolist() == [10 * SECOND, 20 * SECOND, 31 * SECOND, 41 * SECOND]
    assert found.period_s == pytest.approx(0.02)
    assert windows([70.0], NL=[500]).from_ns.tolist() == [60 * SECOND]  # 10 s, if one row is all


def test_a_window_that_cannot_be_has_the_usual_length() -> None:
    """A minute is the longest; a clock may go back."""
    found = windows([8.0, 16.0, 76.0, 136.1, 100.0, 100.0])
    assert (found.until_ns - found.from_ns).tolist() == [8 * SECOND, 8 * SECOND, 60 * SECOND, *[8 * SECOND] * 3]


def test_fields_have_their_units() -> None:
    found = windows([10.0, 20.0], NLon=[1, 2], NL=[500, 501], MaxT=[20_000, 30_000], Load=[123, 45], LR=[50.0, 49.0],
                    Mem=[1000, 900], Ex=[0, 7])  # fmt: skip
    assert found.load_percent == pytest.approx([12.3, 4.5])
    arrays = found.long_loops, found.loops, found.longest_us, found.rate_hz, found.memory_bytes, found.extra_us
    assert [each.tolist() for each in arrays] == [
        [1, 2], [500, 501], [20_000, 30_000], [50.0, 49.0], [1000, 900], [0, 7],
    ]  # fmt: skip
    assert (found.field("loops"), found.field("longest_us"), found.field("extra_us")) == ("NL", "MaxT", "Ex")
    assert found.period_s == pytest.approx(1.0 / 49.5)


def test_a_field_that_a_version_lacks_is_nan() -> None:
    columns = {"A": Column("A", shape=(2,)), "NL": Column("NL", shape=(2,)), "Load": Column("Load", kind="text")}
    table = MadeTable("PM", [SECOND], {"NL": [[1, 2]], "Load": ["x"], "A": [[1, 2]]}, columns=columns)
    found = loop_windows(MadeLog(table))
    assert found is not None
    for values in (found.loops, found.load_percent, found.rate_hz):
        assert np.isnan(values).tolist() == [True]
    assert found.period_s is None


def test_the_period_is_by_windows_with_loops_if_no_rate_is_known() -> None:
    found = windows([10.0, 20.0, 30.0, 40.0], NL=[0, 500, 1000, 250], LR=[0.0, np.nan, -1.0, 0.0])
    assert found.period_s == pytest.approx(0.02)  # the median of 20 ms, 10 ms and 40 ms


def test_counters_grow_and_begin_anew() -> None:
    found = windows([10.0, 20.0, 30.0, 40.0], SPIC=[100, 150, 20, 25], ErC=[3, 3, 4, 4], I2CC=[0, 0, 0, 0])
    counters = {one.key: one for one in found.counters}
    assert list(counters) == ["internal_errors", "spi", "i2c"]
    assert counters["spi"].grown.tolist() == [0, 50, 0, 5]
    assert (counters["spi"].total, counters["spi"].field, counters["spi"].label) == (55, "SPIC", "SPI transactions")
    assert (counters["internal_errors"].total, counters["internal_errors"].field) == (1, "ErC")
    assert counters["i2c"].total == 0


def still(**changed: Any) -> MadeTable:
    columns = {"Load": np.zeros(4), "MaxT": np.array([30_000, 20_000, 20_000, 20_000])} | changed
    return MadeTable("PM", SECOND * np.arange(1, 5), columns)


@pytest.mark.parametrize(
    ("tables", "reason"),
    [
        ([still()], "load is always 0"),  # the first window begins with the start
        ([still(Load=np.array([0, 0, 1, 0]))], ""),
        ([still(Load=np.array([0, 0, np.nan, 0]))], ""),
        ([still(MaxT=np.array([20_000, 20_000, 20_000, 20_001]))], ""),
        ([still(MaxT=np.array([np.nan, 20_000, 20_000, 20_000]))], ""),
        ([still(), MadeTable("VER", [1], {"APJ": [1]})], ""),
        ([still(), MadeTable("VER", [1, 2], {"BT": [3, 4]})], ""),  # the last row counts
        ([MadeTable("VER", [1, 2], {"BT": [4, 3]})], "ArduPilot's own simulator (VER.BT 3)"),
        ([MadeTable("VER", [1, 2], {"BT": [4, 3]}), MadeTable("SIM", [1], {"A": [1]})], "ArduPilot's own simulator"),
        ([MadeTable("SIM", [1], {"A": [1]})], "a simulator writes into it (SIM)"),
        ([MadeTable("VER", np.array([], int), {"BT": np.array([])})], ""),
        ([], ""),
    ],
)
def test_a_simulated_clock_by_what_the_log_holds(tables: list[MadeTable], reason: str) -> None:
    found = simulated_clock_reason(MadeLog(*tables))
    assert reason in found
    assert bool(found) is bool(reason)


@pytest.mark.parametrize(("rows", "simulated"), [(2, False), (3, True)])
def test_two_windows_say_nothing_of_the_clock(rows: int, simulated: bool) -> None:
    table = MadeTable("PM", SECOND * np.arange(rows), {"Load": np.zeros(rows), "MaxT": np.full(rows, 20_000)})
    assert bool(simulated_clock_reason(MadeLog(table))) is simulated


def recorded(**changed: Any) -> MadeTable:
    columns = {
        "node": np.array(["LC", "PS1", "LC"]), "task": np.array(["control", "physics", "control"]),
        "rate_hz": [50.0, 400.0, 50.0], "cycles": [10, 4000, 96], "missed": [1, 20, 6], "skipped": [0, 8, 4],
        "start_jitter_mean_s": [1e-5, 2e-5, 3e-5], "start_jitter_max_s": [1e-4, np.nan, 3e-4],
        "worst_start_ns": [1, 0, 3], "run_mean_s": [0.001, -1.0, 0.003], "run_max_s": [0.01, 0.0, 0.03],
        "worst_run_ns": [11, -1, 13],
    } | changed  # fmt: skip
    return MadeTable("/tasks", SECOND * np.arange(3), columns)


def test_the_last_totals_of_each_recorded_task() -> None:
    control, physics = task_totals(MadeLog(recorded(), kind="mcap"))
    assert control == TaskTotal("LC", "control", 50.0, 96, 6, 4, 3e-5, 3e-4, 3, 0.003, 0.03, 13)
    assert physics == TaskTotal("PS1", "physics", 400.0, 4000, 20, 8, 2e-5, None, None, None, 0.0, None)
    assert (control.name, control.ratio) == ("LC control", 0.06)
    assert physics.ratio == 20 / 4008


def test_a_recording_without_durations_has_none() -> None:
    table = recorded()
    kept = ("node", "task", "rate_hz", "cycles", "missed", "skipped")
    bare = MadeTable("/tasks", table.stamp_ns, {name: table.values(name) for name in kept})
    control, _ = task_totals(MadeLog(bare, kind="mcap"))
    assert control == TaskTotal("LC", "control", 50.0, 96, 6, 4, *[None] * 6)
    assert task_totals(MadeLog(MadeTable("/tasks", [1], {"node": ["LC"]}), kind="mcap")) == []


def logged(**more: Any) -> MadeTable:
    columns = {
        "Name": np.array(["a", "b"]), "Rate": [50, 10], "N": [100, 20], "Miss": [3, 0], "Skip": [1, 0],
    }  # fmt: skip
    return MadeTable("TASK", [SECOND, 2 * SECOND], columns | more)


def test_logged_tasks_without_numbers_have_no_instants() -> None:
    worst = MadeTable("TSKQ", [SECOND], {"I": [0], "JAtUS": [5], "RAtUS": [6]})
    found = task_totals(MadeLog(logged(), worst))
    assert found == [
        TaskTotal("", "a", 50.0, 100, 3, 1, *[None] * 6),
        TaskTotal("", "b", 10.0, 20, 0, 0, *[None] * 6),
    ]
    assert [task.name for task in found] == ["a", "b"]


def test_instants_are_in_microseconds_and_the_last_of_each_number() -> None:
    worst = MadeTable("TSKQ", SECOND * np.arange(3), {"I": [0, 1, 0], "JAtUS": [1, 7, 5], "RAtUS": [2, 0, 6]})
    first, second = task_totals(MadeLog(logged(I=[0, 1], JMax=[250.0, np.nan]), worst))
    assert (first.worst_start_ns, first.worst_run_ns, first.start_max_s) == (5000, 6000, pytest.approx(250e-6))
    assert (second.worst_start_ns, second.worst_run_ns, second.start_max_s) == (7000, None, None)


def test_a_task_that_was_never_due_has_missed_nothing() -> None:
    assert TaskTotal("LC", "x", 1.0, 0, 0, 0, *[None] * 6).ratio == 0.0


@pytest.mark.parametrize(
    ("changed", "stood"),
    [({}, True), ({"run_max_s": 1e-6}, False), ({"start_max_s": 1e-6}, False), ({"missed": 1}, False)],
)
def test_a_clock_that_stands_still_shows_no_duration(changed: dict[str, Any], stood: bool) -> None:
    known: dict[str, Any] = {"missed": 0, "run_max_s": 0.0, "start_max_s": None} | changed
    task = TaskTotal(
        "LC", "x", 1.0, 10, known["missed"], 0, None, known["start_max_s"], None, None, known["run_max_s"], None
    )
    calm = TaskTotal("LC", "y", 1.0, 10, 0, 0, *[None] * 6)
    assert clock_stood_still([calm, task]) is stood


def test_recorded_misses_have_delay_and_length() -> None:
    table = MadeTable(
        "/misses", [100, 200, 300, 400, 500],
        {
            "node": np.array(["LC"] * 5), "task": np.array(["control"] * 5),
            "due_ns": [10, -1, 50, 30, 0], "start_ns": [10, 20, 40, 40, 0], "end_ns": [30, 30, 60, 39, 0],
            "skipped": [0, 1, 2, 3, 4],
        },
    )  # fmt: skip
    found = missed_deadlines(MadeLog(table, kind="mcap"))
    assert found is not None
    assert len(found) == 5
    assert (found.task[0], found.message) == ("LC control", "/misses")
    assert found.due_ns.tolist() == [10, 200, 300, 400, 0]  # impossible instants give way to the stamp
    assert found.late_s == pytest.approx(np.zeros(5))
    assert found.run_s == pytest.approx([20e-9, 0.0, 0.0, 0.0, 0.0])
    assert found.end_ns.tolist() == [30, 200, 300, 400, 0]
    assert found.skipped.tolist() == [0, 1, 2, 3, 4]


def test_logged_misses_are_in_microseconds() -> None:
    columns = {"Name": np.array(["control"]), "DueUS": [5_000_000], "Late": [30_000], "Run": [2_500], "Skip": [1]}
    found = missed_deadlines(MadeLog(MadeTable("MISS", [6 * SECOND], columns)))
    assert found is not None
    assert (found.task, found.message, found.skipped.tolist()) == (("control",), "MISS", [1])
    assert (found.due_ns.tolist(), found.end_ns.tolist()) == ([5 * SECOND], [5_032_500_000])
    assert (found.late_s.tolist(), found.run_s.tolist()) == ([pytest.approx(0.03)], [pytest.approx(0.0025)])
    del columns["Skip"]
    assert missed_deadlines(MadeLog(MadeTable("MISS", [6 * SECOND], columns))) is None
    assert missed_deadlines(MadeLog()) is None
