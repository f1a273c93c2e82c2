"""The script that turns HIL messages into VectorNav frames: under a Lua interpreter, and on a real ArduPilot.

Frames are read with the layout of ArduPilot's VectorNav driver and Python's own CRC; messages are packed by pymavlink.
"""

from __future__ import annotations

import math
import random
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav
from script_host import GNSS, HANDSHAKE, IMU, INS, SCRIPT, Script, interpreter

from agent.navigation.gps_time import EPOCH_UNIX_S, LEAP_S

UNIX_S = 1_781_234_567.25
WEEK_NS = 7 * 86_400 * 10**9


@pytest.fixture
def script(tmp_path: Path) -> Script:
    interpreter()
    return Script(tmp_path)


def sensor(**fields: Any) -> Any:
    values = {
        "time_usec": 5_000_000_000_123,
        "xacc": 0.25,
        "yacc": -0.5,
        "zacc": -9.75,
        "xgyro": 0.125,
        "ygyro": -0.0625,
        "zgyro": 0.75,
        "xmag": 0.21,
        "ymag": -0.02,
        "zmag": 0.05,
        "abs_pressure": 1006.5,
        "diff_pressure": 0.0,
        "pressure_alt": 0.0,
        "temperature": 24.5,
        "fields_updated": 0x13FF,
        **fields,
    }
    return mav.MAVLink_hil_sensor_message(**values)


def gps(lat: int = -88_012_345, lon: int = -639_512_345, **fields: Any) -> Any:
    values = {
        "time_usec": round(UNIX_S * 1e6),
        "fix_type": 3,
        "lat": lat,
        "lon": lon,
        "alt": 61_230,
        "eph": 150,
        "epv": 275,
        "vel": 320,
        "vn": 310,
        "ve": -45,
        "vd": 3,
        "cog": 35_000,
        "satellites_visible": 14,
        **fields,
    }
    return mav.MAVLink_hil_gps_message(**values)


def state(roll: float, pitch: float, yaw: float) -> Any:
    cr, sr, cp, sp = math.cos(roll / 2), math.sin(roll / 2), math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    quat = [
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    ]
    return mav.MAVLink_hil_state_quaternion_message(
        1, quat, 0, 0, 0, -88_012_345, -639_512_345, 61_230, 310, -45, 3, 0, 0, 0, 0, 0
    )


def test_every_command_of_the_driver_is_answered_as_it_wants(script: Script) -> None:
    told = script.connect().play()
    assert len(told.answers) == len(HANDSHAKE)
    for command, answer in zip(HANDSHAKE, told.answers, strict=True):
        # The driver compares the first two terms with what it sent; the model decides which packets it asks for.
        assert answer.decode().split(",")[:2] == command.split(",")[:2]
    assert told.answers[3] == b"VNRRG,01,VN-200"
    assert (6, "xitl: the VectorNav driver is connected") in told.texts


def test_a_command_in_pieces_and_noise_before_it(script: Script) -> None:
    script.run().add(b"D", b"\xff\x00abc\r\n$VNA").run().add(b"D", b"SY,1*4E\r").run().add(b"D", b"\n").run()
    assert script.play().answers == [b"VNASY,1"]


def test_an_imu_frame_holds_the_message_bit_by_bit(script: Script) -> None:
    told = script.connect().message(sensor()).run().play()
    (body,) = told.of(IMU)
    gyro, accel = (0.125, -0.0625, 0.75), (0.25, -0.5, -9.75)
    assert body[1:7] == (*gyro, *accel)
    assert body[7:13] == (*accel, *gyro)
    assert body[13:16] == pytest.approx((0.21, -0.02, 0.05), rel=1e-7)
    assert body[16:] == pytest.approx((24.5, 100.65), rel=1e-6)  # degC, kPa
    assert told.left == b""


@pytest.mark.parametrize(
    ("lat", "lon"),
    [
        (-88_012_345, -639_512_345),
        (900_000_000, 1_800_000_000),
        (-900_000_000, -1_800_000_000),
        (1, -1),
        (0, 10_000_000),
        (123, 99_999_999),
        *((random.Random(seed).randint(-(9 * 10**8), 9 * 10**8), seed * 7_654_321) for seed in range(1, 20)),
    ],
)
def test_a_place_comes_out_as_it_went_in(script: Script, lat: int, lon: int) -> None:
    (body,) = script.connect().message(gps(lat, lon)).run().play().of(GNSS)
    # As the driver takes it: it multiplies and cuts.
    assert (math.trunc(body[4] * 1e7), math.trunc(body[5] * 1e7)) == (lat, lon)
    assert body[4:6] == pytest.approx((lat * 1e-7, lon * 1e-7), abs=1e-10)


