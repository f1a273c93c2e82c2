"""Control: the error, share and duration from which a loss is told, its figures, and steps of a setpoint by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from xitl_cli.logs.model.sections import Evidence, Finding, Section, Severity
from xitl_cli.plugins.logs.analyses import control
from xitl_cli.plugins.logs.analyses.control import response_delay_s, step_responses, unbroken

S = 1_000_000_000
T_S = np.arange(1200) / 10.0
STAMPS = np.arange(1200) * S // 10
COPTER, ROVER = "ArduCopter V4.5.0", "ArduRover V4.5.0"


def analysed(firmware: str, *tables: MadeTable) -> Section:
    section = control.analyse(
        MadeLog(
            MadeTable("MSG", [0], {"Message": [firmware]}),
            MadeTable("ARM", [0, S], {"ArmState": [0, 1]}),
            *tables,
        )
    )
    assert section is not None
    return section


def rows(name: str, units: dict[str, str] | None = None, **columns: Any) -> MadeTable:
    return MadeTable(
        name, STAMPS, {key: np.broadcast_to(value, 1200) for key, value in columns.items()}, units=units or {}
    )


def between(from_s: float, until_s: float, inside: float, outside: float) -> np.ndarray:
    return np.where((from_s - 1e-6 <= T_S) & (until_s + 1e-6 >= T_S), inside, outside)


def attitude(roll: Any, demanded: float = 1.0) -> MadeTable:
    return rows("ATT", Roll=roll, DesRoll=demanded, Pitch=0.0, DesPitch=0.0, Yaw=0.0)


def rate(achieved: Any, demanded: float) -> MadeTable:
    return rows("RATE", {"R": "deg/s", "P": "deg/s", "Y": "deg/s"}, Y=achieved, YDes=demanded, R=0.0, P=0.0)


def speed(achieved: Any, demanded: Any = 2.0) -> MadeTable:
    return rows("THR", DesSpeed=demanded, Speed=achieved)


def turning(achieved: Any, demanded: float = 30.0) -> MadeTable:
    return rows("STER", DesTurnRate=demanded, TurnRate=achieved)


@pytest.mark.parametrize(
    ("firmware", "table", "key"),
    [
        # Under 70 % of the setpoint, and by half a metre a second, for 15 s.
        (ROVER, speed(between(40, 55, 1.3, 2.0)), "control.too_slow"),
        (ROVER, speed(between(40, 54.9, 1.3, 2.0)), None),
        (ROVER, speed(between(40, 55, 1.41, 2.0)), None),
        (ROVER, speed(between(40, 55, 0.49, 1.0), 1.0), "control.too_slow"),
        (ROVER, speed(between(40, 55, 0.51, 1.0), 1.0), None),
        # Over 150 %, and by 0.75 m/s, for 10 s.
        (ROVER, speed(between(40, 50, 3.1, 2.0)), "control.too_fast"),
        (ROVER, speed(between(40, 49.9, 3.1, 2.0)), None),
        (ROVER, speed(between(40, 50, 2.9, 2.0)), None),
        (ROVER, speed(between(40, 50, 1.76, 1.0), 1.0), "control.too_fast"),
        (ROVER, speed(between(40, 50, 1.74, 1.0), 1.0), None),
        (ROVER, speed(between(40, 55, -1.3, -2.0), -2.0), "control.too_slow"),  # astern
        # By 20 deg/s and half of the setpoint for 3 s.
        (ROVER, turning(between(40, 43, 9.0, 30.0)), "control.turn_rate_off"),
        (ROVER, turning(between(40, 42.9, 9.0, 30.0)), None),
        (ROVER, turning(between(40, 43, 11.0, 30.0)), None),
        (ROVER, turning(between(40, 43, 29.0, 60.0), 60.0), "control.turn_rate_off"),
        (ROVER, turning(between(40, 43, 31.0, 60.0), 60.0), None),
        # By 30 deg for 2 s, if it moved by as much.
        (COPTER, attitude(between(40, 42, 31.1, 1.0)), "control.attitude_lost"),
        (COPTER, attitude(between(40, 41.9, 31.1, 1.0)), None),
        (COPTER, attitude(between(40, 42, 31.0, 1.0)), None),
        (COPTER, attitude(between(40, 42, 29.0, 45.0), 45.0), None),
        (COPTER, attitude(between(40, 42, 29.9, -0.2), -0.2), None),
        (COPTER, attitude(between(40, 42, -30.1, 0.1), 0.1), "control.attitude_lost"),
        # By 60 deg/s and all of the setpoint for 1 s.
        (COPTER, rate(between(40, 41, 61.1, 1.0), 1.0), "control.rate_lost"),
        (COPTER, rate(between(40, 40.9, 61.1, 1.0), 1.0), None),
        (COPTER, rate(between(40, 41, 161.0, 80.0), 80.0), "control.rate_lost"),
        (COPTER, rate(between(40, 41, 159.0, 80.0), 80.0), None),
        (COPTER, rate(between(40, 41, 59.0, -2.0), -2.0), None),
    ],
)  # fmt: skip
def test_an_error_is_told_if_large_and_long_enough(firmware: str, table: MadeTable, key: str | None) -> None:
    found = [one for one in analysed(firmware, table).findings if one.severity]
    assert [one.key for one in found] == ([] if key is None else [key])


def only(section: Section) -> Finding:
    (finding,) = [one for one in section.findings if one.severity]
    return finding


def test_a_loss_has_its_worst_instant_and_all_its_spans() -> None:
    slow = between(30, 50, 1.2, 2.0)
    slow = np.where(np.abs(T_S - 41.0) < 0.01, 1.0, slow)
    slow = np.where((T_S >= 70) & (T_S <= 86), 1.25, slow)
    finding = only(analysed(ROVER, speed(slow)))
    assert finding.sentence == (
        "It stayed below the demanded speed by up to 1 m/s, for 20.0 s from 0:30.0 (2 times, 36 s in all): "
        "1 m/s for 2 m/s at 0:41.0"
    )
    assert finding.severity is Severity.WARNING
    assert finding.evidence == (
        Evidence("THR", "DesSpeed", 30 * S, 50 * S, "1 m/s"), Evidence("THR", "DesSpeed", 70 * S, 86 * S, "1 m/s"),
    )  # fmt: skip


def test_short_breaks_of_an_error_are_bridged_and_pauses_of_the_log_are_not() -> None:
    def broken(good_rows: int) -> np.ndarray:
        slow = between(30, 50, 1.2, 2.0)
        slow[400 : 400 + good_rows] = 2.0
        return slow

    assert len(analysed(ROVER, speed(broken(4))).findings) == 1
    assert not [one for one in analysed(ROVER, speed(broken(5))).findings if one.severity]
    slow = between(30, 50, 1.2, 2.0)
    kept = (T_S <= 40.0) | (T_S >= 42.1)
    table = MadeTable("THR", STAMPS[kept], {"DesSpeed": np.full(kept.sum(), 2.0), "Speed": slow[kept]})
    assert not [one for one in analysed(ROVER, table).findings if one.severity]


def test_roll_and_pitch_that_are_lost_together_are_one_loss() -> None:
    lost = between(40, 45, 50.0, 1.0)
    table = rows("ATT", Roll=lost, DesRoll=1.0, Pitch=lost, DesPitch=1.0, Yaw=0.0)
    finding = only(analysed(COPTER, table))
    assert finding.severity is Severity.CRITICAL
    assert finding.sentence == (
        "It lost control: its roll was off the demanded one by up to 49 deg, for 5.0 s from 0:40.0: "
        "50 deg for 1 deg at 0:40.0"
    )
    assert [evidence.field for evidence in finding.evidence] == ["DesRoll", "DesPitch"]


def test_setpoints_that_were_followed_have_their_errors() -> None:
    error = np.tile([0.1, -0.1], 600)
    section = analysed(ROVER, speed(2.0 + error), turning(30.0 - 10.0 * error))
    assert [one.sentence for one in section.findings] == [
        "It followed its setpoints: speed within 0.1 m/s RMS, turn rate within 1 deg/s RMS"
    ]
    assert {fact.key: fact.value for fact in section.facts} == {
        "speed_error_rms_mps": 0.1, "speed_error_max_mps": 0.1, "turn_rate_error_rms_degps": 1.0,
        "turn_rate_error_max_degps": 1.0,
    }  # fmt: skip
    assert section.lacks == (
        "No heading was demanded (NTUN.DesYaw and ATT.DesYaw are 0): it was steered by turn rate.",
    )
    plot = section.plots[0]
    assert (plot.key, plot.y_label) == ("tracking.speed", "m/s")
    assert {trace.name: trace.y[:2].round(9).tolist() for trace in plot.traces} == {
        "demanded": [2.0, 2.0], "achieved": [2.1, 1.9], "error": [0.1, -0.1],
    }  # fmt: skip


def test_a_quarter_of_the_time_beyond_a_limit_is_not_followed() -> None:
    def off(rows_in_a_hundred: int) -> np.ndarray:
        return np.where(np.arange(1200) % 100 < rows_in_a_hundred, 1.0, 2.0)

    assert [one.key for one in analysed(ROVER, speed(off(24))).findings] == ["control.followed"]
    assert analysed(ROVER, speed(off(26))).findings == ()


def test_rows_at_rest_and_while_disarmed_do_not_count() -> None:
    demanded = np.where(T_S < 60.0, 0.19, np.where(T_S < 90.0, 0.21, 0.0))
    section = analysed(ROVER, speed(demanded + 0.05, demanded))
    assert {fact.key: fact.value for fact in section.facts}["speed_error_rms_mps"] == 0.05
    (plot,) = section.plots
    assert (plot.traces[0].x[0], plot.traces[0].x[-1]) == (60 * S, 899 * S // 10)
    log = MadeLog(
        MadeTable("MSG", [0], {"Message": [ROVER]}), MadeTable("ARM", [0, 20 * S, 40 * S], {"ArmState": [0, 1, 0]}),
        speed(1.9, 2.0),
    )  # fmt: skip
    section = control.analyse(log)
    assert section is not None
    assert (section.plots[0].traces[0].x[0], section.plots[0].traces[0].x[-1]) == (20 * S, 40 * S)


def test_what_a_rover_does_not_log_is_lacking() -> None:
    (lack,) = analysed(ROVER, rows("X", A=0.0)).lacks
    assert lack == "No setpoints are logged: no NTUN, THR or STER of Rover, no desired attitude (ATT), no RATE."
    lacks = analysed(ROVER, rows("ATT", Yaw=90.0, DesYaw=90.0)).lacks
    assert [lack.split(" (")[0] for lack in lacks] == [
        "No demanded turn rate is logged", "No demanded speed is logged",
    ]  # fmt: skip
    assert analysed(COPTER, attitude(1.0)).lacks == ()


def test_a_setpoint_that_is_0_throughout_is_none() -> None:
    section = analysed(ROVER, speed(2.0), turning(3.0, 0.0))
    assert [plot.key for plot in section.plots] == ["tracking.speed"]
    assert section.lacks[0].startswith("No demanded turn rate is logged")


# Responses


def test_pauses_of_more_than_two_seconds_break_the_rows() -> None:
    stamps = np.array([0, 1, 3, 6, 7]) * S
    assert unbroken(stamps) == [slice(0, 3), slice(3, 5)]
    assert unbroken(np.array([], dtype=np.int64)) == []


@pytest.mark.parametrize("delay_s", [0.0, 0.73, 2.5])
def test_a_delay_is_found_between_the_rows(delay_s: float) -> None:
    demanded = 10.0 * np.sin(T_S / 3.0)
    found = response_delay_s(STAMPS, demanded, 10.0 * np.sin((T_S - delay_s) / 3.0), 3.0)
    assert found == pytest.approx(delay_s, abs=0.01)


def test_no_delay_without_a_change_or_with_few_rows() -> None:
    demanded = 10.0 * np.sin(T_S / 3.0)
    assert response_delay_s(STAMPS, 0.3 * demanded, demanded, 3.0) is None  # 3 / sqrt(2)
    few = slice(0, 19)
    assert response_delay_s(STAMPS[few], demanded[few], demanded[few], 0.1) is None
    enough = slice(0, 20)
    assert response_delay_s(STAMPS[enough], demanded[enough], demanded[enough], 0.1) == 0.0


def ramp(from_s: float, until_s: float, begin: float, end: float) -> np.ndarray:
    return np.interp(T_S, [from_s, until_s], [begin, end])


def test_a_step_by_hand() -> None:
    """From 1 to 3; the response is a line over 4 s, then 10 % too far, and back at 3.1 after 2 s."""
    demanded = np.where(T_S < 20.0, 1.0, 3.0)
    achieved = np.interp(T_S, [20.0, 24.0, 25.0, 27.0], [1.0, 3.0, 3.3, 3.1])
    (step,) = step_responses(STAMPS, demanded, achieved, 1.0)
    assert (step.at_ns, step.until_ns) == (199 * S // 10, 1199 * S // 10)
    assert (step.begin, step.end) == (1.0, 3.0)
    assert step.rise_s == pytest.approx(3.2)  # 0.8 of 4 s
    assert step.overshoot_percent == pytest.approx(15.0)
    # Within a tenth (3.2) from 26 s on; 20 s are 0.1 s after the last row of the old setpoint.
    assert step.settled_s == pytest.approx(6.1, abs=0.11)


@pytest.mark.parametrize(
    ("demanded", "steps"),
    [
        (np.where(T_S < 20.0, 1.0, 2.0), 1),
        (np.where(T_S < 20.0, 1.0, 1.99), 0),
        (ramp(20.0, 20.9, 1.0, 2.5), 1),
        (ramp(20.0, 23.0, 1.0, 2.5), 0),  # slower than a second
        (np.where((T_S < 20.0) | (T_S > 24.1), 1.0, 2.5), 2),  # held for four seconds, and back
        (np.where((T_S < 20.0) | (T_S > 23.9), 1.0, 2.5), 1),
        (np.where(T_S < 20.0, 1.0, np.where(T_S < 22.0, 2.5, 2.7)), 1),  # a change within 15 % is still held
    ],
)
def test_a_step_is_a_quick_change_that_is_held(demanded: np.ndarray, steps: int) -> None:
    lag = np.concatenate(([demanded[0]], demanded[:-1]))
    assert len(step_responses(STAMPS, demanded, lag, 1.0)) == steps


def test_a_response_that_never_arrives_has_no_rise_and_does_not_settle() -> None:
    demanded = np.where(T_S < 20.0, 1.0, 3.0)
    (step,) = step_responses(STAMPS, demanded, np.where(T_S < 20.0, 1.0, 2.7), 1.0)
    assert (step.rise_s, step.settled_s, step.overshoot_percent) == (None, None, 0.0)
    (late,) = step_responses(STAMPS, demanded, np.where(T_S < 40.5, 1.0, 3.0), 1.0)  # after twenty seconds
    assert (late.rise_s, late.settled_s) == (None, None)
    assert step_responses(STAMPS, demanded, np.full(1200, 2.5), 1.0) == []  # it was there already


def test_steps_are_listed_with_their_figures() -> None:
    demanded = np.where(T_S < 20.0, 1.0, 3.0)
    achieved = np.interp(T_S, [20.0, 24.0], [1.0, 3.0])
    section = analysed(ROVER, speed(achieved, demanded))
    (grid,) = section.grids
    assert grid.title == "Speed, steps of the demand"
    (row,) = grid.rows
    assert dict(zip(grid.columns, row, strict=True)) == {
        "at (s)": 19.9, "from (m/s)": 1.0, "to (m/s)": 3.0, "rise 10 to 90 % (s)": 3.2, "overshoot (%)": 0.0,
        "within 10 % after (s)": pytest.approx(3.7, abs=0.11),
    }  # fmt: skip
    assert {fact.key: fact.value for fact in section.facts}["speed_overshoot_percent"] == 0.0
