"""Signals and findings of a ULog, made so that each cause is known, with PX4's own topics and parameters."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import ulog_writer as w
from sound_sections import sound_sections

from xitl_cli.logs import open_log, signals
from xitl_cli.logs.clocks.readings import utc_offset
from xitl_cli.logs.formats.run_directory import logs_in, own_log_in
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Finding, Severity
from xitl_cli.logs.signals.receivers import gnss_receivers
from xitl_cli.logs.signals.states import last_parameters, vehicle_kind
from xitl_cli.plugins.logs.analyses.outputs import driven_outputs

TOPICS = {
    "vehicle_status": "uint8_t arming_state;uint8_t nav_state;uint8_t vehicle_type;bool failsafe;",
    "failsafe_flags": "bool mode_req_attitude;bool global_position_invalid;bool gcs_connection_lost;",
    "vehicle_attitude": "float[4] q;",
    "vehicle_local_position": "float vx;float vy;bool v_xy_valid;uint8_t xy_reset_counter;",
    "vehicle_global_position": "double lat;double lon;float alt;",
    "sensor_gps": "uint64_t time_utc_usec;int32_t lat;int32_t lon;int32_t alt;float eph;float hdop;float vel_m_s;"
    "uint8_t fix_type;uint8_t satellites_used;",
    "estimator_status": "float pos_test_ratio;float mag_test_ratio;",
    "cpuload": "float load;float ram_usage;",
    "battery_status": "float voltage_v;uint8_t warning;",
    "failure_detector_status": "bool fd_roll;bool fd_motor;",
    "vehicle_imu_status": "uint32_t[3] accel_clipping;",
}
NUMBERS = {name: number for number, name in enumerate(TOPICS)}
UTC_US = 1_760_000_000_000_000
FAILS = range(60, 80)  # of 100 tenths of a second


def rows(at: int, trouble: bool) -> bytes:
    us = 1_000_000 + at * 100_000
    bad = trouble and at in FAILS
    armed = 20 <= at < (100 if trouble else 90)
    yaw = math.radians(90.0 + at)
    values = {
        "vehicle_status": ("4B", 2 if armed else 1, 3 if armed else 4, 3, bad),
        "failsafe_flags": ("3B", 1, bad, 1),
        "vehicle_attitude": ("4f", math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)),
        "vehicle_local_position": ("2f2B", 3.0, 4.0, at > 5, 1 if bad else 0),
        "vehicle_global_position": ("2df", 47.0 + at * 1e-6, 8.0, 400.0),
        "sensor_gps": ("Q3i3f2B", UTC_US + us, 470_000_000 + at * 10, 80_000_000, 400_000, 0.8, 0.9, 5.0, 3, 14),
        "estimator_status": ("2f", 7.5 if bad else 0.1, 0.2),
        "cpuload": ("2f", 0.97 if bad else 0.4, 0.5),
        "battery_status": ("fB", 10.5 if bad else 12.0, 2 if bad else 0),
        "failure_detector_status": ("2B", 0, bad),
        "vehicle_imu_status": ("3I", 9 if trouble and at >= 60 else 0, 0, 0),
    }
    return b"".join(w.row(NUMBERS[name], "Q" + layout, us, *held) for name, (layout, *held) in values.items())


def made(folder: Path, *, trouble: bool) -> Path:
    content = w.head() + b"".join(w.message_format(n, f"uint64_t timestamp;{f}") for n, f in TOPICS.items())
    content += w.information("sys_name", "PX4") + w.information("ver_hw", "PX4_FMU_V6X")
    content += w.keyed("I", "uint32_t ver_sw_release", (0x011000FF).to_bytes(4, "little"))
    content += w.parameter("RO_SPEED_LIM", 3.0) + w.default("RO_SPEED_LIM", -1.0)
    content += b"".join(w.subscription(number, name) for name, number in NUMBERS.items())
    content += b"".join(rows(at, trouble) for at in range(60))
    if trouble:
        content += w.text(2, 7_000_000, "Preflight Fail: barometer 0 missing\t") + w.dropout(250)
    content += b"".join(rows(at, trouble) for at in range(60, 100))
    path = folder / "autopilot.ulg"
    path.write_bytes(content)
    return path


def test_the_directory_of_a_run_stands_for_its_log_too(tmp_path: Path) -> None:
    log = made(tmp_path, trouble=False)
    (tmp_path / "run.mcap").touch()
    assert list(logs_in(tmp_path)) == [tmp_path / "run.mcap", log]
    assert own_log_in(tmp_path, "") == log


def findings(log: Log) -> dict[str, Finding]:
    return {found.key: found for section in sound_sections(log) for found in section.findings}


def test_signals(tmp_path: Path) -> None:
    with open_log(made(tmp_path, trouble=False)) as log:
        yaw, speed, place = signals.yaw(log), signals.ground_speed(log), signals.position_geodetic(log)
        assert yaw is not None
        assert speed is not None
        assert place is not None
        np.testing.assert_allclose(yaw.values, 90.0 + np.arange(100), atol=1e-4)
        assert (yaw.source, yaw.unit) == ("vehicle_attitude.q", "deg")
        assert (len(speed.values), set(speed.values)) == (94, {5.0})  # where the velocity is valid
        np.testing.assert_allclose(place.values[:, 0], 47.0 + np.arange(100) * 1e-6)
        assert [(span.text, span.from_ns) for span in signals.modes(log)] == [
            ("Hold", 1_000_000_000), ("Mission", 3_000_000_000), ("Hold", 10_000_000_000),
        ]  # fmt: skip
        assert [(span.from_ns, span.until_ns) for span in signals.armed(log)] == [(3_000_000_000, 10_000_000_000)]
        assert vehicle_kind(log) == "rover"
        assert last_parameters(log) == {"RO_SPEED_LIM": 3.0}
        (receiver,) = gnss_receivers(log)
        assert receiver.lat_deg[1] == pytest.approx(47.000001)
        assert receiver.accuracy is not None
        utc = utc_offset(log)
        assert utc is not None
        assert utc.offset_ns == UTC_US * 1000
        facts = {fact.key: fact.value for section in sound_sections(log) for fact in section.facts}
        assert (facts["firmware"], facts["firmware_version"], facts["board"]) == ("PX4", "1.16.0", "PX4_FMU_V6X")


def test_a_sound_log_has_no_trouble(tmp_path: Path) -> None:
    with open_log(made(tmp_path, trouble=False)) as log:
        assert not {key for key in findings(log) if key.startswith("px4.")}
        assert not any("LOG_BITMASK" in lack for section in sound_sections(log) for lack in section.lacks)


@pytest.mark.parametrize(
    ("key", "severity", "field", "words"),
    [
        ("failsafe", Severity.CRITICAL, "vehicle_status.failsafe", "global_position_invalid"),
        ("failure_detected", Severity.CRITICAL, "failure_detector_status.fd_motor", "motor failure"),
        ("ends_armed", Severity.WARNING, "vehicle_status.arming_state", "while the vehicle was armed"),
        ("reported", Severity.WARNING, "logged_messages.message", "barometer 0 missing"),
        ("rejected", Severity.WARNING, "estimator_status.pos_test_ratio", "up to 7.5"),
        ("estimate_reset", Severity.WARNING, "vehicle_local_position.xy_reset_counter", "position 2 times"),
        ("accel_clipping", Severity.WARNING, "vehicle_imu_status.accel_clipping", "clipped 9 samples"),
        ("battery", Severity.CRITICAL, "battery_status.warning", "critical at 0:07.0 at 10.50 V"),
        ("load", Severity.WARNING, "cpuload.load", "97 %"),
        ("log_dropouts", Severity.WARNING, "dropouts.duration", "0.25 s"),
    ],
)
def test_each_trouble_is_found(tmp_path: Path, key: str, severity: Severity, field: str, words: str) -> None:
    with open_log(made(tmp_path, trouble=True)) as log:
        found = findings(log)[f"px4.{key}"]
    assert found.severity == severity
    assert f"{found.evidence[0].message}.{found.evidence[0].field}" == field
    assert words in found.sentence
    assert found.next_step


Topic = tuple[str, str, list[tuple[int, int, tuple[float, ...]]]]
"""Fields and layout of a message, and its rows: time (ms), instance and values."""


def made_of(folder: Path, topics: dict[str, Topic]) -> Path:
    """A copter's log of these messages. It arms at 2 s and logs until 20 s."""
    status = [(at, 0, (2 if at >= 2_000 else 1, 3, 1)) for at in range(0, 20_000, 100)]
    topics = {
        "vehicle_status": ("uint8_t arming_state;uint8_t nav_state;uint8_t vehicle_type;", "3B", status),
        **topics,
    }
    content = w.head() + b"".join(w.message_format(n, f"uint64_t timestamp;{f}") for n, (f, _, _) in topics.items())
    content += w.information("sys_name", "PX4")
    instances = {(name, multi_id) for name, (_, _, rows) in topics.items() for _, multi_id, _ in rows}
    numbers = {key: number for number, key in enumerate(sorted(instances))}
    content += b"".join(w.subscription(number, name, multi_id) for (name, multi_id), number in numbers.items())
    every = [
        (at_ms, w.row(numbers[name, multi_id], "Q" + layout, 1_000_000 + at_ms * 1000, *values))
        for name, (_, layout, rows) in topics.items()
        for at_ms, multi_id, values in rows
    ]
    path = folder / "copter.ulg"
    path.write_bytes(content + b"".join(row for _, row in sorted(every, key=lambda placed: placed[0])))
    return path


