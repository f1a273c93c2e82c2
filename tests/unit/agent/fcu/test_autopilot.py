"""The loop closed on a boat of our own: missions, arming, modes and failsafes."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from boat import DECLINATION_RAD, LAT_DEG, LON_DEG, STEP_NS, THIRD, Boat, Hull, Noise, Sensors, degrees, sail

from agent.fcu.mission import make_mission, waypoint
from agent.fcu.parameters import Parameters
from agent.fcu.vehicle import modes
from agent.fcu.vehicle.autopilot import Autopilot
from agent.fcu.vehicle_state import Actuators

FIRMWARE_PARAMS = Path(__file__).parents[4] / "firmware_params"
SQUARE = ((0.0, 60.0), (60.0, 60.0), (60.0, 0.0), (0.0, 0.0))


def ready(points=SQUARE, **parameters: float) -> Autopilot:
    autopilot = Autopilot(Parameters({"COMPASS_DEC": DECLINATION_RAD, **parameters}))
    autopilot.commands.set_mission(
        make_mission([waypoint(LAT_DEG, LON_DEG), *(waypoint(*degrees(*point)) for point in points)])
    )
    assert autopilot.set_mode(modes.AUTO) == ""
    return autopilot


def armed(boat: Boat, sensors: Sensors, autopilot: Autopilot) -> None:
    sail(boat, sensors, autopilot, 12.0, lambda _: False)
    assert autopilot.arm() == ()


class Track:
    """True distance from the legs, and speed over ground on them."""

    def __init__(self, boat: Boat, autopilot: Autopilot) -> None:
        self.boat, self.autopilot = boat, autopilot
        self.corners = [(boat.north_m, boat.east_m), *SQUARE]
        self.off_m: list[float] = []
        self.cruising_mps: list[float] = []
        self.speeds: list[float] = []

    def __call__(self, actuators: Actuators) -> bool:
        assert all(abs(command) <= 1.0 for command in actuators.command)
        place = (self.boat.north_m, self.boat.east_m)
        self.off_m.append(min(_distance(place, a, b) for a, b in zip(self.corners, self.corners[1:])))
        course = self.autopilot.navigator.output
        full = course is not None and course.speed_mps == self.autopilot.parameters["WP_SPEED"]
        self.speeds = [*self.speeds, math.hypot(*self.boat.vel_ne_mps)] if full else []
        if len(self.speeds) > 400:  # four seconds after the ramp up to the desired speed: settled
            self.cruising_mps.append(self.speeds[-1])
        return self.autopilot.state.mode != modes.AUTO

    @property
    def rms_m(self) -> float:
        return math.sqrt(sum(value * value for value in self.off_m) / len(self.off_m))


def _distance(place, a, b) -> float:
    length = math.hypot(b[0] - a[0], b[1] - a[1])
    along = ((place[0] - a[0]) * (b[0] - a[0]) + (place[1] - a[1]) * (b[1] - a[1])) / length
    along = min(max(along, 0.0), length)
    return math.hypot(
        place[0] - a[0] - along * (b[0] - a[0]) / length, place[1] - a[1] - along * (b[1] - a[1]) / length
    )


def gusts(t: float) -> tuple[float, float]:
    """Newtons, about what 8 m/s of wind with gusts does to the hull."""
    return 30.0 + 20.0 * math.sin(0.3 * t), -40.0 - 20.0 * math.sin(0.5 * t)


@pytest.mark.medium
@pytest.mark.parametrize(
    ("current", "push", "limit_m"),
    [((0.0, 0.0), None, 1.0), ((0.5, 0.4), None, 2.0), ((-0.5, 0.6), gusts, 2.0)],
    ids=["still", "current", "current and gusts"],
)
def test_a_square_is_sailed(current, push, limit_m: float) -> None:
    boat = Boat(current_ne_mps=current, roll_amplitude_rad=math.radians(5.0), heave_amplitude_m=0.15, yaw_rad=0.7)
    if push is not None:
        boat.push_ne_n = push
    sensors, autopilot = Sensors(4, Noise(gnss_drift_m=0.3)), ready()
    armed(boat, sensors, autopilot)
    track = Track(boat, autopilot)
    sail(boat, sensors, autopilot, 150.0, track)
    assert autopilot.state.mode == modes.HOLD
    assert autopilot.navigator.drain_reached() == [1, 2, 3, 4]
    assert "Mission complete: HOLD" in [event.text for event in autopilot.events.drain()]
    assert track.rms_m < limit_m
    mean = sum(track.cruising_mps) / len(track.cruising_mps)
    assert mean == pytest.approx(3.0, abs=0.1)


@pytest.mark.parametrize(("name", "hull"), [("full", Hull()), ("third", THIRD)])
@pytest.mark.medium
def test_shipped_parameters_sail_their_vessel(name: str, hull: Hull) -> None:
    boat, sensors, autopilot = Boat(hull=hull, current_ne_mps=(0.2, 0.2)), Sensors(5, Noise(gnss_drift_m=0.3)), ready()
    autopilot.parameters.load((FIRMWARE_PARAMS / f"embedded-asv-{name}.parm").read_text())
    autopilot.parameters.set("GPS1_POS_Z", 0.0)  # the antenna of this boat is at its origin
    armed(boat, sensors, autopilot)
    track = Track(boat, autopilot)
    sail(boat, sensors, autopilot, 250.0, track)
    assert autopilot.state.mode == modes.HOLD
    assert track.rms_m < 1.0


def test_arming_names_what_is_missing() -> None:
    autopilot = Autopilot()
    autopilot.control(0)
    assert autopilot.arm() == ("Gyros not healthy", "AHRS: EKF3 not started")
    said = [event.text for event in autopilot.events.drain()]
    assert said == ["Arm: Gyros not healthy", "Arm: AHRS: EKF3 not started"]
    assert not autopilot.state.armed


def test_disarmed_and_hold_are_neutral() -> None:
    boat, sensors, autopilot = Boat(), Sensors(1, Noise()), ready()
    seen: list[Actuators] = []
    sail(boat, sensors, autopilot, 12.0, lambda actuators: bool(seen.append(actuators)))
    assert {actuators.command for actuators in seen} == {(0.0, 0.0)}
    autopilot.arm()
    sail(boat, sensors, autopilot, 1.0, lambda actuators: bool(seen.append(actuators)))
    assert seen[-1].command != (0.0, 0.0)
    autopilot.set_mode(modes.HOLD)
    assert autopilot.control(boat.time_ns).command == (0.0, 0.0)
    autopilot.set_mode(modes.AUTO)
    sail(boat, sensors, autopilot, 1.0, lambda actuators: bool(seen.append(actuators)))
    assert seen[-1].command != (0.0, 0.0)
    autopilot.disarm()
    assert autopilot.control(boat.time_ns) == Actuators((0.0, 0.0), False, False)


@pytest.mark.medium
def test_imu_lost_and_found() -> None:
    boat, sensors, autopilot = Boat(), Sensors(1, Noise()), ready()
    armed(boat, sensors, autopilot)
    sail(boat, sensors, autopilot, 3.0, lambda _: False)
    autopilot.events.drain()
    silent: list[Actuators] = []
    for _ in range(100):
        for _ in range(4):
            sensors.feed(boat, autopilot.estimator, imu=False, gnss=False)
            boat.step((0.0, 0.0))
        silent.append(autopilot.control(boat.time_ns))
    assert not silent[10].failsafe  # 0.22 s
    assert silent[13].failsafe
    assert all(actuators.command == (0.0, 0.0) for actuators in silent[13:])
    assert [event.text for event in autopilot.events.drain()] == ["Failsafe: no IMU for 0.25 s, outputs neutral"]
    sail(boat, sensors, autopilot, 2.0, lambda _: False)
    assert [event.text for event in autopilot.events.drain()] == ["Failsafe over: IMU is back, outputs resume"]
    assert autopilot.control(boat.time_ns).command != (0.0, 0.0)
    assert autopilot.state.armed
    assert autopilot.state.mode == modes.AUTO


@pytest.mark.medium
@pytest.mark.parametrize(("action", "mode"), [(1.0, modes.HOLD), (0.0, modes.AUTO)])
def test_position_lost(action: float, mode: int) -> None:
    boat, sensors, autopilot = Boat(), Sensors(1, Noise()), ready(FS_EKF_ACTION=action)
    armed(boat, sensors, autopilot)
    for _ in range(1400):
        sensors.feed(boat, autopilot.estimator, gnss=False)
        boat.step(autopilot.control(boat.time_ns).command if boat.time_ns % 20_000_000 == 0 else (0.3, 0.3))
    assert autopilot.state.mode == mode
    assert autopilot.control(boat.time_ns).command == (0.0, 0.0)
    texts = [event.text for event in autopilot.events.drain()]
    assert texts.count("EKF failsafe: position lost, HOLD") == (1 if action else 0)


@pytest.mark.parametrize("mode", [-1, 2, 99])
def test_unknown_modes_are_refused(mode: int) -> None:
    autopilot = Autopilot()
    assert "not supported" in autopilot.set_mode(mode)
    assert autopilot.state.mode == modes.HOLD


def test_auto_needs_a_mission_and_clearing_it_holds() -> None:
    assert "No Mission. Can't set AUTO." in Autopilot().set_mode(modes.AUTO)
    autopilot = ready()
    autopilot.commands.set_mission(make_mission([]))
    assert autopilot.state.mode == modes.HOLD


@pytest.mark.medium
def test_a_run_is_repeatable_and_reset_is_a_fresh_start() -> None:
    def fly(autopilot: Autopilot) -> tuple[object, ...]:
        boat, sensors = Boat(), Sensors(9, Noise())
        assert autopilot.set_mode(modes.AUTO) == ""
        armed(boat, sensors, autopilot)
        sail(boat, sensors, autopilot, 5.0, lambda _: False)
        return autopilot.state.estimate, autopilot.control(boat.time_ns), boat.north_m, boat.east_m

    autopilot = ready()
    first = fly(autopilot)
    autopilot.reset()
    assert not autopilot.state.armed
    assert fly(autopilot) == first == fly(ready())


def test_events_are_bounded_and_their_loss_counted() -> None:
    autopilot = Autopilot()
    for _ in range(100):
        autopilot.commands.change_speed(-1.0)
    assert autopilot.events.lost == 36
    assert len(autopilot.events.drain()) == 64
    assert autopilot.events.drain() == []


def test_a_slow_loop_still_ramps_by_the_clock() -> None:
    """At 10 Hz and 100 %/s a motor command changes by 10 % per cycle: the time that passed counts."""
    boat, sensors, autopilot = Boat(), Sensors(1, Noise()), ready(MOT_SLEWRATE=100.0)
    armed(boat, sensors, autopilot)
    autopilot.set_mode(modes.MANUAL)
    autopilot.control(boat.time_ns)
    autopilot.commands.manual_control(0, 0, 1000, 0, boat.time_ns)
    for _ in range(100_000_000 // STEP_NS):
        sensors.feed(boat, autopilot.estimator)
        boat.step((0.0, 0.0))
    assert autopilot.control(boat.time_ns).command == pytest.approx((0.1, 0.1))
