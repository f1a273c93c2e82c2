"""Motion of a vessel as the search for faults of actuators sees it, and its sentences for faults of every kind."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.sections import Evidence, Severity
from xitl_cli.logs.signals.states import parameter_values
from xitl_cli.plugins.logs.analyses import actuator_faults
from xitl_cli.plugins.logs.analyses.actuator_faults import (
    DetectedFault,
    UnansweredTurn,
    VesselMotion,
    actuator_findings,
    unanswered_turns,
    vessel_motion,
)
from xitl_cli.plugins.logs.analyses.outputs import driven_outputs

S = 1_000_000_000
PARAMETERS = {"SERVO1_FUNCTION": 73.0, "SERVO1_MIN": 1000.0, "SERVO1_MAX": 2000.0, "SERVO1_TRIM": 1500.0,
              "SERVO3_FUNCTION": 26.0, "SERVO3_MIN": 1000.0, "SERVO3_MAX": 2000.0, "SERVO3_TRIM": 1500.0}  # fmt: skip


def ns(at_s: Any) -> np.ndarray:
    return np.round(np.asarray(at_s) * S).astype(np.int64)


def log_of(*tables: MadeTable, until_s: float = 60.0, firmware: str = "ArduRover V4.5") -> MadeLog:
    """Two metres a second to the east on a heading of 30 degrees, turning by 6 deg/s."""
    fast, slow = np.arange(0.0, until_s, 0.02), np.arange(0.0, until_s, 0.2)
    return MadeLog(
        MadeTable("MSG", [0], {"Message": [firmware]}),
        MadeTable("PARM", [0] * len(PARAMETERS), {"Name": list(PARAMETERS), "Value": list(PARAMETERS.values())}),
        MadeTable("IMU", ns(fast), {"GyrZ": np.full(len(fast), np.radians(6.0))}),
        MadeTable("ATT", ns(fast), {"Yaw": np.full(len(fast), 30.0)}),
        MadeTable("RCOU", ns(slow), {"C1": np.where(slow < 30.0, 1500, 1750), "C3": np.where(slow < 30.0, 1500, 1400)}),
        MadeTable(
            "GPS", ns(slow),
            {"Status": np.full(len(slow), 3), "Lat": np.full(len(slow), 47.0), "Lng": np.full(len(slow), 8.0),
             "Spd": np.full(len(slow), 2.0), "GCrs": np.full(len(slow), 90.0)},
        ),
        *tables,
    )  # fmt: skip


def motion_of(log: MadeLog) -> VesselMotion | None:
    return vessel_motion(log, driven_outputs(log, parameter_values(log)))


def test_the_motion_is_in_body_axes_five_times_a_second() -> None:
    motion = motion_of(log_of())
    assert motion is not None
    assert np.diff(motion.stamp_ns).tolist() == [S // 5] * (len(motion.stamp_ns) - 1)
    assert (motion.stamp_ns[0], len(motion.stamp_ns)) == (0, 299)
    inner = slice(1, -1)
    assert motion.yaw_rate_radps[inner] == pytest.approx(np.radians(6.0))
    assert motion.surge_mps == pytest.approx(2.0 * np.cos(np.radians(60.0)))
    assert motion.sway_mps == pytest.approx(2.0 * np.sin(np.radians(60.0)))
    assert motion.yaw_rad == pytest.approx(np.radians(30.0))
    assert motion.steers.tolist() == [False, True]
    assert motion.commands[100].tolist() == [0.0, 0.0]
    assert motion.commands[200] == pytest.approx([0.5, -0.2])


def test_only_the_armed_time_counts() -> None:
    motion = motion_of(log_of(MadeTable("ARM", ns([0.0, 10.0, 50.0]), {"ArmState": [0, 1, 0]})))
    assert motion is not None
    assert (motion.stamp_ns[0], motion.stamp_ns[-1]) == (10 * S, 50 * S)
    assert motion_of(log_of(MadeTable("ARM", ns([0.0, 59.95]), {"ArmState": [0, 1]}))) is None


@pytest.mark.parametrize(("until_s", "known"), [(40.4, True), (40.2, False)])
def test_a_short_log_has_no_motion(until_s: float, known: bool) -> None:
    """More than a hundred rows of the fit, each of two samples."""
    assert (motion_of(log_of(until_s=until_s)) is not None) is known


@pytest.mark.parametrize("lacking", ["IMU", "ATT", "GPS", "RCOU"])
def test_a_log_that_lacks_a_source_has_no_motion(lacking: str) -> None:
    log = log_of()
    if lacking == "IMU":
        del log.tables["ATT"]  # the heading gives both
    del log.tables[lacking]
    assert motion_of(log) is None


TURN = UnansweredTurn(10 * S, 20 * S, np.radians(12.0))
PROPELLER = DetectedFault("thrust_loss", 0, 20 * S, 40 * S, 0.456, 1.0, 500.0)


@pytest.mark.parametrize(
    ("fault", "sentence", "value"),
    [
        (
            PROPELLER,
            "From 0:20.0 to 0:40.0 the vessel answers as if output 1 (throttle port) lost 46 % of its thrust", "0.46",
        ),
        (
            DetectedFault("reversed", 0, 20 * S, None, 1.0, 1.0, 500.0),
            "From 0:20.0 to the end of the log the vessel answers as if output 1 (throttle port) turned against "
            "its command",
            "1.00",
        ),
        (
            DetectedFault("stuck", 0, 20 * S, 40 * S, -0.3, 1.0, 500.0),
            "From 0:20.0 to 0:40.0 the vessel answers as if output 1 (throttle port) stayed at -30 % of its range, "
            "whatever it was commanded to", "-0.30",
        ),
        (
            DetectedFault("stuck", 1, 20 * S, 40 * S, -0.3, 1.0, 500.0),
            "From 0:20.0 to 0:40.0 the vessel answers as if output 3 (steering) stayed at 30 % of its range to "
            "starboard, whatever it was commanded to", "-0.30",
        ),
        (
            DetectedFault("stuck", 1, 20 * S, 40 * S, 0.3, -1.0, 500.0, other=PROPELLER),
            "From 0:20.0 to 0:40.0 the vessel answers as if output 3 (steering) stayed at 30 % of its range to "
            "port, whatever it was commanded to, or lost 46 % of its thrust: its commands varied too little to tell",
            "0.30",
        ),
        (
            DetectedFault("reversed", 0, 20 * S, 40 * S, 1.0, 1.0, 500.0, began_ns=(15 * S, 21 * S)),
            "From 0:20.0 to 0:40.0 the vessel answers as if output 1 (throttle port) turned against its command; it "
            "began between 0:15.0 and 0:21.0, as its commands hardly differed from it in this time", "1.00",
        ),
    ],
)  # fmt: skip
def test_a_fault_is_a_sentence(
    fault: DetectedFault, sentence: str, value: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(actuator_faults, "actuator_faults", lambda motion: [fault])
    log = log_of()
    (finding,) = actuator_findings(log, LogClock(log))
    assert (finding.key, finding.severity) == (f"actuation.{fault.kind}", Severity.WARNING)
    assert finding.sentence == sentence
    end_ns = fault.until_ns or round(59.6 * S)
    field = "C1" if fault.output == 0 else "C3"
    assert finding.evidence == (Evidence("RCOU", field, 20 * S, end_ns, value),)


@pytest.mark.parametrize(
    ("from_s", "until_s", "told"), [(5.0, 9.9, True), (20.1, None, True), (5.0, 10.1, False), (19.9, None, False)]
)
def test_a_turn_against_the_commands_is_told_unless_a_fault_explains_it(
    from_s: float, until_s: float | None, told: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    end_ns = None if until_s is None else round(until_s * S)
    fault = DetectedFault("reversed", 0, round(from_s * S), end_ns, 1.0, 1.0, 500.0)
    monkeypatch.setattr(actuator_faults, "actuator_faults", lambda motion: [fault])
    monkeypatch.setattr(actuator_faults, "unanswered_turns", lambda motion: [TURN])
    log = log_of()
    found = [one for one in actuator_findings(log, LogClock(log)) if one.key == "actuation.unanswered"]
    assert len(found) == told
    for one in found:
        assert one.sentence == (
            "From 0:10.0 to 0:20.0 the vessel did not answer its commands: it turned to starboard at 12 deg/s "
            "while they were to port"
        )
        assert one.evidence == (Evidence("RCOU", "C1", 10 * S, 20 * S, "12 deg/s"),)


def test_another_vehicle_is_not_judged() -> None:
    log = log_of(firmware="ArduCopter V4.5")
    assert list(actuator_findings(log, LogClock(log))) == []


def turning(
    rate_degps: Any, moment: Any, surge_mps: float = 2.0, steers: bool = False, many: int = 400
) -> VesselMotion:
    """Two propellers whose difference turns, in a first part that shows their sides; a rudder instead if `steers`."""
    at_ns = ns(np.arange(many) * 0.2)
    first = np.arange(many) < 250
    wave = np.sin(np.arange(many) * 0.2)
    moments = np.where(first, 0.8 * wave, np.broadcast_to(moment, many))
    rate = np.where(first, 0.3 * -np.cos(np.arange(many) * 0.2), np.radians(np.broadcast_to(rate_degps, many)))
    commands = np.stack([moments, np.full(many, 0.5)] if steers else [moments, -moments], axis=1)
    zero = np.zeros(many)
    return VesselMotion(at_ns, rate, zero + surge_mps, zero, zero, commands, np.array([steers, False]))


def inside(first: int, rows: int, value: float, outside: float = 0.0) -> np.ndarray:
    values = np.full(400, outside)
    values[first : first + rows] = value
    return values


@pytest.mark.parametrize(
    ("rows", "rate_degps", "moment", "many"),
    [
        (30, -10.0, 0.6, 1),
        (29, -10.0, 0.6, 0),  # 5.8 s
        (30, 10.0, 0.6, 0),  # it answers
        (30, 10.0, -0.6, 1),
        (30, -4.5, 0.6, 0),  # 0.079 rad/s
        (30, -10.0, 0.54, 0),  # a moment of 0.54 squared
        (30, -10.0, 0.56, 1),
    ],
)
def test_a_turn_against_the_commands_is_long_fast_and_strong(
    rows: int, rate_degps: float, moment: float, many: int
) -> None:
    found = unanswered_turns(turning(inside(300, rows, rate_degps), inside(300, rows, moment)))
    assert len(found) == many
    for turn in found:
        assert (turn.from_ns, turn.until_ns) == (60 * S, 60 * S + (rows - 1) * S // 5)
        assert turn.yaw_rate_radps == pytest.approx(np.radians(rate_degps))


def test_a_turn_that_slows_down_is_answered() -> None:
    slowing = inside(300, 30, 0.0)
    slowing[300:330] = np.linspace(-20.0, -6.0, 30)
    assert unanswered_turns(turning(slowing, inside(300, 30, 0.6))) == []


@pytest.mark.parametrize(("surge_mps", "many"), [(0.51, 1), (0.5, 0)])
def test_a_rudder_needs_way(surge_mps: float, many: int) -> None:
    motion = turning(inside(300, 30, -10.0), inside(300, 30, 0.4), surge_mps, steers=True)
    assert len(unanswered_turns(motion)) == many
