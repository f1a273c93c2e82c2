"""How two logs are laid on one time line, and what is said when they cannot be."""

from __future__ import annotations

import re

import numpy as np
import pytest
from made_log import MadeLog, MadeTable
from made_vessel import Array, vessel

from tests.golden import Golden, line_with
from xitl_cli.logs.compare.comparison import compare
from xitl_cli.logs.compare.pairing import StartEvent, pair_logs
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.sections import Severity


def leaves(at_s: float) -> dict[str, object]:
    """Still, then away at 2 m/s."""

    def speed(t_s: Array) -> Array:
        return np.where(t_s < at_s, 0.0, 2.0)

    return {"speed_mps": speed, "north_m": lambda t: 2.0 * np.maximum(t - at_s, 0.0)}


def at_s(log: MadeLog, stamp_ns: int) -> float:
    assert log.span_ns is not None
    return (stamp_ns - log.span_ns[0]) * 1e-9


def laid_s(a: MadeLog, b: MadeLog, start: StartEvent, b_s: float) -> float:
    """Where a second of B comes to lie, in seconds of A."""
    assert b.span_ns is not None
    return at_s(a, pair_logs(a, b, start).instant(b.span_ns[0] + round(b_s * 1e9)))


def test_missions_begin_together() -> None:
    a = vessel("a", armed_s=4.0, auto_s=6.0, **leaves(7.0))  # type: ignore[arg-type]
    b = vessel("b", armed_s=30.0, auto_s=20.0, boot_s=900.0, **leaves(31.0))  # type: ignore[arg-type]
    found = pair_logs(a, b)
    assert found.method == "mission"
    assert laid_s(a, b, "auto", 30.0) == pytest.approx(6.0)  # b was armed in AUTO: that began it
    assert laid_s(a, b, "armed", 30.0) == pytest.approx(4.0)
    assert laid_s(a, b, "motion", 31.0) == pytest.approx(7.0)


def test_without_a_mission_arming_lays_them() -> None:
    a, b = vessel("a", armed_s=4.0), vessel("b", armed_s=9.0, boot_s=100.0)
    assert pair_logs(a, b).method == "armed"
    assert laid_s(a, b, "auto", 9.0) == pytest.approx(4.0)


def test_without_arming_motion_lays_them() -> None:
    a, b = vessel("a", **leaves(10.0)), vessel("b", boot_s=50.0, **leaves(25.0))  # type: ignore[arg-type]
    assert pair_logs(a, b).method == "motion"
    assert laid_s(a, b, "auto", 25.0) == pytest.approx(10.0)


def test_a_jump_of_the_estimator_is_no_motion() -> None:
    def speed(t_s: Array) -> Array:
        return np.where(np.abs(t_s - 3.0) < 0.15, 9.0, np.where(t_s > 20.0, 2.0, 0.0))

    a, b = vessel("a", speed_mps=speed), vessel("b", **leaves(20.1))  # type: ignore[arg-type]
    assert laid_s(a, b, "motion", 20.1) == pytest.approx(20.1, abs=0.11)


def test_a_shared_signal_lays_them() -> None:
    rng = np.random.default_rng(3)
    knots = np.cumsum(rng.normal(size=200))

    def wander(t_s: Array) -> Array:
        return np.interp(t_s, np.arange(200.0), knots)

    a = vessel("a", yaw_deg=lambda t: 10.0 * wander(t + 20.0), until_s=100.0)
    b = vessel("b", yaw_deg=lambda t: 10.0 * wander(t + 32.0), until_s=100.0, boot_s=77.0)
    assert laid_s(a, b, "correlation", 0.0) == pytest.approx(12.0, abs=0.1)


def test_a_shift_that_is_asked_for() -> None:
    a, b = vessel("a", armed_s=4.0), vessel("b", armed_s=9.0, boot_s=100.0)
    found = pair_logs(a, b, shift_s=2.5)
    assert b.span_ns is not None
    assert at_s(a, found.instant(b.span_ns[0])) == pytest.approx(2.5)


def test_one_file_lies_on_itself() -> None:
    one = vessel("one")
    found = pair_logs(one, one)
    assert found.method == "same file"
    assert found.instant(123) == 123


@pytest.mark.parametrize(
    ("start", "words"),
    [("mission", "A does not show when it navigated"), ("armed", "A does not show when it armed"), ("motion", "moved")],
)
def test_what_is_not_in_both_is_said(start: StartEvent, words: str) -> None:
    with pytest.raises(LogError, match=re.escape(words)) as raised:
        pair_logs(vessel("a"), vessel("b"), start)
    assert "--shift SECONDS" in str(raised.value)
    assert "\n" not in str(raised.value)


def test_two_logs_with_nothing_in_common() -> None:
    a = vessel("a")
    b = MadeLog(MadeTable("BARO", [1, 2, 3], {"Alt": [0.0, 0.1, 0.2]}), path="/made/b.bin")
    with pytest.raises(LogError, match="cannot be aligned in time"):
        pair_logs(a, b)


