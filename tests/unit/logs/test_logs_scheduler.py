"""Long loops and missed deadlines, by the meaning of the fields in every version, with what else happened then."""

from __future__ import annotations

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from tests.recorded import LINUX
from xitl_cli.logs.model.sections import Severity
from xitl_cli.logs.signals.deadlines import loop_windows, simulated_clock_reason, task_totals
from xitl_cli.plugins.logs.analyses.scheduler import analyse

SECOND = 1_000_000_000
STAMPS = np.arange(1, 7) * 10 * SECOND
LONG = np.array([0, 0, 3, 0, 0, 0])
LONGEST_US = np.array([20_100, 20_200, 300_000, 20_100, 20_300, 20_100])
LOAD = np.array([110, 120, 400, 120, 115, 118])

VERSIONS = {
    "2018": {"NLon": LONG, "NLoop": 500, "MaxT": LONGEST_US, "Mem": 1000, "Load": LOAD},
    "4.0": {"NLon": LONG, "NLoop": 500, "MaxT": LONGEST_US, "Mem": 1000, "Load": LOAD, "IntEC": 4, "ExUS": 0},
    "4.1": {"NLon": LONG, "NLoop": 500, "MaxT": LONGEST_US, "Mem": 1000, "Load": LOAD, "ErrC": 4, "Ex": 0},
    "4.7": {"LR": 50, "NLon": LONG, "NL": 500, "MaxT": LONGEST_US, "Mem": 1000, "Load": LOAD, "ErC": 4, "Ex": 0},
}


def performance(version: str) -> MadeTable:
    columns = {name: np.broadcast_to(value, len(STAMPS)) for name, value in VERSIONS[version].items()}
    return MadeTable("PM", STAMPS, columns)


def attitude(pause_from_s: float, pause_s: float) -> MadeTable:
    t_s = np.arange(0.5, 60.0, 0.02)
    t_s = t_s[(t_s <= pause_from_s) | (t_s >= pause_from_s + pause_s)]
    return MadeTable("ATT", np.round(t_s * 1e9), {"Yaw": np.zeros(len(t_s))})


@pytest.mark.parametrize("version", VERSIONS)
def test_one_meaning_whatever_the_version_calls_it(version: str) -> None:
    found = loop_windows(MadeLog(performance(version)))
    assert found is not None
    assert found.loops.tolist() == [500.0] * 6
    assert found.load_percent.max() == pytest.approx(40.0)
    assert found.period_s == pytest.approx(0.02)
    assert (found.until_ns - found.from_ns).tolist() == [10 * SECOND] * 6


