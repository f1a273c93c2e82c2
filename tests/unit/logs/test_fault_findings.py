"""Injected faults and takeovers: spans, effects by the profile, and what was counted in their time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from xitl_cli.logs.model.sections import Evidence, Section, Severity
from xitl_cli.plugins.logs.analyses.faults import EXPECTED, FaultSpan, analyse, fault_spans

SECOND = 1_000_000_000
REST = MadeTable("/truth/state", [0, 60 * SECOND], {"a": [0, 0]})


def faults(*changes: tuple[float, str, int]) -> MadeTable:
    at_s, name, active = (np.array(each) for each in zip(*changes, strict=True))
    return MadeTable("/faults", np.round(at_s * SECOND).astype(np.int64), {"fault": name, "active": active})


def section_of(*tables: MadeTable, path: str = "run.mcap") -> Section:
    section = analyse(MadeLog(*tables, REST, kind="mcap", base="simulation", path=path))
    assert section is not None
    return section


def test_a_fault_lasts_from_its_first_beginning_to_its_end() -> None:
    table = faults((5.0, "b", 1), (2.0, "a", 1), (3.0, "a", 1), (4.0, "a", 0), (4.5, "c", 0), (6.0, "a", 1))
    assert fault_spans(MadeLog(table, kind="mcap")) == [
        FaultSpan("a", 2 * SECOND, 4 * SECOND, ()),
        FaultSpan("b", 5 * SECOND, None, ()),
        FaultSpan("a", 6 * SECOND, None, ()),
    ]
    assert fault_spans(MadeLog(MadeTable("/faults", [1], {"fault": ["a"]}), kind="mcap")) == []


def profile(folder: Path, text: str) -> str:
    (folder / "profile.yaml").write_text(text)
    return str(folder / "run.mcap")


def test_the_effects_of_a_fault_are_those_of_the_profile(tmp_path: Path) -> None:
    path = profile(
        tmp_path,
        "faults:\n"
        "  cut: {at_s: 3, link: {cut: true, loss: 0.0, delay_s: 0.2, colour: red}, vessel: {mass_kg: 3}}\n"
        "  bias: {imu: {gyro_bias_frd_radps: [0, 0, 0.1], accel_bias_frd_mps2: [0, 0, 0]}, gnss: 7}\n"
        "  odd: 3\n",
    )
    section = section_of(faults((3.0, "cut", 1), (7.0, "bias", 1), (9.0, "cut", 0), (10.0, "odd", 1)), path=path)
    cut, bias, odd = section.findings
    assert cut.sentence == (
        "On purpose: cut from 0:03.0 to 0:09.0 (link.cut True, link.delay_s 0.2); expected: no frames on the link, "
        "gaps in its sequence (links); latencies longer by as much (links)"
    )
    assert cut.evidence == (Evidence("/faults", "active", 3 * SECOND, 9 * SECOND, "link.cut True, link.delay_s 0.2"),)
    assert (cut.key, cut.severity) == ("faults.injected", Severity.NOTICE)
    assert bias.sentence == (
        "On purpose: bias from 0:07.0 to the end (imu.gyro_bias_frd_radps [0, 0, 0.1]); expected: "
        "gyroscopes that do not agree with the compass, heading innovations (estimator)"
    )
    assert odd.sentence == "On purpose: odd from 0:10.0 to the end (not told)"
    assert {fact.key: fact.value for fact in section.facts} == {"faults": 3, "takeovers": 0}


def test_equal_effects_are_named_once() -> None:
    fault = FaultSpan(
        "stuck", 0, None, (("propeller", "stuck", "True"), ("propeller", "stuck_at", "0.3"), ("x", "y", ""))
    )
    assert fault.expected == EXPECTED["propeller"]["stuck"]
    assert fault.what == "propeller.stuck True, propeller.stuck_at 0.3, x.y "


@pytest.mark.parametrize(
    "text", ["faults: [1]", "[1, 2]", "3", "faults: {cut: {link: [1]}}", "a: [", "faults: {3: {}}"]
)
def test_a_profile_that_tells_nothing_is_no_error(tmp_path: Path, text: str) -> None:
    section = section_of(faults((3.0, "cut", 1)), path=profile(tmp_path, text))
    assert section.findings[0].sentence == "On purpose: cut from 0:03.0 to the end (not told)"


def test_a_vessel_of_a_fleet_has_the_faults_of_its_own(tmp_path: Path) -> None:
    text = (
        "faults: {all: {link: {cut: true}}, mine: {link: {cut: true}}}\n"
        "vessels: {b: {faults: {mine: {battery: {failed_cells: 2}}}}}\n"
    )
    path = profile(tmp_path, text)
    log = MadeLog(faults((1.0, "all", 1), (2.0, "mine", 1)), REST, kind="mcap", base="simulation", path=path)
    assert [fault.what for fault in fault_spans(log)] == ["link.cut True", "link.cut True"]
    log.vessel = "b"
    assert [fault.what for fault in fault_spans(log)] == ["link.cut True", "battery.failed_cells 2"]
    log.vessel = "c"
    assert [fault.what for fault in fault_spans(log)] == ["link.cut True", "link.cut True"]


def test_the_table_counts_what_happened_up_to_a_second_after_each_fault() -> None:
    links = MadeTable(
        "/links",
        SECOND * np.array([0, 2, 4, 8, 9, 0, 5, 9]),
        {
            "name": np.array(["a"] * 5 + ["b"] * 3), "lost": [0, 5, -1, 20, 90, 1, 1, 1],
            "gaps": [0, 0, 9, 9, 9, 1, 4, 8],
        },
    )  # fmt: skip
    due_ns = (np.array([2.9, 3.0, 8.0, 8.1]) * SECOND).astype(np.int64)
    misses = MadeTable(
        "/misses", due_ns,
        {"node": ["LC"] * 4, "task": ["m"] * 4, "due_ns": due_ns, "start_ns": due_ns + 5, "end_ns": due_ns + 6,
         "skipped": [0] * 4},
    )  # fmt: skip
    section = section_of(faults((3.0, "cut", 1), (7.0, "cut", 0)), links, misses)
    (grid,) = section.grids
    (row,) = grid.rows
    assert dict(zip(grid.columns, row, strict=True)) == {
        "fault": "cut", "from (s)": 3.0, "until (s)": 7.0, "what": "not told", "to be seen": None,
        "frames lost then": 15 + 3, "deadlines missed": 2, "clock steps": None,
    }  # fmt: skip


def test_without_counts_the_table_knows_none() -> None:
    (row,) = section_of(faults((3.0, "cut", 1))).grids[0].rows
    assert row == ("cut", 3.0, None, "not told", None, None, None, None)


def test_a_fault_to_the_end_counts_to_the_end() -> None:
    links = MadeTable("/links", SECOND * np.array([2, 60]), {"name": ["a", "a"], "lost": [1, 7], "gaps": [1, 7]})
    assert section_of(faults((3.0, "cut", 1)), links).grids[0].rows[0][5] == 6


def test_steps_of_a_clock_belong_to_a_fault_within_a_second() -> None:
    host_ns = np.arange(0, 60 * SECOND, SECOND // 10)
    node_ns = host_ns + np.where(host_ns >= 20 * SECOND, SECOND // 4, 0)
    clocks = MadeTable(
        "/clocks", host_ns,
        {"node": np.array(["LC"] * len(host_ns)), "sample": np.arange(len(host_ns)), "host_ns": host_ns,
         "node_ns": node_ns, "round_trip_s": np.zeros(len(host_ns))},
    )  # fmt: skip
    for begin_s, end_s, steps in (
        (20.9, 30.0, "+0.250 s"), (21.2, 30.0, None), (10.0, 19.1, "+0.250 s"), (10.0, 18.9, None),
    ):  # fmt: skip
        (row,) = section_of(faults((begin_s, "jump", 1), (end_s, "jump", 0)), clocks).grids[0].rows
        assert row[-1] == steps
        assert row[6] == 0  # a run with clocks lists its misses


def test_a_band_for_each_fault() -> None:
    (plot,) = section_of(faults((3.0, "cut", 1), (7.0, "cut", 0), (8.0, "jump", 1))).plots
    assert [(trace.name, trace.x.tolist(), trace.y.tolist()) for trace in plot.traces] == [
        ("cut", [3 * SECOND, 7 * SECOND], [0.0, 0.0]), ("jump", [8 * SECOND, 60 * SECOND], [1.0, 1.0]),
    ]  # fmt: skip
    assert [(mark.at_ns, mark.until_ns, mark.text) for mark in plot.marks] == [
        (3 * SECOND, 7 * SECOND, "cut"), (8 * SECOND, 60 * SECOND, "jump"),
    ]  # fmt: skip


def takeovers(*rows: tuple[float, str, str, float, float]) -> MadeTable:
    at_s, one, other, silent_s, step = (np.array(each) for each in zip(*rows, strict=True))
    columns: dict[str, Any] = {"from_node": one, "to_node": other, "silent_s": silent_s, "step": step}
    return MadeTable("/takeovers", np.round(at_s * SECOND).astype(np.int64), columns)


def test_a_takeover_has_its_silence_and_its_step() -> None:
    section = section_of(takeovers((12.0, "LC", "LC2", 0.4567, 0.123), (13.0, "LC2", "LC", np.nan, np.inf)))
    first, second = section.findings
    assert first.sentence == (
        "At 0:12.0 LC2 took over from LC, which had been silent for 0.46 s; a motor command stepped by 0.12 at most"
    )
    assert first.evidence == (Evidence("/takeovers", "from_node", 12 * SECOND, value="0.457 s"),)
    assert second.sentence == "At 0:13.0 LC took over from LC2"
    assert second.evidence == (Evidence("/takeovers", "from_node", 13 * SECOND, value=""),)
    assert section.grids[0].rows == ((12.0, "LC", "LC2", 0.457, 0.123), (13.0, "LC2", "LC", None, None))
    assert {fact.key: fact.value for fact in section.facts} == {"faults": 0, "takeovers": 2}
    assert section.plots == ()


def test_a_run_without_faults_and_takeovers_has_no_section() -> None:
    assert analyse(MadeLog(REST, kind="mcap")) is None
    assert analyse(MadeLog(MadeTable("/takeovers", [1], {"from_node": ["LC"]}), kind="mcap")) is None