def test_an_empty_log() -> None:
    with pytest.raises(LogError, match=r"empty\.bin: has no time stamps"):
        pair_logs(vessel("a"), MadeLog(path="/made/empty.bin"))


def test_spans_that_do_not_meet(golden: Golden) -> None:
    found = compare(vessel("a"), vessel("b"), shift_s=500.0)
    assert found.trajectories is None
    lacks = [lack for section in found.sections for lack in section.lacks]
    golden("lack", line_with(lacks, "paths are not compared"))


def test_logs_without_a_position() -> None:
    a = MadeLog(MadeTable("ATT", np.arange(10) * 10**8, {"Yaw": np.arange(10.0)}), path="/made/a.bin")
    b = MadeLog(MadeTable("ATT", np.arange(10) * 10**8, {"Yaw": np.arange(10.0) + 1.0}), path="/made/b.bin")
    found = compare(a, b, shift_s=0.0)
    assert found.trajectories is None
    sections = {section.key: section for section in found.sections}
    assert sections["trajectory"].lacks == ("The paths are not compared: A and B hold no position.",)
    assert sections["motion"].grids[0].rows[0][0] == "yaw"


@pytest.mark.parametrize("rows", [1, 2, 3])
def test_logs_of_a_few_rows(rows: int) -> None:
    stamps = np.arange(rows) * 10**8
    values = {"Lat": np.full(rows, 1.0), "Lng": np.full(rows, 2.0), "Alt": np.full(rows, 3.0)}
    a, b = (MadeLog(MadeTable("POS", stamps, values), path=f"/made/{name}.bin") for name in "ab")
    found = compare(a, b, shift_s=0.0, align="se3")
    assert (found.trajectories is None) == (rows == 1)


def test_rows_that_are_no_numbers() -> None:
    stamps = np.arange(50) * 10**8
    latitude = np.full(50, 1.0)
    latitude[::2] = np.nan
    values = {"Lat": latitude, "Lng": np.full(50, 2.0), "Alt": np.full(50, np.inf)}
    values["Alt"][1::4] = 1e30
    a, b = (MadeLog(MadeTable("POS", stamps, values), path=f"/made/{name}.bin") for name in "ab")
    found = compare(a, b, shift_s=0.0)
    for section in found.sections:
        for grid in section.grids:
            for row in grid.rows:
                assert all(not isinstance(cell, float) or np.isfinite(cell) for cell in row), row


def test_times_that_leave_nothing() -> None:
    a, b = vessel("a", armed_s=4.0), vessel("b")
    with pytest.raises(LogError, match="nothing to compare"):
        compare(a, b, shift_s=0.0, from_s=9.0, until_s=8.0)
    with pytest.raises(LogError, match="B does not show when it was armed"):
        compare(a, b, shift_s=0.0, armed=True)


def test_only_while_both_were_armed() -> None:
    found = compare(vessel("a", armed_s=10.0), vessel("b", armed_s=15.0), shift_s=0.0, armed=True)
    said = {fact.key: fact.value for fact in found.sections[0].facts}
    assert said["common_time_s"] == pytest.approx(45.0)


def test_another_place_is_a_warning() -> None:
    found = compare(vessel("a"), vessel("b", north_m=lambda t: 5e3 + 0.0 * t), shift_s=0.0)
    warnings = {each.key: each for section in found.sections for each in section.findings}
    assert warnings["trajectory.elsewhere"].severity == Severity.WARNING
    assert "5.0 km" in warnings["trajectory.elsewhere"].sentence
    moved = compare(vessel("a"), vessel("b", north_m=lambda t: 5e3 + 0.0 * t), shift_s=0.0, align="origin")
    assert "trajectory.elsewhere" not in {each.key for section in moved.sections for each in section.findings}


def test_a_path_that_leaves_the_fit_open_is_said() -> None:
    found = compare(vessel("a"), vessel("b"), shift_s=0.0, align="se3")
    keys = {each.key for section in found.sections for each in section.findings}
    assert "trajectory.not_aligned" in keys


def test_another_kind_of_vehicle_is_compared_too() -> None:
    def copter(name: str, stamp_ns: int) -> MadeLog:
        log = vessel(name, until_s=5.0)
        log.tables["MSG"] = MadeTable("MSG", [stamp_ns], {"Message": ["ArduCopter V4.5.1 (deadbeef)"]})
        log.tables["MODE"] = MadeTable("MODE", [5_500_000_000], {"ModeNum": [3], "Mode": [3]})
        log.tables["ARM"] = MadeTable("ARM", [6_000_000_000], {"ArmState": [1]})
        return log

    assert pair_logs(copter("a", 5 * 10**9), copter("b", 5 * 10**9)).method == "mission"