def field(at_ms: int, iron_gauss: float) -> tuple[float, float, float]:
    """A field of 0.5 Gauss that turns with the vessel, and iron along x."""
    heading = at_ms * 1e-3
    return 0.3 * math.cos(heading) + iron_gauss, -0.3 * math.sin(heading), 0.4


@pytest.mark.parametrize(("iron_gauss", "changes"), [(0.0, False), (0.4, True)])
def test_only_the_calibrated_compass_is_judged(tmp_path: Path, iron_gauss: float, changes: bool) -> None:
    times = range(0, 20_000, 50)
    raw = [(at, multi_id, field(at, 0.8 * multi_id)) for at in times for multi_id in (0, 1)]
    calibrated = [(at, 0, field(at, iron_gauss)) for at in times]
    log = made_of(
        tmp_path,
        {
            "sensor_mag": ("float x;float y;float z;", "3f", raw),
            "vehicle_magnetometer": ("float[3] magnetometer_ga;", "3f", calibrated),
        },
    )
    with open_log(log) as opened:
        found = findings(opened)
    assert "sensors.compasses_disagree" not in found
    assert ("sensors.field_changes" in found) is changes
    if changes:
        assert "vehicle_magnetometer" in found["sensors.field_changes"].sentence


@pytest.mark.parametrize(
    ("change_rad", "severity", "words"),
    [(0.03, Severity.NOTICE, "first at 0:11.0, by 1.7 °"), (-0.39, Severity.WARNING, "first at 0:11.0, by 22 °")],
)
def test_a_reset_is_judged_by_its_size(tmp_path: Path, change_rad: float, severity: Severity, words: str) -> None:
    rows = [(at, 0, (at >= 10_000, change_rad if at >= 10_000 else 0.0)) for at in range(0, 20_000, 100)]
    path = made_of(
        tmp_path, {"vehicle_local_position": ("uint8_t heading_reset_counter;float delta_heading;", "Bf", rows)}
    )
    with open_log(path) as log:
        found = findings(log)["px4.estimate_reset"]
    assert found.severity == severity
    assert words in found.sentence