@pytest.mark.parametrize("version", VERSIONS)
def test_the_long_loop_is_placed_with_what_happened_then(version: str) -> None:
    armed = MadeTable("ARM", [20 * SECOND], {"ArmState": [1]})
    mode = MadeTable("EV", [round(25.1 * SECOND)], {"Id": [25]})
    files = MadeTable(
        "FILE",
        np.arange(24 * SECOND, 26 * SECOND, SECOND // 10),
        {"FileName": np.array(["@SYS/uarts.txt"] * 20), "Offset": np.arange(20), "Length": np.zeros(20, int)},
    )
    section = analyse(MadeLog(performance(version), attitude(25.0, 0.3), armed, mode, files))
    assert section is not None
    (finding,) = [one for one in section.findings if one.key == "scheduler.longest_loop"]
    assert finding.severity == Severity.WARNING
    assert "300 ms" in finding.sentence
    assert "@SYS/uarts.txt" in finding.sentence
    (evidence,) = finding.evidence
    assert evidence.at_ns == pytest.approx(25.0e9, abs=0.021e9)
    assert evidence.until_ns == pytest.approx(25.3e9, abs=0.021e9)
    facts = {fact.key: fact.value for fact in section.facts}
    assert (facts["loops"], facts["long_loops"], facts["longest_loop_us"]) == (3000, 3, 300_000)


def test_totals_of_logged_tasks_are_in_seconds_and_the_last_of_each() -> None:
    columns = {"I": [0, 1, 0], "Name": np.array(["control", "link", "control"]), "Rate": [50.0, 10.0, 50.0]}
    counts = {"N": [50, 10, 100], "Miss": [0, 1, 3], "Skip": [0, 0, 2]}
    parts_us = {"JMax": [10.0, 20.0, 250.0], "JMean": [1.0, 2.0, 3.0], "RMax": [500.0, 40.0, 1500.0]}
    tasks = MadeTable("TASK", STAMPS[:3], {**columns, **counts, **parts_us, "RMean": [90.0, 8.0, 100.0]})
    worst = MadeTable("TSKQ", STAMPS[:1], {"I": [0], "JAtUS": [7_000_000], "RAtUS": [9_000_000]})
    control, link = task_totals(MadeLog(tasks, worst))
    assert (control.task, control.rate_hz, control.cycles, control.missed, control.skipped) == (
        "control",
        50,
        100,
        3,
        2,
    )
    durations_s = (control.start_mean_s, control.start_max_s, control.run_mean_s, control.run_max_s)
    assert durations_s == pytest.approx((3e-6, 250e-6, 100e-6, 1500e-6))
    assert (control.worst_start_ns, control.worst_run_ns) == (7 * SECOND, 9 * SECOND)
    assert (link.task, link.run_max_s, link.worst_run_ns) == ("link", pytest.approx(40e-6), None)


def test_without_a_version_a_load_of_zero_and_loops_of_one_length_are_of_a_simulated_clock() -> None:
    columns = {name: np.broadcast_to(value, len(STAMPS)) for name, value in VERSIONS["4.7"].items()}
    still = MadeTable("PM", STAMPS, {**columns, "Load": np.zeros(len(STAMPS)), "MaxT": np.full(len(STAMPS), 20_000)})
    assert "load is always 0" in simulated_clock_reason(MadeLog(still))
    board = MadeTable("VER", [SECOND], {"BT": [1]})
    assert simulated_clock_reason(MadeLog(still, board)) == ""


def test_in_a_simulator_it_is_no_evidence() -> None:
    version = MadeTable("VER", [SECOND], {"BT": [3]})
    section = analyse(MadeLog(performance("4.7"), version))
    assert section is not None
    (finding,) = section.findings
    assert (finding.key, finding.severity) == ("scheduler.simulated_clock", Severity.NOTICE)
    lockstep = MadeTable("MSG", [1], {"Message": ["Lockstep: loop times are the clock's own; no CPU load"]})
    assert "lockstep" in simulated_clock_reason(MadeLog(performance("4.7"), lockstep))
    assert simulated_clock_reason(MadeLog(performance("4.7"))) == ""


def test_every_missed_deadline_has_its_delay_and_company() -> None:
    tasks = MadeTable(
        "/tasks",
        [10 * SECOND, 20 * SECOND],
        {
            "node": ["LC", "LC"],
            "task": ["control", "control"],
            "rate_hz": [50.0, 50.0],
            "cycles": [480, 970],
            "missed": [20, 30],
            "skipped": [20, 30],
            "start_jitter_max_s": [0.4, 0.4],
            "run_max_s": [0.002, 0.002],
        },
    )
    misses = MadeTable(
        "/misses",
        [round(5.4 * SECOND), round(12.2 * SECOND)],
        {
            "node": ["LC", "LC"],
            "task": ["control", "control"],
            "due_ns": [5 * SECOND, 12 * SECOND],
            "start_ns": [round(5.4 * SECOND), round(12.2 * SECOND)],
            "end_ns": [round(5.402 * SECOND), round(12.201 * SECOND)],
            "skipped": [20, 10],
        },
    )
    faults = MadeTable("/faults", [round(4.9 * SECOND)], {"fault": ["busy"], "active": [1]})
    section = analyse(MadeLog(tasks, misses, faults, kind="mcap", base="simulation"))
    assert section is not None
    (finding,) = section.findings
    assert finding.severity == Severity.WARNING  # 30 of 1000
    assert "control 30 of 1000" in finding.sentence
    assert "400.0 ms late" in finding.sentence
    assert "fault busy begins" in finding.sentence
    assert [row[:5] for row in section.grids[0].rows] == [
        (5.0, "LC control", 400.0, 2.0, 20),
        (12.0, "LC control", 200.0, 1.0, 10),
    ]


def test_the_start_of_a_real_autopilot_is_seen() -> None:
    from xitl_cli.logs import open_log

    with open_log(LINUX) as log:
        section = analyse(log)
    assert section is not None
    assert section.worst == Severity.NOTICE
    (finding,) = [one for one in section.findings if one.key == "scheduler.longest_loop_disarmed"]
    assert "401 ms" in finding.sentence
    assert "the log begins" in finding.sentence


@pytest.mark.parametrize("values", [[], [np.nan], [-1.0, 1e300]])
def test_garbage_is_no_error(values: list[float]) -> None:
    names = ("NLon", "NL", "MaxT", "Load", "LR", "Ex", "SPIC")
    table = MadeTable("PM", np.arange(len(values)), {name: np.array(values) for name in names})
    tables = [table] if values else []
    section = analyse(MadeLog(*tables))
    assert section is not None
    assert section.worst <= Severity.CRITICAL
    for fact in section.facts:
        assert fact.value == fact.value, fact.key  # NaN is not equal to itself
