"""Attitude and impacts: sentences, evidence and severities at each limit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from xitl_cli.logs.model.codes import MOTION_LIMITS
from xitl_cli.logs.model.sections import Evidence, Finding, Section, Severity
from xitl_cli.logs.signals.sensors import InertialUnit, inertial_units
from xitl_cli.plugins.logs.analyses.attitude import analyse, find_bumps, find_shocks, tilt_series, vehicle_limits

S = 1_000_000_000
G = 9.80665
AT_S = np.arange(0.0, 60.0, 0.02)


def ns(at_s: Any) -> np.ndarray:
    return np.round(np.asarray(at_s, dtype=np.float64) * S).astype(np.int64)


def between(from_s: float, until_s: float, inside: float, outside: float = 0.0) -> np.ndarray:
    return np.where((from_s - 1e-6 <= AT_S) & (until_s + 1e-6 >= AT_S), inside, outside)


def attitude(roll: Any = 0.0, pitch: Any = 0.0) -> MadeTable:
    columns = {"Roll": roll, "Pitch": pitch, "Yaw": 0.0}
    return MadeTable("ATT", ns(AT_S), {name: np.broadcast_to(value, len(AT_S)) for name, value in columns.items()})


def imu(x: Any = 0.0, y: Any = 0.0, z: Any = -G) -> MadeTable:
    accel = {f"Acc{axis}": np.broadcast_to(value, len(AT_S)) for axis, value in zip("XYZ", (x, y, z), strict=True)}
    return MadeTable("IMU", ns(AT_S), accel | {f"Gyr{axis}": np.full(len(AT_S), 1e-3) for axis in "XYZ"})


def said(firmware: str = "ArduRover V4.5") -> MadeTable:
    return MadeTable("MSG", [0], {"Message": [firmware]})


BOAT = MadeTable("PARM", [0], {"Name": ["FRAME_CLASS"], "Value": [2.0]})
ARMED = MadeTable("ARM", ns([0.0, 1.0]), {"ArmState": [0, 1]})


def section_of(*tables: MadeTable, firmware: str = "ArduRover V4.5", **of: Any) -> Section:
    section = analyse(MadeLog(said(firmware), *tables, **of))
    assert section is not None
    return section


def found(*tables: MadeTable, **of: Any) -> dict[str, Finding]:
    return {one.key.partition(".")[2]: one for one in section_of(*tables, **of).findings}


# Overturned and leaning


@pytest.mark.parametrize(
    ("roll", "told"),
    [
        (between(20, 20.5, 80.1), True), (between(20, 20.48, 80.1), False), (between(20, 25, 80.0), False),
        (between(20, 25, -80.1), True), (between(20, 25, 279.0), True),  # -81 degrees
    ],
)  # fmt: skip
def test_a_rover_is_overturned_beyond_80_degrees_for_half_a_second(roll: np.ndarray, told: bool) -> None:
    assert ("overturned" in found(attitude(roll), ARMED)) is told


def test_a_capsize_in_full() -> None:
    finding = found(attitude(between(20, 30, 120.0), between(25, 26, 10.0)), ARMED, BOAT)["overturned"]
    assert finding.sentence == "It capsized: at roll 120° for 10.0 s from 0:20.0, armed"
    assert finding.severity is Severity.CRITICAL
    assert (finding.evidence[0].at_ns, finding.evidence[0].until_ns) == (20 * S, 30 * S)


@pytest.mark.parametrize(
    ("arm_s", "severity", "words"),
    [
        ([0.0, 1.0], Severity.CRITICAL, ", armed"),
        ([0.0, 1.0, 15.0], Severity.CRITICAL, ", just disarmed"),
        ([0.0, 1.0, 9.9], Severity.NOTICE, ", disarmed"),
        ([0.0, 31.0], Severity.NOTICE, ", disarmed"),
    ],
)
def test_a_capsize_by_the_state_of_its_motors(arm_s: list[float], severity: Severity, words: str) -> None:
    arm = MadeTable("ARM", ns(arm_s), {"ArmState": [at % 2 for at in range(len(arm_s))]})
    finding = found(attitude(between(20, 30, 120.0)), arm, BOAT)["overturned"]
    assert finding.severity is severity
    assert words in finding.sentence


def test_words_by_the_vehicle() -> None:
    over = attitude(between(20, 30, 120.0))
    assert "overturned: at" in found(over, ARMED)["overturned"].sentence
    assert "capsized: at" in found(over, ARMED, firmware="xitl 0.9, messages as ArduRover V4")["overturned"].sentence
    assert "was inverted: at" in found(over, ARMED, firmware="ArduCopter V4.5")["overturned"].sentence


@pytest.mark.parametrize(
    ("roll", "sentence"),
    [
        (between(20, 21, 45.1), "It leaned over by more than 45° once, for 1.0 s in all, to roll 45° at 0:20.0"),
        (between(20, 20.98, 45.1), None),
        (between(20, 25, 45.0), None),
        (
            between(20, 21, 50.0) + between(30, 32, -60.0),
            "It leaned over by more than 45° 2 times, for 3.0 s in all, to roll -60° at 0:30.0",
        ),
    ],
)
def test_a_lean_beyond_the_limit_of_the_class(roll: np.ndarray, sentence: str | None) -> None:
    findings = found(attitude(roll), ARMED)
    assert ("leaning" in findings) is (sentence is not None)
    if sentence is not None:
        assert findings["leaning"].sentence == sentence
    assert "leaning" not in found(attitude(roll), MadeTable("ARM", [0], {"ArmState": [0]}))


def test_a_lean_next_to_a_capsize_is_part_of_it() -> None:
    assert "leaning" not in found(attitude(np.maximum(between(20, 30, 120.0), between(30.1, 32, 60.0))), ARMED)
    assert "leaning" in found(attitude(np.maximum(between(20, 30, 120.0), between(31.1, 33, 60.0))), ARMED)


def test_pitch_is_named_if_it_is_the_larger() -> None:
    assert (
        "to pitch 60° and roll 10° at"
        in found(attitude(between(20, 22, 10.0), between(20, 22, 60.0)), ARMED)["leaning"].sentence
    )


def test_tilt_and_facts() -> None:
    tilt = tilt_series(MadeLog(attitude(60.0, 60.0)))
    assert tilt is not None
    assert tilt.tilt_deg == pytest.approx(np.degrees(np.arccos(0.25)))
    section = section_of(attitude(between(20, 21, -30.0, 1.0), between(0, 0.5, 40.0, 5.0)), imu(), ARMED)
    assert {fact.key: fact.value for fact in section.facts} == {"roll_max_deg": 30.0, "pitch_max_deg": 5.0, "shocks": 0}
    assert [one.sentence for one in section.findings] == ["It kept upright, to 40°, and felt no shock"]
    (plot,) = section.plots
    assert [trace.name for trace in plot.traces] == ["roll", "pitch"]


@pytest.mark.parametrize(
    ("kind", "parameters", "lean_deg"),
    [
        ("copter", {}, 65.0), ("copter", {"ANGLE_MAX": 3000.0}, 50.0),
        ("copter", {"ATC_ANGLE_MAX": 45.0, "ANGLE_MAX": 3000.0}, 65.0),
        ("plane", {"ROLL_LIMIT_DEG": 55.0}, 75.0), ("plane", {"LIM_ROLL_CD": 4000.0}, 60.0),
        ("rover", {"ANGLE_MAX": 1000.0}, 45.0),
        ("sub", {"ANGLE_MAX": 1000.0}, None),
    ],
)  # fmt: skip
def test_the_lean_that_parameters_allow(kind: Any, parameters: dict[str, float], lean_deg: float | None) -> None:
    limits = vehicle_limits(kind, parameters)
    assert limits.lean_deg == lean_deg
    assert (limits.overturned_deg, limits.shock_mps2) == (
        MOTION_LIMITS[kind].overturned_deg,
        MOTION_LIMITS[kind].shock_mps2,
    )


# Rolling


def waves(roll_deg: float, pitch_deg: float) -> MadeTable:
    inside = (AT_S >= 20.0) & (AT_S < 50.0)
    wave = np.where(inside, np.sin(2.0 * np.pi * AT_S / 2.0), 0.0)
    return attitude(np.sqrt(2.0) * roll_deg * wave, 2.0 + np.sqrt(2.0) * pitch_deg * wave)


@pytest.mark.parametrize(
    ("roll_deg", "pitch_deg", "sentence"),
    [
        (8.1, 0.0, "It rolled by 8° and pitched by 0° RMS in the ten seconds from"),
        (7.9, 0.0, None),
        (6.0, 5.4, "It rolled by 6° and pitched by 5° RMS in the ten seconds from"),
        (6.0, 5.2, None),
    ],
)
def test_a_boat_that_rolls_in_waves(roll_deg: float, pitch_deg: float, sentence: str | None) -> None:
    findings = found(waves(roll_deg, pitch_deg), ARMED, BOAT)
    assert ("rolling" in findings) is (sentence is not None)
    if sentence is not None:
        assert findings["rolling"].sentence.startswith(sentence)
        (evidence,) = findings["rolling"].evidence
        assert evidence.at_ns == pytest.approx(20 * S, abs=0.5 * S)
        assert evidence.until_ns == pytest.approx(50 * S, abs=0.5 * S)
    assert "rolling" not in found(waves(20.0, 0.0), ARMED)  # a car


# Shocks


def unit(table: MadeTable) -> InertialUnit:
    (one,) = inertial_units(MadeLog(table))
    return one


def at(at_s: float, value: float, base: float = -G) -> np.ndarray:
    return np.where(np.abs(AT_S - at_s) < 0.005, value, base)


@pytest.mark.parametrize(("z", "shocks"), [(-G - 35.1, 1), (-G - 34.9, 0), (G + 35.1, 1), (-421.0, 0), (-419.0, 1)])
def test_a_shock_is_a_peak_beyond_the_limit_of_the_class(z: float, shocks: int) -> None:
    found_shocks = find_shocks([unit(imu(z=at(30.0, z)))], MOTION_LIMITS["rover"])
    assert len(found_shocks) == shocks
    for shock in found_shocks:
        assert (shock.at_ns, shock.size_mps2) == (30 * S, pytest.approx(abs(z)))
        assert (shock.unit, shock.message, shock.field) == ("IMU", "IMU", "AccX")


def test_a_shock_must_exceed_the_vibration_before_it() -> None:
    for shaken, shocks in ((2.4, 1), (2.6, 0)):  # six times of it is 14.4 or 15.6
        z = np.where(AT_S < 30.0, -G - shaken * np.where(np.arange(len(AT_S)) % 2, 1.0, -1.0), -G)
        z = np.where(np.abs(AT_S - 30.0) < 0.005, -G - 50.0, z)
        found_shocks = find_shocks([unit(imu(z=z))], MOTION_LIMITS["rover"])
        assert len(found_shocks) == shocks
        for shock in found_shocks:
            assert shock.usual_mps2 == pytest.approx(shaken)


def test_shocks_within_a_second_are_one_and_the_range_of_a_sensor_is_named() -> None:
    z = np.minimum(np.minimum(at(30.0, -60.0), at(30.9, -16.0 * G)), at(32.0, -70.0))
    shocks = find_shocks([unit(imu(z=z))], MOTION_LIMITS["rover"])
    assert [(shock.at_ns / S, shock.range_g) for shock in shocks] == [(30.9, 16), (32.0, None)]


def test_an_impact_in_full() -> None:
    finding = found(attitude(), imu(z=np.minimum(at(30.0, -60.0), at(40.0, -55.0))), ARMED)["impact"]
    assert finding.sentence == "It hit something, or something hit it: IMU felt 60 m/s² at 0:30.0 (2 times in all)"
    assert finding.severity is Severity.WARNING
    assert finding.evidence == (
        Evidence("IMU", "AccX", 30 * S, None, "60 m/s²"), Evidence("IMU", "AccX", 40 * S, None, "55 m/s²"),
    )  # fmt: skip
    knock = found(attitude(), imu(z=at(30.0, -60.0)), MadeTable("ARM", [0], {"ArmState": [0]}))["knock"]
    assert knock.sentence.endswith("at 0:30.0, while disarmed")
    assert knock.severity is Severity.NOTICE


@pytest.mark.parametrize(("z", "severity"), [(-69.0, Severity.WARNING), (-71.0, Severity.CRITICAL)])
def test_twice_the_limit_is_grave(z: float, severity: Severity) -> None:
    assert found(attitude(), imu(z=at(30.0, z)), ARMED)["impact"].severity is severity


@pytest.mark.parametrize(
    ("before_mps", "after_mps", "grave"), [(2.0, 0.3, True), (2.0, 0.41, False), (1.0, 0.0, False), (1.1, 0.0, True)]
)
def test_a_standstill_after_an_impact_is_grave(before_mps: float, after_mps: float, grave: bool) -> None:
    at_s = np.arange(0.0, 60.0, 0.5)
    speed = MadeTable("GPS", ns(at_s), {"Spd": np.where(at_s < 30.5, before_mps, after_mps)})
    finding = found(attitude(), imu(z=at(30.0, -60.0)), ARMED, speed)["impact"]
    assert ("; a standstill followed" in finding.sentence) is grave
    assert finding.severity is (Severity.CRITICAL if grave else Severity.WARNING)


@pytest.mark.parametrize(("from_s", "follows"), [(29.1, True), (35.0, True), (35.1, False), (28.9, False)])
def test_turning_over_after_an_impact(from_s: float, follows: bool) -> None:
    finding = found(attitude(between(from_s, from_s + 2.0, 120.0)), imu(z=at(30.0, -60.0)), ARMED)["impact"]
    assert ("; turning over followed" in finding.sentence) is follows


@pytest.mark.parametrize(("x", "bumps"), [(6.3, 1), (6.0, 0), (-6.3, 1)])
def test_an_obstacle_stops_a_boat_horizontally(x: float, bumps: int) -> None:
    """Of 51 rows of half a second on both sides, the mean takes a part of it."""
    shocks = find_bumps(unit(imu(x=at(30.0, x, 0.0))))
    assert len(shocks) == bumps
    for shock in shocks:
        assert shock.at_ns == 30 * S
        assert shock.size_mps2 == pytest.approx(np.hypot(x, G))


def test_contacts_of_a_run() -> None:
    contacts = MadeTable(
        "/contacts",
        ns([10.0, 20.0, 30.0]),
        {"what": ["pier", "boom", "pier"], "speed_mps": [0.2, 0.456, 3.0], "began": [1, 1, 0]},
    )
    state = MadeTable("/truth/state", ns([0.0, 59.0]), {"a": [0, 0]})
    finding = found(attitude(), contacts, state, kind="mcap", base="simulation")["contact"]
    assert finding.sentence == "The vessel touched boom at 0:20.0 with 0.46 m/s, the hardest of 2 times"
    assert finding.evidence == (
        Evidence("/contacts", "speed_mps", 10 * S, None, "pier, 0.20 m/s"),
        Evidence("/contacts", "speed_mps", 20 * S, None, "boom, 0.46 m/s"),
    )