def test_a_share_over_one_is_no_measurement(tmp_path: Path) -> None:
    rows = [(at, 0, (0.4, 970.0 if at == 5_000 else 0.3)) for at in range(0, 20_000, 500)]
    with open_log(made_of(tmp_path, {"cpuload": ("float load;float ram_usage;", "2f", rows)})) as log:
        facts = {fact.key: fact.value for section in sound_sections(log) for fact in section.facts}
        assert "px4.load" not in findings(log)
    assert facts["ram_usage_highest_percent"] == 30.0


@pytest.mark.parametrize(
    ("from_ms", "until_ms", "severity", "words"),
    [
        (500, 1_000, Severity.NOTICE, "in failsafe while disarmed from 0:01.5 for 0.50 s"),
        (10_000, 20_000, Severity.CRITICAL, "in failsafe from 0:11.0 to the end of the log"),
    ],
)
def test_a_failsafe_by_arming_and_end(
    tmp_path: Path, from_ms: int, until_ms: int, severity: Severity, words: str
) -> None:
    rows = [(at, 0, (2 if at >= 2_000 else 1, 3, 1, from_ms <= at < until_ms)) for at in range(0, 20_000, 100)]
    fields = "uint8_t arming_state;uint8_t nav_state;uint8_t vehicle_type;bool failsafe;"
    with open_log(made_of(tmp_path, {"vehicle_status": (fields, "4B", rows)})) as log:
        found = findings(log)["px4.failsafe"]
    assert found.severity == severity
    assert words in found.sentence


