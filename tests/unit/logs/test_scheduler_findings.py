"""Long loops, load, late tasks and missed deadlines: their figures, instants and severities, at each limit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from xitl_cli.logs.model.sections import Evidence, Finding, Section, Severity
from xitl_cli.logs.model.system_files import embedded_files
from xitl_cli.plugins.logs.analyses import tasks
from xitl_cli.plugins.logs.analyses.scheduler import analyse

SECOND = 1_000_000_000


def performance(**columns: Any) -> MadeTable:
    """Ten windows of 10 s with 500 loops of 20 ms each, from 0 s on."""
    every = {"NLon": 0, "NL": 500, "MaxT": 20_100, "Load": 400, "LR": 50.0} | columns
    rows = {name: np.broadcast_to(value, 10) for name, value in every.items() if value is not None}
    return MadeTable("PM", SECOND * np.arange(10, 101, 10), rows)


def at(row: int, value: float, base: float = 0.0) -> np.ndarray:
    values = np.full(10, base)
    values[row] = value
    return values


ARMED = MadeTable("ARM", [0], {"ArmState": [1]})
NEVER_ARMED = MadeTable("ATT", [0, 100 * SECOND], {"Yaw": [0.0, 0.0]})


def section_of(*tables: MadeTable, **of: Any) -> Section:
    section = analyse(MadeLog(*tables, **of))
    assert section is not None
    return section


def finding_of(section: Section, key: str) -> Finding:
    (finding,) = [one for one in section.findings if one.key == key]
    return finding


def facts(section: Section) -> dict[str, Any]:
    return {fact.key: fact.value for fact in section.facts}


# The main loop


def test_a_loop_on_time_has_figures_and_no_finding() -> None:
    section = section_of(performance(Mem=at(3, 900, 1000), Ex=0, SPIC=np.arange(10) * 100, ErC=at(9, 2)), NEVER_ARMED)
    assert [one.sentence for one in section.findings] == ["every loop kept its time"]
    assert facts(section) == {
        "windows": 10, "loop_rate_hz": 50.0, "loops": 5000, "long_loops": 0, "long_loop_ratio": 0.0,
        "longest_loop_us": 20_100, "load_mean_percent": 40.0, "load_max_percent": 40.0, "load_saturated": 0,
        "extra_loop_us": 0, "memory_least_bytes": 900, "evidence": True, "spi_count": 900, "spi_per_s": 9.0,
        "internal_errors_count": 2,
    }  # fmt: skip
    assert section.lacks == ()
    longest, long, load = section.plots
    assert (longest.key, longest.y_label, longest.traces[0].y.tolist()) == ("longest_loop", "ms", [20.1] * 10)
    assert (long.key, long.traces[0].y.tolist()) == ("long_loops", [0.0] * 10)
    assert (load.key, load.traces[0].y.tolist()) == ("load", [40.0] * 10)
    assert longest.traces[0].x.tolist() == (SECOND * np.arange(10, 101, 10)).tolist()


@pytest.mark.parametrize(
    ("long", "severity", "sentence"),
    [
        (np.full(10, 5), Severity.NOTICE, "50 of 5000 loops (1.00 %)"),
        (np.full(10, 5) + at(4, 1), Severity.WARNING, "51 of 5000 loops (1.02 %)"),
        (at(4, 25), Severity.NOTICE, "25 of 5000 loops (0.50 %)"),  # 5 % of a window
        (at(4, 26), Severity.WARNING, "26 of 5000 loops (0.52 %)"),
        (np.full(10, 50), Severity.WARNING, "500 of 5000 loops (10.00 %)"),
        (np.full(10, 50) + at(4, 1), Severity.CRITICAL, "501 of 5000 loops (10.02 %)"),
    ],
)
def test_long_loops_by_their_share(long: np.ndarray, severity: Severity, sentence: str) -> None:
    finding = finding_of(section_of(performance(NLon=long), NEVER_ARMED), "scheduler.long_loops")
    assert finding.sentence.startswith(f"{sentence} took more than 1.2 periods; most from ")
    assert finding.severity is severity


def test_the_window_with_most_long_loops_is_named_with_its_events() -> None:
    mode = MadeTable("MODE", [44 * SECOND], {"Mode": [4], "ModeNum": [4], "Rsn": [1]})
    loops = np.where(np.arange(10) == 7, 0, 500)  # a window without loops has no share
    section = section_of(performance(NLon=at(2, 3) + at(4, 9) + at(7, 2), NL=loops), mode, NEVER_ARMED)
    finding = finding_of(section, "scheduler.long_loops")
    assert finding.sentence.startswith(
        "14 of 4500 loops (0.31 %) took more than 1.2 periods; most from 0:40.0 to 0:50.0 (1.8 %), with: mode "
    )
    assert finding.evidence == (
        Evidence("PM", "NLon", 20 * SECOND, 30 * SECOND, "3 of 500"),
        Evidence("PM", "NLon", 40 * SECOND, 50 * SECOND, "9 of 500"),
        Evidence("PM", "NLon", 70 * SECOND, 80 * SECOND, "2 of 0"),
    )
    (grid,) = section.grids
    rows = [dict(zip(grid.columns, row, strict=True)) for row in grid.rows]
    assert [(row["window until (s)"], row["long"], row["loops"], row["longest (us)"]) for row in rows] == [
        (30.0, 3.0, 500.0, 20_100.0), (50.0, 9.0, 500.0, 20_100.0), (80.0, 2.0, 0.0, 20_100.0),
    ]  # fmt: skip
    assert [(row["from (s)"], row["until (s)"], row["armed"]) for row in rows] == [(None, None, "no")] * 3
    assert [row["with"] for row in rows][::2] == ["nothing that was logged"] * 2


def attitude(pause_from_s: float, pause_s: float) -> MadeTable:
    t_s = np.arange(0.0, 100.0, 0.02)
    t_s = t_s[(t_s <= pause_from_s) | (t_s >= pause_from_s + pause_s - 1e-6)]
    return MadeTable("ATT", np.round(t_s * SECOND).astype(np.int64), {"Yaw": np.zeros(len(t_s))})


@pytest.mark.parametrize(
    ("longest_us", "armed", "sentence", "severity"),
    [
        (199_000, True, None, None),  # ten periods of 20 ms
        (200_100, True, "One loop took 200 ms, 10 periods, armed, between 0:41.0 and 0:41.3", Severity.WARNING),
        (300_000, False, "One loop took 300 ms, 15 periods, not armed, between 0:41.0 and 0:41.3", Severity.NOTICE),
        (420_000, True, "One loop took 420 ms, 21 periods, armed, between 0:41.0 and 0:41.3", Severity.WARNING),
        # A pause of less than 0.7 of it is another.
        (440_000, True, "One loop took 440 ms, 22 periods, armed, between 0:40.0 and 0:50.0", Severity.WARNING),
    ],
)
def test_the_longest_loop_is_in_the_pause_of_fast_messages(
    longest_us: int, armed: bool, sentence: str | None, severity: Severity | None
) -> None:
    tables = [performance(NLon=at(4, 1), MaxT=at(4, longest_us, 20_100)), attitude(41.0, 0.3)]
    section = section_of(*tables, *([ARMED] if armed else []))
    key = "scheduler.longest_loop" if armed else "scheduler.longest_loop_disarmed"
    found = [one for one in section.findings if one.key == key]
    assert [one.sentence.partition(", with: ")[0] for one in found] == ([sentence] if sentence else [])
    assert [one.severity for one in found] == ([severity] if severity else [])
    for one in found:
        assert one.evidence[0].value == f"{longest_us} us"
    (row,) = section.grids[0].rows
    placed = (41.0, 41.3) if longest_us <= 420_000 else (None, None)
    assert (row[4:6], row[6]) == (placed, "yes" if armed else "no")
    (mark,) = section.plots[0].marks
    begin, end = (41.0, 41.3) if longest_us <= 420_000 else (40.0, 50.0)
    assert (mark.at_ns, mark.until_ns) == (round(begin * SECOND), round(end * SECOND))
    assert mark.severity is (Severity.WARNING if armed else Severity.NOTICE)


def test_a_loop_before_the_first_row_was_before_the_log() -> None:
    """The first window begins before the log, and no message pauses."""
    t_s = np.arange(4.0, 100.0, 0.02)
    fast = MadeTable("ATT", np.round(t_s * SECOND).astype(np.int64), {"Yaw": np.zeros(len(t_s))})
    section = section_of(performance(NLon=at(0, 1), MaxT=at(0, 401_000, 20_100)), fast)
    finding = finding_of(section, "scheduler.longest_loop_disarmed")
    assert finding.sentence == (
        "One loop took 401 ms, 20 periods, not armed, between 0:03.6 and 0:04.0, with: the log begins"
    )
    assert (finding.evidence[0].at_ns, finding.evidence[0].until_ns) == (3_599_000_000, 4 * SECOND)


@pytest.mark.parametrize("period_s", [0.045, 0.055])
def test_messages_of_about_every_loop_show_a_pause(period_s: float) -> None:
    """Up to 2.5 periods of 20 ms."""
    t_s = np.arange(0.0, 100.0, period_s)
    t_s = t_s[(t_s <= 41.0) | (t_s >= 41.4)]
    slow = MadeTable("IMU", np.round(t_s * SECOND).astype(np.int64), {"A": np.zeros(len(t_s))})
    section = section_of(performance(NLon=at(4, 1), MaxT=at(4, 400_000, 20_100)), slow)
    begin_s = section.grids[0].rows[0][4]
    assert (begin_s is not None) is (period_s < 0.05)


@pytest.mark.parametrize(
    ("load", "key", "sentence"),
    [
        (np.full(10, 800), None, ""),
        (np.full(10, 806), "scheduler.load", "The processor was 81 % busy"),
        (
            at(3, 1000, 100) + at(5, 900), "scheduler.load_saturated",
            "Load was at 100 % in 2 of 10 windows, first at 0:40.0: the loop rate fell under 95 % of its target",
        ),
        (at(3, 999, 100), None, ""),
    ],
)  # fmt: skip
def test_load(load: np.ndarray, key: str | None, sentence: str) -> None:
    section = section_of(performance(Load=load), NEVER_ARMED)
    assert [(one.key, one.sentence) for one in section.findings if one.severity] == ([(key, sentence)] if key else [])
    known = facts(section)
    assert known["load_saturated"] == (2 if key == "scheduler.load_saturated" else 0)
    assert known["load_max_percent"] == pytest.approx(load.max() / 10.0)


@pytest.mark.parametrize(("rate_hz", "low"), [(47.5, False), (47.4, True)])
def test_a_loop_rate_below_95_per_cent_of_what_is_set(rate_hz: float, low: bool) -> None:
    parameters = MadeTable("PARM", [0], {"Name": ["SCHED_LOOP_RATE"], "Value": [50.0]})
    section = section_of(performance(LR=at(0, 10.0, rate_hz)), parameters, NEVER_ARMED)
    found = [one for one in section.findings if one.key == "scheduler.loop_rate"]
    assert len(found) == low
    for one in found:
        assert one.sentence == "The main loop ran at 47 Hz where SCHED_LOOP_RATE asks for 50 Hz"
        assert one.evidence == (Evidence("PM", "LR", value="47 Hz"),)


def test_time_added_for_late_tasks() -> None:
    finding = finding_of(section_of(performance(Ex=at(4, 70) + at(6, 120)), NEVER_ARMED), "scheduler.late_tasks")
    assert finding.sentence == ("Tasks were eight times late, so up to 120 us were added to each loop, first at 0:50.0")
    assert [(one.at_ns, one.field) for one in finding.evidence] == [(50 * SECOND, "Ex"), (70 * SECOND, "Ex")]


def test_what_this_firmware_does_not_log_is_lacking() -> None:
    section = section_of(performance(NLon=None, Load=None), NEVER_ARMED)
    assert section.lacks == ("PM of this firmware has no NLon (long loops), Load, so that cannot be judged.",)
    assert not {"long_loops", "load_mean_percent", "load_saturated"} & facts(section).keys()
    (lack,) = section_of(NEVER_ARMED).lacks
    assert lack.startswith("The log has no PM")
    assert analyse(MadeLog(NEVER_ARMED, kind="mcap")) is None


# Deadlines


def totals(*rows: tuple[str, str, int, int, int]) -> MadeTable:
    """node, task, cycles, missed, skipped"""
    node, task, cycles, missed, skipped = (np.array(each) for each in zip(*rows, strict=True))
    columns = {"node": node, "task": task, "cycles": cycles, "missed": missed, "skipped": skipped}
    more = {"rate_hz": np.full(len(rows), 50.0), "run_max_s": np.full(len(rows), 0.001)}
    return MadeTable("/tasks", SECOND * np.arange(len(rows)), columns | more)


def misses(*rows: tuple[str, str, float, float, float, int]) -> MadeTable:
    """node, task, due, start and end in s, skipped"""
    node, task, due_s, start_s, end_s, skipped = (np.array(each) for each in zip(*rows, strict=True))
    due_ns, start_ns, end_ns = (np.round(each * SECOND).astype(np.int64) for each in (due_s, start_s, end_s))
    columns = {"node": node, "task": task, "due_ns": due_ns, "start_ns": start_ns, "end_ns": end_ns}
    return MadeTable("/misses", end_ns, columns | {"skipped": skipped})


def run_section(*tables: MadeTable) -> Section:
    return section_of(*tables, kind="mcap", base="simulation")


@pytest.mark.parametrize(
    ("cycles", "missed", "skipped", "severity", "share"),
    [
        (396, 4, 4, Severity.NOTICE, "1.00 %"),
        (394, 4, 4, Severity.WARNING, "1.01 %"),
        (50, 3, 0, Severity.NOTICE, "6.00 %"),  # three are few
        (400, 40, 0, Severity.WARNING, "10.00 %"),
        (399, 40, 0, Severity.CRITICAL, "10.03 %"),
    ],
)
def test_missed_deadlines_by_their_share(
    cycles: int, missed: int, skipped: int, severity: Severity, share: str
) -> None:
    (finding,) = run_section(totals(("LC", "main", cycles, missed, skipped))).findings
    assert finding.sentence == (
        f"{missed} deadlines of LC were missed ({share}: main {missed} of {cycles + skipped}), {skipped} of them "
        "skipped"
    )
    assert finding.severity is severity
    assert finding.evidence == (Evidence("/tasks", "missed"),)


def test_all_tasks_of_a_node_are_one_finding_with_the_worst_deadline() -> None:
    section = run_section(
        totals(("LC", "main", 1000, 2, 0), ("LC", "log", 100, 1, 1), ("PS1", "physics", 4000, 1, 0),
        ("LC", "x", 9, 0, 0)),
        misses(
            ("LC", "main", 5.0, 5.03, 5.04, 0), ("LC", "log", 7.0, 7.02, 7.05, 1), ("LC", "main", 8.0, 8.01, 8.015, 0),
            ("PS1", "physics", 9.0, 9.1, 9.1, 0),
        ),
    )  # fmt: skip
    node, host = section.findings
    assert node.sentence == (
        "3 deadlines of LC were missed (0.27 %: main 2 of 1000, log 1 of 101), 1 of them skipped; the worst, LC log at "
        "0:07.0, 20.0 ms late, ran 30.0 ms, with: nothing that was logged"
    )
    assert node.evidence == (
        Evidence("/tasks", "missed"),
        Evidence("/misses", "due_ns", 5 * SECOND, 5_040_000_000),
        Evidence("/misses", "due_ns", 7 * SECOND, 7_050_000_000),
        Evidence("/misses", "due_ns", 8 * SECOND, 8_015_000_000),
    )
    assert host.sentence.startswith(
        "1 deadlines of PS1 were missed (0.03 %: physics 1 of 4000), 0 of them skipped; the"
    )
    assert "The host was late" in host.next_step
    assert "real-time priority" in node.next_step
    assert facts(section) == {"tasks": 4, "deadlines_missed": 4, "cycles_skipped": 1, "misses_listed": 4}
    assert section.grids[0].rows[1] == (7.0, "LC log", 20.0, 30.0, 1, "nothing that was logged")
    (plot,) = section.plots
    assert {trace.name: trace.y.round(6).tolist() for trace in plot.traces} == {
        "LC main: late": [30.0, 10.0], "LC log: late": [20.0], "PS1 physics: late": [100.0],
        "run time": [10.0, 30.0, 5.0, 0.0],
    }  # fmt: skip
    assert plot.traces[0].x.tolist() == [5 * SECOND, 8 * SECOND]


def test_misses_without_totals_are_listed() -> None:
    section = run_section(misses(("LC", "main", 5.0, 5.03, 5.04, 0), ("LC", "log", 7.0, 7.02, 7.05, 1)))
    (finding,) = section.findings
    assert finding.sentence == "2 deadlines of LC main, LC log were missed, the first at 0:05.0"
    assert finding.evidence == (Evidence("/misses", None, 5 * SECOND, 7_050_000_000),)
    assert facts(section) == {"tasks": 0, "deadlines_missed": 2, "cycles_skipped": 0, "misses_listed": 2}


def leaping(at_s: float, size_s: float) -> MadeTable:
    """/clocks of a run in lockstep with a node whose clock leaps."""
    host_ns = np.arange(0, 60 * SECOND, SECOND // 10)
    node_ns = host_ns + np.where(host_ns >= at_s * SECOND, round(size_s * SECOND), 0)
    columns = {"node": np.array(["LC"] * len(host_ns)), "sample": np.arange(len(host_ns)), "host_ns": host_ns}
    return MadeTable("/clocks", host_ns, columns | {"node_ns": node_ns, "round_trip_s": np.zeros(len(host_ns))})


@pytest.mark.parametrize(
    ("listed", "said", "severity"),
    [
        ((("LC", "main", 20.0, 20.5, 20.5, 25),), "; all because its clock leapt ahead", Severity.NOTICE),
        ((("LC", "main", 20.0, 20.5, 20.5, 20),), "; 20 because its clock leapt ahead", Severity.NOTICE),
        ((("LC", "main", 23.0, 23.5, 23.5, 25),), "", Severity.WARNING),  # too late after it
        ((("LC", "main", 17.0, 17.5, 17.5, 25),), "", Severity.WARNING),
        ((("LC", "main", 20.0, 20.5, 20.5, 0),), "", Severity.WARNING),  # it skipped nothing
    ],
)
def test_cycles_that_a_leap_of_the_clock_skipped_are_nobodys_fault(listed: Any, said: str, severity: Severity) -> None:
    section = run_section(totals(("LC", "main", 975, 25, 25)), misses(*listed), leaping(20.0, 0.5))
    (finding,) = [one for one in section.findings if one.key == "scheduler.deadlines_missed"]
    assert ("because its clock leapt ahead" in finding.sentence) is bool(said)
    assert said in finding.sentence
    assert finding.severity is severity
    assert ("time bases" in finding.next_step) is said.startswith("; all")
    assert len(section.plots[-1].marks) == bool(said)


def test_lockstep_has_no_deadlines_and_tasks_on_time_are_one_sentence() -> None:
    (lack,) = run_section(
        MadeTable("/tasks", [1], {"node": ["LC"], "task": ["a"], "rate_hz": [1.0], "cycles": [1], "missed": [0],
                                  "skipped": [0], "run_max_s": [0.0]})
    ).lacks  # fmt: skip
    assert "lockstep" in lack
    calm = run_section(totals(("LC", "main", 100, 0, 0), ("LC", "log", 10, 0, 0)))
    assert [one.sentence for one in calm.findings] == ["every cycle of 2 tasks kept its time"]
    one = run_section(totals(("LC", "main", 100, 0, 0)))
    assert [one.sentence for one in one.findings] == ["every cycle of 1 task kept its time"]


# Time of each task


def timed(**changed: Any) -> MadeLog:
    columns = {
        "node": np.array(["LC", "LC", "PS1"]), "task": np.array(["slow", "often", "physics"]),
        "rate_hz": [1.0, 50.0, 400.0], "cycles": [10, 500, 4000], "missed": [0, 1, 2], "skipped": [0, 1, 0],
        "start_jitter_mean_s": [0.001, 0.002, 0.003], "start_jitter_max_s": [0.01, 0.05, 0.03],
        "worst_start_ns": [1 * SECOND, 2 * SECOND, 3 * SECOND], "run_mean_s": [0.1, 0.004, np.nan],
        "run_max_s": [0.2, 0.02, np.nan], "worst_run_ns": [4 * SECOND, 5 * SECOND, 0],
    } | changed  # fmt: skip
    return MadeLog(MadeTable("/tasks", [1, 2, 3], columns), kind="mcap", base="simulation")


def test_tasks_are_ordered_by_the_processor_that_they_take() -> None:
    section = tasks.analyse(timed())
    assert section is not None
    assert facts(section) == {"tasks": 3, "longest_run_ms": 200.0, "latest_start_ms": 50.0}
    assert [fact.label for fact in section.facts][1:] == ["Longest run (LC slow)", "Latest start (LC often)"]
    assert section.grids[0].rows == (
        ("LC often", 50.0, 500, 1, 1, 2.0, 50.0, 2.0, 4.0, 20.0, 5.0, 20.0),  # 4 ms of 20 ms
        ("LC slow", 1.0, 10, 0, 0, 1.0, 10.0, 1.0, 100.0, 200.0, 4.0, 10.0),
        ("PS1 physics", 400.0, 4000, 2, 0, 3.0, 30.0, 3.0, None, None, None, None),
    )


LINE = "{:<30}MIN={:4d} MAX={:4d} AVG={:4d} OVR={:3d} SLP=  0, TOT={:4.1f}%\n"


def test_tasks_of_ardupilot_are_ordered_by_their_share(tmp_path: Path) -> None:
    rows = [
        ("a*", 1, 20, 5, 0, 10.0), ("b", 2, 9999, 9999, 999, 60.0), ("c", 3, 30, 7, 4, 10.0), ("d", 0, 0, 0, 0, 0.0),
        ("e", 0, 0, 0, 1, 0.0), ("f", 1, 2, 1, 2, 0.0), ("g", 1, 2, 1, 3, 0.0), ("h", 1, 1, 1, 5, 0.0),
    ]  # fmt: skip
    (tmp_path / "tasks.txt").write_text("TasksV2\n" + "".join(LINE.format(*row) for row in rows))
    section = tasks.analyse(MadeLog(NEVER_ARMED, path=str(tmp_path / "log.bin")))
    assert section is not None
    assert facts(section) == {"scheduler_tasks": 8, "longest_task_us": 9999, "overruns": 1014}
    assert section.grids[0].rows[:4] == (
        ("b", "", 60.0, "9999 or more", "9999 or more", 2, "999 or more"),
        ("c", "", 10.0, 7, 30, 3, 4),
        ("a", "yes", 10.0, 5, 20, 1, 0),
        ("f", "", 0.0, 1, 2, 1, 2),
    )
    assert [row[0] for row in section.grids[0].rows] == ["b", "c", "a", "f", "g", "h", "e"]  # d never ran
    (finding,) = section.findings
    assert finding.sentence == (
        "6 of 8 tasks ran longer than the scheduler allows them: b 999 (up to 9999 us), h 5 (up to 1 us), "
        "c 4 (up to 30 us), g 3 (up to 2 us), f 2 (up to 2 us) and 1 more"
    )
    assert finding.evidence == (Evidence("tasks.txt", "OVR", value="1014"),)


def test_tasks_in_time_and_tasks_without_time(tmp_path: Path) -> None:
    path = tmp_path / "log.tasks.txt"
    log = MadeLog(NEVER_ARMED, path=str(tmp_path / "log.bin"))
    path.write_text(LINE.format("a", 1, 20, 5, 0, 100.0))
    section = tasks.analyse(log)
    assert section is not None
    assert [one.sentence for one in section.findings] == ["None of 1 tasks ran longer than it is allowed"]
    path.write_text(LINE.format("a", 0, 0, 0, 0, 0.0))
    section = tasks.analyse(log)
    assert section is not None
    assert section.lacks == ("log.tasks.txt lists 1 tasks without any time: nothing was counted yet.",)


def embedded(*pieces: tuple[str, int, int, bytes]) -> MadeTable:
    name, offset, length, data = zip(*pieces, strict=True)
    columns = {"FileName": np.array(name), "Offset": np.array(offset), "Length": np.array(length)}
    return MadeTable("FILE", np.arange(len(pieces)), columns | {"Data": np.array([*data, None], dtype=object)[:-1]})


def test_a_file_inside_the_log_comes_before_one_beside_it(tmp_path: Path) -> None:
    (tmp_path / "tasks.txt").write_text(LINE.format("beside", 1, 20, 5, 0, 100.0))
    text = LINE.format("inside", 1, 20, 5, 0, 100.0).encode()
    table = embedded(("@SYS/tasks.txt", 0, 40, text[:40]), ("@SYS/tasks.txt", 40, len(text) - 40, text[40:]))
    section = tasks.analyse(MadeLog(table, path=str(tmp_path / "log.bin")))
    assert section is not None
    assert section.grids[0].rows[0][0] == "inside"
    assert "FILE @SYS/tasks.txt" in section.grids[0].title


def test_pieces_of_a_file_are_put_in_their_places() -> None:
    files = embedded_files(
        MadeLog(
            embedded(
                ("a", 0, 3, b"old"), ("a", 6, 2, b"zz"), ("b", 4, 2, b"xyz"), ("a", 0, 2, b"new"), ("a", 5, 1, b"!"),
                ("a", -1, 1, b"?"), ("a", 2, 9, b"short"), ("c", (64 << 20) + 1, 1, b"?"),
                ("e", 0, -1, b"?"), ("a", 1, 2, b"EW"),
            )
        )
    )  # fmt: skip
    a, b = files["a"], files["b"]
    assert (a.content, a.gaps, a.lost_bytes, a.refused) == (b"nEW\0\0!", 1, 2, 2)
    assert (b.content, b.gaps, b.lost_bytes, b.refused) == (b"\0\0\0\0xy", 1, 4, 0)
    assert [(files[name].content, files[name].refused) for name in ("c", "e")] == [(b"", 1), (b"", 1)]
