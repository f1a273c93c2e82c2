"""Commands that leave the mode as it is: targets of GUIDED, sticks, home, the fence."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

from agent.fcu.control.allocation import ThrustAllocator
from agent.fcu.control.controller import ControllerGuard, MakeController
from agent.fcu.control.guidance import GuidanceOutput
from agent.fcu.control.heading_speed import HeadingSpeedController
from agent.fcu.control.manual_control import ManualControl
from agent.fcu.estimation.estimator import Estimator
from agent.fcu.fence import Fence, FenceBreach, FenceError, FenceItem
from agent.fcu.geodetic import Home, position_problem
from agent.fcu.mission import MissionSequence
from agent.fcu.parameters import Parameters
from agent.fcu.vehicle import modes
from agent.fcu.vehicle.failsafes import FailsafeMonitor
from agent.fcu.vehicle.navigation import (
    POSITION,
    GuidedTarget,
    MissionProgress,
    Navigation,
    course_target,
    turn_target,
    velocity_target,
)
from agent.fcu.vehicle_state import (
    WARNING,
    BarometerMeasurement,
    Event,
    EventQueue,
    GnssMeasurement,
    ImuMeasurement,
    MagnetometerMeasurement,
    StateEstimate,
)

_MOST_REACHED = 64


class Ship:
    """The parts, fed with samples. `make_controller` builds what replaces the built-in HeadingSpeedController."""

    def __init__(self, parameters: Parameters | None = None, make_controller: MakeController | None = None) -> None:
        self.parameters = Parameters() if parameters is None else parameters
        self.mission = MissionSequence()
        self.fence = Fence(self.parameters)
        self._make_controller: MakeController = HeadingSpeedController if make_controller is None else make_controller
        self.reset()

    def reset(self) -> None:
        """Fresh state for a new run: disarmed, not aligned, no events. Parameters, mission and fence are kept."""
        p = self.parameters
        self.estimator = Estimator(p)
        self.estimate: StateEstimate = self.estimator.estimate()
        self.armed = False
        self.home: Home | None = None
        self._home_is_set = False
        self.mode = int(p["INITIAL_MODE"]) if int(p["INITIAL_MODE"]) in modes.BY_NUMBER else modes.HOLD
        self.events = EventQueue()
        self.reached: deque[int] = deque(maxlen=_MOST_REACHED)
        self.manual = ManualControl(p)
        self.voyage = Navigation(self.mission, p, self.events)
        self.controller = ControllerGuard(self._make_controller, p, self.events)
        self.propellers = ThrustAllocator(p)
        self.fence.breach = FenceBreach()
        self._failsafes = FailsafeMonitor(p)
        self.speed_error_mps = 0.0  # desired less measured speed over ground
        self.estimates_used = 0  # by control (LC), of the estimator's (LS)
        self._version = p.version
        self._now_ns = 0
        self._last_control_ns: int | None = None
        self._imu_accepted = 0

    def _configure(self) -> None:
        """Take changed parameters over."""
        self._version = self.parameters.version
        self.estimator.configure()
        self.manual.configure()
        self.voyage.configure(self.parameters)
        self.controller.configure()
        self.propellers.configure()
        self._failsafes.configure()

    # -- sensors

    def on_imu(self, sample: ImuMeasurement) -> bool:
        """Returns False when the sample was refused, as do the other three."""
        accepted = self.estimator.on_imu(sample)
        self._imu_accepted += accepted
        return accepted

    def on_gnss(self, sample: GnssMeasurement) -> bool:
        return self.estimator.on_gnss(sample)

    def on_magnetometer(self, sample: MagnetometerMeasurement) -> bool:
        return self.estimator.on_magnetometer(sample)

    def on_barometer(self, sample: BarometerMeasurement) -> bool:
        return self.estimator.on_barometer(sample)

    # -- reading

    @property
    def efforts(self) -> int:
        """Of control, that were allocated to the propellers (LA)."""
        return self.propellers.efforts

    @property
    def failsafe(self) -> bool:
        """Whether outputs are neutral for want of an IMU."""
        return self._failsafes.imu.active

    @property
    def failsafes(self) -> tuple[str, ...]:
        """Names of the failsafes in force: IMU, EKF, GCS, Fence."""
        return (*self._failsafes.active, *(("Fence",) if self.fence.breach.outside else ()))

    @property
    def pilot(self) -> MissionProgress:
        """Who sails the mission."""
        return self.voyage.pilot

    @property
    def navigation(self) -> GuidanceOutput | None:
        """What the mode in force steers by, None when it does not navigate."""
        return self.voyage.output

    @property
    def guided_target(self) -> GuidedTarget | None:
        """The target of GUIDED in force."""
        return self.voyage.guided.target if self.mode == modes.GUIDED else None

    @property
    def rc_channels(self) -> tuple[int, ...]:
        """Pulse widths in force of 18 channels, us, 0 where nobody overrides."""
        return self.manual.widths_us(self._now_ns)

    def fence_clearance_m(self) -> float:
        """How far inside of the fence the vessel is, negative outside, infinite without fence or position."""
        frame = self.estimator.frame
        if frame is None or not self.fence.enabled:
            return math.inf
        north_m, east_m, _ = self.estimate.pos_ned_m
        return self.fence.clearance_m(frame, self.voyage.home, *frame.to_geodetic(north_m, east_m))

    # -- what is said

    def take_events(self) -> list[Event]:
        """Events since the last call, oldest first."""
        return self.events.take()

    def take_reached(self) -> list[int]:
        """Sequence numbers of the waypoints reached since the last call."""
        taken = list(self.reached)
        self.reached.clear()
        return taken

    @property
    def events_lost(self) -> int:
        """Events that nobody took in time."""
        return self.events.lost

    def say(self, event: Event) -> None:
        """Queue an event."""
        self.events.say(event.severity, event.text)

    def _refused(self, reason: str) -> str:
        self.events.say(WARNING, reason)
        return reason

    def _restart(self) -> None:
        self.controller.restart()
        self.propellers.restart()
        self.speed_error_mps = 0.0

    def _home_is_here(self) -> None:
        frame = self.estimator.frame
        if frame is not None:
            north_m, east_m, down_m = self.estimate.pos_ned_m
            self._move_home(Home(*frame.to_geodetic(north_m, east_m), frame.alt_m - down_m))

    def _move_home(self, home: Home) -> None:
        self.home = home
        self.voyage.home = (home.lat_deg, home.lon_deg)
        self.voyage.homeward = None


class VehicleCommands(Ship):
    """Each returns the reason when it is refused, and says it; empty when done."""

    # -- targets of GUIDED

    def go_to(self, lat_deg: float, lon_deg: float) -> str:
        """Sail to a place and stay there."""
        problem = position_problem(lat_deg, lon_deg)
        frame = self.estimator.frame
        if not problem and frame is not None and self.fence.enabled:
            clearance_m = self.fence.clearance_m(frame, self.voyage.home, lat_deg, lon_deg)
            if clearance_m < self.parameters["FENCE_MARGIN"]:
                problem = f"position {lat_deg:g}, {lon_deg:g} is not inside the fence by FENCE_MARGIN"
        return self._guide(problem or GuidedTarget(POSITION, lat_deg, lon_deg))

    def go_to_local(self, north_m: float, east_m: float) -> str:
        """As `go_to`, metres from the estimator's origin."""
        frame = self.estimator.frame
        if frame is None:
            return self._refused("a local target needs a position")
        if not max(abs(north_m), abs(east_m)) < 1e6:
            return self._refused(f"position {north_m:g}, {east_m:g} m; use less than 1000 km")
        return self.go_to(*frame.to_geodetic(north_m, east_m))

    def set_velocity(
        self, north_mps: float, east_mps: float, yaw_rad: float | None = None, yaw_rate_radps: float | None = None
    ) -> str:
        """Velocity over ground, with a heading or a turn rate, for GUID_TIMEOUT."""
        return self._guide(velocity_target(north_mps, east_mps, yaw_rad, yaw_rate_radps))

    def set_course(self, heading_rad: float, speed_mps: float) -> str:
        """Heading and speed over ground, negative astern, for GUID_TIMEOUT."""
        return self._guide(course_target(heading_rad, speed_mps))

    def set_turn_rate(self, turn_rate_radps: float, speed_mps: float) -> str:
        """Turn rate and speed over ground, negative astern, for GUID_TIMEOUT."""
        return self._guide(turn_target(turn_rate_radps, speed_mps))

    def _guide(self, target: GuidedTarget | str) -> str:
        if isinstance(target, str):
            return self._refused(target)
        if self.mode != modes.GUIDED:
            return self._refused(f"targets are for GUIDED; the mode is {modes.NAMES[self.mode]}")
        self.voyage.guided.take(target, self._now_ns)
        return ""

    # -- sticks, stations, home, fence

    def rc_override(self, channels_us: tuple[int, ...], now_ns: int) -> str:
        """RC_CHANNELS_OVERRIDE."""
        problem = self.manual.override(channels_us, now_ns)
        return self._refused(problem) if problem else ""

    def manual_control(self, x: int | None, y: int | None, z: int | None, r: int | None, now_ns: int) -> str:
        """MANUAL_CONTROL: y steers, z is the throttle; a boat has no use for x and r, as ArduRover."""
        problem = self.manual.axes(y, z, now_ns)
        return self._refused(problem) if problem else ""

    def heard_ground_station(self, system_id: int, now_ns: int) -> None:
        """A heartbeat of a ground station."""
        self._failsafes.heard_ground_station(system_id, now_ns)

    def set_home(self, lat_deg: float, lon_deg: float, alt_m: float) -> str:
        """Home from now on; arming does not move it any more."""
        problem = position_problem(lat_deg, lon_deg)
        if not problem and not abs(alt_m) < 1e5:
            problem = f"altitude {alt_m:g} m is not one; use 0"
        if not problem and self.estimator.frame is None:
            problem = "home cannot be set before there is a position"
        if problem:
            return self._refused(problem)
        self._home_is_set = True
        self._move_home(Home(lat_deg, lon_deg, alt_m))
        return ""

    def set_home_here(self) -> str:
        """Home is where the vessel is now."""
        if not self.estimate.position_valid:
            return self._refused("home cannot be set here: no position")
        self._home_is_set = True
        self._home_is_here()
        return ""

    def set_fence(self, items: Sequence[FenceItem]) -> str:
        """Replace the fence; none of it is taken when an item is refused."""
        try:
            self.fence.replace(items)
        except FenceError as error:
            return self._refused(str(error))
        return ""

    def enable_fence(self, on: bool) -> str:
        """FENCE_ENABLE."""
        self.parameters.set("FENCE_ENABLE", float(on))
        return ""