@pytest.mark.parametrize(("size_pa", "named"), [(-150.0, False), (-400.0, True)])
def test_a_slow_barometer_of_a_copter(tmp_path: Path, size_pa: float, named: bool) -> None:
    """At 4 Hz, a step is fitted over three seconds, in which a copter climbs 12 m."""
    rows = [(at, 0, (101_000.0 + (size_pa if at >= 10_000 else 0.0) + at % 7,)) for at in range(0, 20_000, 250)]
    with open_log(made_of(tmp_path, {"vehicle_air_data": ("float baro_pressure_pa;", "f", rows)})) as log:
        assert ("sensors.pressure_step" in findings(log)) is named


def test_outputs_have_the_functions_of_px4_and_not_those_of_an_old_ardupilot(tmp_path: Path) -> None:
    """A simulated rover outputs 900 us without a function and while disarmed; RCn_… of a PX4 are of its receiver."""
    content = w.head() + w.message_format(
        "vehicle_status", "uint64_t timestamp;uint8_t arming_state;uint8_t vehicle_type;"
    )
    content += w.message_format("actuator_outputs", "uint64_t timestamp;uint32_t noutputs;float[4] output;")
    whole = {"PWM_MAIN_FUNC1": 101, "PWM_MAIN_FUNC2": 102, "PWM_MAIN_FUNC3": 0, "PWM_MAIN_FUNC4": 201, "CA_R_REV": 1}
    content += b"".join(w.parameter(name, value) for name, value in whole.items())
    content += b"".join(
        w.parameter(f"RC{n}_{end}", us) for n in (1, 3) for end, us in (("MIN", 1100.0), ("MAX", 1900.0))
    )
    content += w.subscription(0, "vehicle_status") + w.subscription(1, "actuator_outputs")
    for at in range(20):
        us = 1_000_000 + at * 100_000
        pulses = (2000.0, 1250.0, 900.0, 1000.0) if at >= 10 else (900.0,) * 4
        content += w.row(0, "Q2B", us, 2 if at >= 10 else 1, 3) + w.row(1, "QI4f", us, 4, *pulses)
    path = tmp_path / "outputs.ulg"
    path.write_bytes(content)
    with open_log(path) as log:
        found = {output.name: float(output.command[-1]) for output in driven_outputs(log, last_parameters(log))}
    assert found == {"output 1": 1.0, "output 2": 0.25, "output 4": -1.0}
