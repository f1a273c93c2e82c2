"""The embedded autopilot: estimator (LS), guidance and control (LC) and allocation (LA) behind one interface.

Sensors in, actuators out. Two clocks meet here and are never mixed: samples carry the sensors' clock, `now_ns` is the
agent's. Times on the agent's clock are only ever compared with each other.

Failsafes:
- No IMU sample for FS_IMU_TIMEOUT: outputs neutral, said once; when samples return, outputs go on in the same mode.
- Position lost (no usable fix for five seconds) in AUTO with FS_EKF_ACTION 1: HOLD, and it stays there.

After the last waypoint the mode is HOLD with neutral outputs: the vessel drifts. There is no station keeping.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from agent.fcu import modes
from agent.fcu.allocation import NEUTRAL
from agent.fcu.control import (
    ground_speed_mps,
)
from agent.fcu.estimator import Estimator
from agent.fcu.guidance import GuidanceGains
from agent.fcu.helm import Helm
from agent.fcu.mission import Mission
from agent.fcu.parameters import Parameters
from agent.fcu.pilot import Pilot
from agent.fcu.samples import Actuators, BarometerSample, Estimate, GnssSample, ImuSample, MagnetometerSample

LOOP_HZ = 50
_LOOP_S = 1.0 / LOOP_HZ
_MOST_EVENTS = 64

CRITICAL, ERROR, WARNING, NOTICE, INFO = 2, 3, 4, 5, 6  # MAV_SEVERITY


class Event(NamedTuple):
    """A sentence for the person at the ground station, with a MAV_SEVERITY."""

    severity: int
    text: str


class Home(NamedTuple):
    """Where the vessel was armed, or first knew where it was."""

    lat_deg: float
    lon_deg: float
    alt_m: float


class Autopilot:
    """Feed it samples, call `control` at LOOP_HZ. Methods that can be refused return the reason, empty when done."""

    def __init__(self, parameters: Parameters | None = None) -> None:
        self.parameters = Parameters() if parameters is None else parameters
        self.mission = Mission()
        self.reset()

    def reset(self) -> None:
        """Fresh state for a new run: disarmed, not aligned, no events. Parameters and mission are kept."""
        self.estimator = Estimator(self.parameters)
        self.estimate: Estimate = self.estimator.estimate()
        self.armed = False
        self.failsafe = False
        self.home: Home | None = None
        self.mode = int(self.parameters["INITIAL_MODE"])
        if self.mode not in modes.NAMES:
            self.mode = modes.HOLD
        self.events: deque[Event] = deque(maxlen=_MOST_EVENTS)
        self.events_lost = 0
        self.reached: deque[int] = deque(maxlen=_MOST_EVENTS)
        self.pilot = Pilot(self.mission, self.parameters["WP_SPEED"])
        self._helm = Helm(self.parameters)
        self._configure()
        self._last_control_ns: int | None = None
        self._imu_accepted = 0
        self._imu_noticed = 0
        self._imu_seen_ns: int | None = None
        self._manual: tuple[float, float] = NEUTRAL
        self._manual_ns: int | None = None

    def _configure(self) -> None:
        """Take changed parameters over."""
        p = self.parameters
        self._version = p.version
        self._guidance_gains = GuidanceGains.of(p)
        self._helm.configure()
        self._imu_timeout_ns = int(p["FS_IMU_TIMEOUT"] * 1e9)
        self._manual_timeout_ns = int(p["FS_TIMEOUT"] * 1e9)
        self._hold_without_position = p["FS_EKF_ACTION"] >= 1.0
        self.pilot.default_speed_mps = p["WP_SPEED"]
        self.estimator.configure()

    # -- sensors

    def on_imu(self, sample: ImuSample) -> bool:
        """Returns False when the sample was refused, as do the other three."""
        accepted = self.estimator.on_imu(sample)
        self._imu_accepted += accepted
        return accepted

    def on_gnss(self, sample: GnssSample) -> bool:
        return self.estimator.on_gnss(sample)

    def on_magnetometer(self, sample: MagnetometerSample) -> bool:
        return self.estimator.on_magnetometer(sample)

    def on_barometer(self, sample: BarometerSample) -> bool:
        return self.estimator.on_barometer(sample)

    # -- the loop

    def control(self, now_ns: int) -> Actuators:
        """One cycle at LOOP_HZ on the agent's clock."""
        dt_s = _LOOP_S
        if self._last_control_ns is not None:
            elapsed_s = (now_ns - self._last_control_ns) * 1e-9
            if 0.2 * _LOOP_S < elapsed_s < 10.0 * _LOOP_S:
                dt_s = elapsed_s
        self._last_control_ns = now_ns
        if self.parameters.version != self._version:
            self._configure()
        estimate = self.estimate = self.estimator.estimate()
        if self.home is None and estimate.position_valid:
            self._set_home()
        self._watch_imu(now_ns)
        self._watch_position(estimate)
        if not self.armed or self.failsafe:
            self._helm.restart()
            return Actuators(NEUTRAL, self.armed, self.failsafe)

        thrust = steering = 0.0
        if self.mode == modes.AUTO and estimate.position_valid:
            thrust, steering = self._follow(estimate, dt_s)
        elif self.mode == modes.MANUAL and self._manual_is_fresh(now_ns):
            thrust, steering = self._manual
        return Actuators(self._helm.drive(thrust, steering, dt_s), True, False)

    def _follow(self, estimate: Estimate, dt_s: float) -> tuple[float, float]:
        """Steer along the mission."""
        (north_m, east_m, _), (vn, ve, _) = estimate.pos_ned_m, estimate.vel_ned_mps
        frame = self.estimator.frame
        if frame is None:
            return NEUTRAL
        yaw_rad = estimate.yaw_rad
        speed_mps = ground_speed_mps(yaw_rad, vn, ve)
        course = self.pilot.steer(self._guidance_gains, frame, (north_m, east_m), yaw_rad, speed_mps, dt_s)
        for seq in self.pilot.take_reached():
            self.reached.append(seq)
            self._say(INFO, f"Reached waypoint {seq}")
        if course is None:
            self._say(NOTICE, "Mission complete: HOLD")
            self.mode = modes.HOLD
            self._helm.restart()
            return NEUTRAL
        return self._helm.toward(
            course.heading_rad, course.speed_mps, yaw_rad, estimate.gyro_frd_radps[2], speed_mps, dt_s
        )

    def _watch_imu(self, now_ns: int) -> None:
        if self._imu_accepted != self._imu_noticed or self._imu_seen_ns is None:
            self._imu_noticed = self._imu_accepted
            self._imu_seen_ns = now_ns
        silent = now_ns - self._imu_seen_ns > self._imu_timeout_ns
        if silent and not self.failsafe and (self._imu_accepted > 0 or self.armed):
            self.failsafe = True
            self._say(CRITICAL, f"Failsafe: no IMU for {self._imu_timeout_ns * 1e-9:g} s, outputs neutral")
        elif self.failsafe and not silent:
            self.failsafe = False
            self._say(NOTICE, "Failsafe over: IMU is back, outputs go on")

    def _watch_position(self, estimate: Estimate) -> None:
        if self.armed and self.mode == modes.AUTO and not estimate.position_valid and self._hold_without_position:
            self._say(CRITICAL, "EKF failsafe: position lost, HOLD")
            self.mode = modes.HOLD

    def _manual_is_fresh(self, now_ns: int) -> bool:
        return self._manual_ns is not None and 0 <= now_ns - self._manual_ns <= self._manual_timeout_ns

    @property
    def speed_error_mps(self) -> float:
        """Desired less measured speed over ground."""
        return self._helm.speed_error_mps

    # -- commands

    def prearm_problems(self) -> tuple[str, ...]:
        """Why arming is refused, each by name; empty when ready."""
        if self.parameters["ARMING_CHECK"] < 1.0:
            return ()
        found = list(self.estimator.problems())
        if self.failsafe or self._imu_accepted == 0:
            found.insert(0, "IMU: no data")
        if self.mode == modes.AUTO and not self.mission.waypoints():
            found.append("Mission: no waypoint")
        return tuple(found)

    def arm(self) -> tuple[str, ...]:
        """Arm, or say why not. Home moves to where the vessel is."""
        if self.armed:
            return ()
        problems = self.prearm_problems()
        if problems:
            for problem in problems:
                self._say(ERROR, f"PreArm: {problem}")
            return problems
        self.armed = True
        self._helm.restart()
        self.pilot.depart()
        if self.estimate.position_valid:
            self._set_home()
        self._say(INFO, "Armed")
        return ()

    def disarm(self) -> None:
        """Outputs are neutral from now on."""
        if self.armed:
            self.armed = False
            self._say(INFO, "Disarmed")

    def set_mode(self, mode: int) -> str:
        """Change the mode by its ArduRover number."""
        if mode not in modes.NAMES:
            known = ", ".join(f"{number} {name}" for number, name in modes.NAMES.items())
            return self._refused(f"mode {mode} is not supported; use {known}")
        if mode == self.mode:
            return ""
        if mode == modes.AUTO:
            if not self.mission.waypoints():
                return self._refused("AUTO needs a mission with a waypoint")
            if self.armed and not self.estimator.position_valid():
                return self._refused("AUTO needs a position")
            self.pilot.depart()
        self._helm.restart()
        self.mode = mode
        self._say(INFO, f"Mode {modes.NAMES[mode]}")
        return ""

    def set_mission(self, mission: Mission) -> None:
        """Replace the mission; in AUTO the new one starts from its first waypoint, an empty one ends in HOLD."""
        self.mission = mission
        self.pilot = Pilot(mission, self.parameters["WP_SPEED"])
        if self.mode == modes.AUTO and not mission.waypoints():
            self.mode = modes.HOLD
            self._say(NOTICE, "Mission cleared: HOLD")

    def start_mission(self) -> str:
        """AUTO from the first waypoint; sails once armed."""
        refused = self.set_mode(modes.AUTO)
        if not refused:
            self.pilot.restart()
        return refused

    def change_speed(self, speed_mps: float) -> str:
        """Speed over ground of the mission from now on."""
        if not 0.0 < speed_mps <= 100.0:
            return self._refused(f"speed {speed_mps:g} m/s; use more than 0, at most 100")
        self.pilot.speed_mps = speed_mps
        return ""

    def manual_input(self, thrust: float, steering: float, now_ns: int) -> str:
        """Demands in [-1, 1] for MANUAL; neutral again FS_TIMEOUT later."""
        if not (abs(thrust) <= 1.0 and abs(steering) <= 1.0):
            return self._refused(f"manual input {thrust:g}, {steering:g}; use -1 to 1")
        self._manual = (thrust, steering)
        self._manual_ns = now_ns
        return ""

    def take_events(self) -> list[Event]:
        """Events since the last call, oldest first."""
        taken = list(self.events)
        self.events.clear()
        return taken

    def take_reached(self) -> list[int]:
        """Sequence numbers of the waypoints reached since the last call."""
        taken = list(self.reached)
        self.reached.clear()
        return taken

    def _set_home(self) -> None:
        frame = self.estimator.frame
        if frame is not None:
            north_m, east_m, down_m = self.estimator.estimate().pos_ned_m
            self.home = Home(*frame.to_geodetic(north_m, east_m), frame.alt_m - down_m)

    def _refused(self, reason: str) -> str:
        self._say(WARNING, reason)
        return reason

    def say(self, event: Event) -> None:
        """Queue an event; when nobody takes them the oldest are lost and counted."""
        if len(self.events) == _MOST_EVENTS:
            self.events_lost += 1
        self.events.append(event)

    def _say(self, severity: int, text: str) -> None:
        self.say(Event(severity, text))
