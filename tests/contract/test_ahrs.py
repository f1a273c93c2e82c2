"""The simulated navigation units against doubles of ArduPilot's drivers, and against real ones where there are any."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from ahrs_autopilot import CAPTURE, Double, MicroStrainDouble, Real, VectorNavDouble, Watcher, parameters

from agent.bridges.ahrs import Ahrs, open_line
from agent.bridges.json_world import JsonWorld
from agent.bridges.microstrain import MicroStrain7
from agent.bridges.vectornav import VectorNav
from agent.timing.clock import MonotonicClock, TickClock
from agent.wire import dialect as mav
from sim_core.sensors.magnetometer import local_field_ned_gauss
from tests.ardupilot import Rover
from tests.free_ports import free_port
from tests.patience import let_pass, wait_until

LAT_DEG, LON_DEG, ALT_M = -8.8, -63.95, 60.0
ROLL, PITCH, YAW = (math.radians(angle) for angle in (5.0, -3.0, 40.0))
VEL_NED_MPS = (0.6, -0.3, 0.0)
GRAVITY_MPS2 = 9.7817  # at that latitude and height
PRESSURE_PA = 100_612.0
METRES_PER_DEG = 110_600.0
IMU_HZ = 200
UNITS = {"vectornav": VectorNav, "microstrain7": MicroStrain7}
AUTOPILOTS = ["double", pytest.param("real", marks=[pytest.mark.ardupilot, pytest.mark.realtime])]


def to_body(vector: tuple[float, float, float]) -> tuple[float, float, float]:
    """From NED, by yaw, then pitch, then roll."""
    n, e, d = vector
    n, e = n * math.cos(YAW) + e * math.sin(YAW), e * math.cos(YAW) - n * math.sin(YAW)
    n, d = n * math.cos(PITCH) - d * math.sin(PITCH), d * math.cos(PITCH) + n * math.sin(PITCH)
    e, d = e * math.cos(ROLL) + d * math.sin(ROLL), d * math.cos(ROLL) - e * math.sin(ROLL)
    return n, e, d


FORCE_FRD_MPS2 = to_body((0.0, 0.0, -GRAVITY_MPS2))
FIELD_FRD_GAUSS = to_body(tuple(local_field_ned_gauss(LAT_DEG, LON_DEG, ALT_M, 2025.5).ned_gauss))  # type: ignore[arg-type]


class Vessel:
    """Heels and trims a little and drifts at a constant speed; its sensors have no errors."""

    def __init__(self, *units: Ahrs | JsonWorld) -> None:
        self.units = units
        self.step = 0

    @property
    def now_ns(self) -> int:
        return self.step * 1_000_000_000 // IMU_HZ

    def go_on(self) -> None:
        self.step += 1
        at_us, at_s = self.now_ns // 1000, self.now_ns * 1e-9
        messages = [mav.MAVLink_xitl_imu_message(at_us, (0.0, 0.0, 0.0), FORCE_FRD_MPS2, 21.0)]
        if self.step % 4 == 0:
            messages.append(mav.MAVLink_xitl_magnetometer_message(at_us, FIELD_FRD_GAUSS))
            messages.append(mav.MAVLink_xitl_barometer_message(at_us, PRESSURE_PA, 21.0))
        if self.step % 40 == 0:
            north_m, east_m = VEL_NED_MPS[0] * at_s, VEL_NED_MPS[1] * at_s
            lat = round((LAT_DEG + north_m / METRES_PER_DEG) * 1e7)
            lon = round((LON_DEG + east_m / METRES_PER_DEG / math.cos(math.radians(LAT_DEG))) * 1e7)
            alt_mm = round(ALT_M * 1000)
            messages.append(mav.MAVLink_xitl_gnss_message(at_us, lat, lon, alt_mm, VEL_NED_MPS, 0.5, 1.0, 0.05, 3, 14))
        for message in messages:
            for unit in self.units:
                unit.handle(message, self.now_ns)
        for unit in self.units:
            unit.serve(self.now_ns)


@pytest.fixture(params=["vectornav", "microstrain7"])
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(params=AUTOPILOTS)
def autopilot(request: pytest.FixtureRequest, name: str, tmp_path: Path) -> Iterator[Double | Real]:
    autopilot: Double | Real
    if request.param == "double":
        autopilot = VectorNavDouble() if name == "vectornav" else MicroStrainDouble()
    elif name == "vectornav":
        values = parameters("rover-vectornav.parm", "rover-no-simulated-sensors.parm")
        autopilot = Real(tmp_path, values, "sitl")
    else:
        autopilot = Real(tmp_path, parameters("rover-microstrain7.parm"), "linux")
    autopilot.start()
    yield autopilot
    autopilot.stop()


@pytest.fixture
def unit(name: str, autopilot: Double | Real) -> Iterator[Ahrs]:
    unit = UNITS[name](open_line(autopilot.url))
    unit.reset(MonotonicClock(), False, lambda severity, text: None)
    yield unit
    unit.close()


def run_in_real_time(vessel: Vessel, autopilot: Double | Real, until_s: float) -> None:
    """Until all has been seen and the drift has been going on for a while."""
    start_s = time.monotonic()
    while not autopilot.look(time.monotonic()).whole or vessel.step < 8 * IMU_HZ:
        vessel.go_on()
        assert vessel.step < until_s * IMU_HZ, autopilot.seen
        if isinstance(autopilot, Double):
            autopilot.greeted.wait(0.001)  # it is asked and answered meanwhile
            keep_together(vessel.units[0], autopilot)
            continue
        let_pass(max(start_s + vessel.now_ns * 1e-9 - time.monotonic(), 0.0))


def keep_together(unit: Ahrs | JsonWorld, double: Double) -> None:
    """Wait until the double has read nearly all, so that no frame is dropped."""
    wait_until(
        lambda: unit.serve(0) or unit.counts.imu_out - unit.counts.unsent - double.frames["inertial"] <= 20,
        f"{double.frames} {double.bad}",
        look_s=0.0005,
    )


@pytest.mark.medium
def test_the_autopilot_sees_what_the_sensors_measure(unit: Ahrs, autopilot: Double | Real) -> None:
    vessel = Vessel(unit)
    run_in_real_time(vessel, autopilot, 40.0)
    seen = autopilot.look(time.monotonic())
    at_s = vessel.now_ns * 1e-9
    assert seen.euler_deg == pytest.approx((5.0, -3.0, 40.0), abs=0.5)
    assert seen.accel_mg == pytest.approx([value / 9.80665 * 1000 for value in FORCE_FRD_MPS2], abs=4)
    assert seen.field_mgauss == pytest.approx([value * 1000 for value in FIELD_FRD_GAUSS], abs=3)
    assert seen.pressure_hpa == pytest.approx(PRESSURE_PA / 100, abs=0.1)
    assert (seen.satellites, seen.fix_type) == (14, 3)
    assert seen.alt_m == pytest.approx(ALT_M, abs=0.1)
    assert seen.speed_mps == pytest.approx(math.hypot(*VEL_NED_MPS), abs=0.02)
    assert seen.course_deg == pytest.approx(333.43, abs=1.0)
    assert seen.solution_vel_ned_mps == pytest.approx(VEL_NED_MPS, abs=0.1)
    # The fix is up to 0.2 s old, and telemetry as much again: 0.3 m at this speed.
    assert seen.lat_deg == pytest.approx(LAT_DEG + VEL_NED_MPS[0] * at_s / METRES_PER_DEG, abs=1.0 / METRES_PER_DEG)
    assert seen.lon_deg == pytest.approx(LON_DEG + VEL_NED_MPS[1] * at_s / METRES_PER_DEG, abs=1.0 / METRES_PER_DEG)
    assert unit.counts.taken
    assert unit.counts.junk == 0


@pytest.mark.medium
@pytest.mark.parametrize("autopilot", ["double"], indirect=True)
def test_no_frame_is_lost_or_damaged(unit: Ahrs, autopilot: Double) -> None:
    run_in_real_time(Vessel(unit), autopilot, 40.0)
    sent = {"inertial": unit.counts.imu_out, "solution": unit.counts.solution_out, "fix": unit.counts.gnss_out}
    wait_until(lambda: autopilot.frames == sent, f"{autopilot.frames} of {sent}")
    assert autopilot.bad == 0


@pytest.mark.medium
@pytest.mark.parametrize("name", ["vectornav"], indirect=True)
@pytest.mark.parametrize("autopilot", ["double"], indirect=True)
def test_the_set_up_of_a_real_rover(unit: Ahrs, autopilot: Double) -> None:
    run_in_real_time(Vessel(unit), autopilot, 40.0)
    commands = CAPTURE.read_bytes().splitlines()
    assert len(autopilot.answers) == len(commands) == unit.counts.commands_in == 8
    assert autopilot.answers[3] == b"VNRRG,01,VN-300"
    echoes = [command[1:].partition(b"*")[0] for command in commands]
    assert autopilot.answers[:3] + autopilot.answers[4:] == echoes[:3] + echoes[4:]


@pytest.mark.ardupilot
@pytest.mark.realtime
def test_in_lockstep_a_real_ekf_works_on_our_sensors(tmp_path: Path) -> None:
    """VectorNav and JSON world together: aligned, on GNSS, and right, in less than real time."""
    port = free_port()
    values = parameters("rover-vectornav.parm", "rover-no-simulated-sensors.parm")
    with (
        closing(JsonWorld("udp://127.0.0.1:0", lambda: None)) as world,
        Rover(tmp_path, values, world.address, {3: f"tcp:{port}:wait"}) as rover,
    ):
        unit = VectorNav(open_line(f"tcp://127.0.0.1:{port}"))
        units = (unit, world)
        for each in units:
            each.reset(TickClock(), True, lambda severity, text: None)
        vessel = Vessel(*units)
        watcher = Watcher(rover.mavlink)
        quat = _quaternion(ROLL / 2, PITCH / 2, YAW / 2)
        while vessel.now_ns < 60_000_000_000:
            vessel.go_on()
            vessel.go_on()
            at_s = vessel.now_ns * 1e-9
            pos = tuple(speed * at_s for speed in VEL_NED_MPS)
            truth = mav.MAVLink_xitl_truth_message(
                vessel.now_ns // 1000, pos, VEL_NED_MPS, quat, (0.0, 0.0, 0.0), -1.0, 0.0
            )
            world.handle(truth, vessel.now_ns)
            for _ in range(40):
                if world.advance(vessel.now_ns):
                    break
                unit.serve(vessel.now_ns)
            unit.advance(vessel.now_ns)
            seen = watcher.look(at_s)
        watcher.close()
        unit.close()
    assert any("EKF3 IMU0 is using GPS" in text for text in watcher.texts), watcher.texts
    assert seen.euler_deg == pytest.approx((5.0, -3.0, 40.0), abs=1.0)
    assert seen.solution_vel_ned_mps == pytest.approx(VEL_NED_MPS, abs=0.1)
    assert unit.counts.unsent == 0


def _quaternion(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Of half angles."""
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(angle), math.sin(angle)) for angle in (roll, pitch, yaw))
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )
