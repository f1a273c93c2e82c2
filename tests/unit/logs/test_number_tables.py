"""Names against pymavlink's, which are kept apart from ours."""

from __future__ import annotations

import pytest
from made_log import MadeLog, MadeTable

from xitl_cli.logs.model.codes import (
    EKF_FAULTS,
    MISSION_COMMANDS,
    VehicleKind,
    arming_method_name,
    bit_names,
    checks_left_out,
    error_name,
    error_persists,
    event_name,
    internal_error_names,
    mode_name,
    reason_name,
)
from xitl_cli.logs.signals.states import modes, vehicle_kind


@pytest.mark.parametrize(
    ("kind", "mapping"),
    [
        ("rover", "mode_mapping_rover"),
        ("copter", "mode_mapping_acm"),
        ("plane", "mode_mapping_apm"),
        ("sub", "mode_mapping_sub"),
    ],
)
def test_modes_are_called_as_pymavlink_calls_them(kind: VehicleKind, mapping: str) -> None:
    from pymavlink import mavutil  # type: ignore[import-untyped]

    theirs: dict[int, str] = getattr(mavutil, mapping)
    compared = 0
    for number, name in theirs.items():
        ours = mode_name(kind, number)
        if ours == f"mode {number}":
            continue  # retired, or newer than our table
        compared += 1
        assert _plain(ours) == _plain(name), number
    assert compared >= 6


def _plain(name: str) -> str:
    plain = name.replace("_", "").upper()
    return {"INITIALIZING": "INITIALISING", "LOITERALTQLAND": "LOITER2QLAND", "TAKEOFF": "TAKEOFF"}.get(plain, plain)


def test_commands_are_called_as_in_mavlink() -> None:
    from pymavlink.dialects.v20 import ardupilotmega  # type: ignore[import-untyped]

    theirs = ardupilotmega.enums["MAV_CMD"]
    for number, name in MISSION_COMMANDS.items():
        assert number in theirs, number
        assert theirs[number].name.removeprefix("MAV_CMD_").removeprefix("NAV_") == name


def test_a_mode_without_a_name_keeps_its_number() -> None:
    assert mode_name("copter", 250) == "mode 250"
    assert mode_name("unknown", 10) == "mode 10"
    assert reason_name(0) == ""
    assert reason_name(6) == "EKF failsafe"
    assert reason_name(240) == "reason 240"


@pytest.mark.parametrize(
    ("subsystem", "code", "said"),
    [
        (16, 2, "EKF check: bad variance"),
        (16, 0, "EKF check: resolved"),
        (17, 1, "EKF failsafe: occurred"),
        (3, 4, "compass: unhealthy"),
        (9, 6, "fence: circle, polygon breached"),
        (10, 10, "mode: AUTO refused"),
        (24, 1, "EKF primary: lane 1"),
        (12, 2, "crash check: loss of control"),
        (200, 7, "subsystem 200: code 7"),
    ],
)
def test_errors_in_words(subsystem: int, code: int, said: str) -> None:
    assert error_name(subsystem, code, "rover") == said


def test_what_an_error_tells_of_an_instant_does_not_last() -> None:
    assert error_persists(16)
    assert error_persists(3)
    assert not error_persists(10)
    assert not error_persists(24)


def test_bits_and_numbers_without_a_name() -> None:
    assert bit_names(EKF_FAULTS, 0b1000_0001) == ("quaternion not a number", "not initialised")
    assert bit_names(EKF_FAULTS, 1 << 12) == ("bit 12",)
    assert internal_error_names(1 << 11 | 1) == ("logger: mapping failed", "watchdog reset")
    assert event_name(62) == "EKF yaw reset"
    assert event_name(251) == "event 251"
    assert arming_method_name(6) == "CPU failsafe"
    assert arming_method_name(99) == "method 99"


def test_checks_left_out() -> None:
    assert checks_left_out(1) == ()
    assert "compass" in checks_left_out(0b1111_1000)
    assert "GPS" not in checks_left_out(0b1111_1000)
    assert len(checks_left_out(0)) == 20


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("ArduRover V4.7.0-dev (2598e9d4)", "rover"),
        ("APM:Rover v3.5.0 (deadbeef)", "rover"),
        ("ArduCopter V4.5.7 (2a3dc4b7)", "copter"),
        ("APM:Copter V3.6.1 (12345678)", "copter"),
        ("ArduPlane V4.4.0 (0c1a5b2d)", "plane"),
        ("ArduSub V4.1.0 (f2af3c7e)", "sub"),
        ("AntennaTracker V4.2.0 (abcdef01)", "unknown"),
        ("xitl 0.1.0, messages and modes as ArduRover V4", "rover"),
        ("Plan of today: none", "unknown"),
    ],
)
def test_the_vehicle_by_its_firmware(text: str, kind: VehicleKind) -> None:
    log = MadeLog(MadeTable("MSG", [0, 1], {"Message": ["GPS 1: probing", text]}))
    assert vehicle_kind(log) == kind


def test_the_vehicle_by_its_heartbeat_and_not_by_the_ground_station() -> None:
    beats = MadeTable(
        "HEARTBEAT",
        [0, 1],
        {
            "type": [6, 2],
            "autopilot": [8, 3],
            "custom_mode": [0, 5],
            "base_mode": [0, 128],
            "_sysid": [255, 1],
        },
    )
    log = MadeLog(beats, kind="tlog", base="utc")
    assert vehicle_kind(log) == "copter"
    assert [span.text for span in modes(log)] == ["LOITER"]