def test_a_fix_has_velocity_accuracy_and_gps_time(script: Script) -> None:
    (body,) = script.connect().message(gps()).run().play().of(GNSS)
    gps_ns = round((UNIX_S - EPOCH_UNIX_S + LEAP_S) * 1e6) * 1000
    assert body[1] == gps_ns
    assert body[1] // WEEK_NS == 2422
    assert body[2:4] == (14, 3)
    assert body[6] == pytest.approx(61.23, abs=1e-5)
    assert body[7:10] == pytest.approx((3.1, -0.45, 0.03), rel=1e-6)
    assert body[10:13] == pytest.approx((1.5, 1.5, 2.75))


def test_time_since_boot_is_no_date(script: Script) -> None:
    (body,) = script.connect().message(gps(time_usec=12_345_678)).run().play().of(GNSS)
    assert body[1] == 12_345_678_000
    assert body[1] // WEEK_NS == 0  # ArduPilot sets no clock by week 0


def test_without_a_fix_the_driver_hears_so(script: Script) -> None:
    (body,) = script.connect().message(gps(fix_type=1, eph=0xFFFF, epv=0xFFFF)).run().play().of(GNSS)
    assert body[3] == 0
    assert body[10:13] == (1.0, 1.0, 2.0)


@pytest.mark.parametrize("angles", [(0.1, -0.2, 2.9), (-0.3, 0.05, -1.5), (0.0, 0.0, 0.0)])
def test_a_solution_has_attitude_place_and_velocity(script: Script, angles: tuple[float, float, float]) -> None:
    roll, pitch, yaw = angles
    message = state(roll, pitch, yaw)
    (body,) = script.connect().message(message).run().play().of(INS)
    assert body[1:4] == pytest.approx([math.degrees(angle) for angle in (yaw, pitch, roll)], abs=1e-4)
    w, x, y, z = message.attitude_quaternion
    assert body[4:8] == pytest.approx((x, y, z, w), abs=1e-7)
    assert (math.trunc(body[12] * 1e7), math.trunc(body[13] * 1e7)) == (-88_012_345, -639_512_345)
    assert body[15:18] == pytest.approx((3.1, -0.45, 0.03), rel=1e-6)


def test_counters_tell_what_came_of_the_messages(script: Script) -> None:
    script.run().message(sensor()).run()  # nobody has asked yet
    script.connect()
    for _ in range(7):
        script.message(sensor())
    script.run(10).message(gps()).run(35).message(sensor()).run(1000)
    told = script.play()
    assert [told.last(f"xitl_{name}") for name in ("in", "out", "drop", "hs")] == [10, 9, 1, 1]
    assert told.last("xitl_gap") == 1035
    assert len(told.frames) == 9


def test_what_the_port_does_not_take_is_dropped_and_counted(script: Script) -> None:
    script.connect().add(b"F", (100).to_bytes(4, "little"))
    told = script.message(sensor()).message(sensor()).run().run(1000).play()
    assert (told.last("xitl_out"), told.last("xitl_drop")) == (1, 1)
    assert len(told.of(IMU)) == 1


def test_the_driver_may_stop_and_start_the_frames(script: Script) -> None:
    script.connect().driver("VNASY,0").run().message(sensor()).run().driver("VNASY,1").run().message(sensor()).run()
    assert len(script.play().of(IMU)) == 1


def test_a_burst_is_spread_over_runs_and_nothing_else_is_heard(script: Script) -> None:
    script.connect()
    for _ in range(23):
        script.message(sensor())
    script.message(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)).run().run().run()
    assert len(script.play().of(IMU)) == 23


def test_without_its_port_it_says_what_to_set(script: Script) -> None:
    told = script.add(b"X", b"").run().run(10_000).play()
    assert told.texts == [(3, "xitl: set SCR_SDEV_EN 1, SCR_SDEV1_PROTO 36")] * 2
    assert told.periods == [10_000, 10_000]


def test_when_no_driver_asks_it_says_what_to_check(script: Script) -> None:
    script.run()
    for _ in range(30):
        script.run(1000)
    complaints = [text for severity, text in script.play().texts if severity == 4]
    assert complaints == ["xitl: no driver asks: EAHRS_TYPE, or a port on 36?"] * 2


@pytest.mark.parametrize(("value", "period_ms"), [("0", 2), ("5", 5), ("-3", 2), ("900", 2)])
def test_its_period_is_a_parameter(script: Script, value: str, period_ms: int) -> None:
    told = script.add(b"P", f"SCR_USER1={value}".encode()).run().run().play()
    assert told.periods == [period_ms, period_ms]
    assert (6, f"xitl: HIL script 1, every {period_ms} ms") in told.texts


def test_texts_fit_one_message() -> None:
    compiler = shutil.which("luac5.3") or shutil.which("luac")
    if compiler is not None:
        subprocess.run([compiler, "-p", str(SCRIPT)], check=True)
    quoted = [line.split('"')[1] for line in SCRIPT.read_text().splitlines() if "say(" in line and line.count('"') >= 2]
    assert quoted
    assert all(len("xitl: " + text) <= 50 for text in quoted)
