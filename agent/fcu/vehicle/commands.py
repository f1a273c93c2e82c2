"""What operators may ask of the autopilot beside arming and modes: mission, targets of GUIDED, sticks, home, fence."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Callable

from agent.fcu.control.manual_control import ManualControl
from agent.fcu.estimation.estimator import Estimator
from agent.fcu.fence import Fence, FenceError, FenceItem
from agent.fcu.geodetic import Home, position_problem
from agent.fcu.mission import MissionSequence
from agent.fcu.parameters import Parameters
from agent.fcu.vehicle import modes
from agent.fcu.vehicle.navigation import (
    POSITION,
    GuidedTarget,
    Navigator,
    course_target,
    turn_target,
    velocity_target,
)
from agent.fcu.vehicle_state import NOTICE, EventQueue, VehicleState


class OperatorCommands:
    """Each command returns the reason when it is refused, which is an event too; empty when done."""

    def __init__(
        self,
        parameters: Parameters,
        state: VehicleState,
        estimator: Estimator,
        navigator: Navigator,
        fence: Fence,
        manual: ManualControl,
        events: EventQueue,
        set_mode: Callable[[int], str],
        switch_mode: Callable[[int], None],
    ) -> None:
        self._parameters = parameters
        self._state = state
        self._estimator = estimator
        self._navigator = navigator
        self._fence = fence
        self._manual = manual
        self._events = events
        self._set_mode = set_mode
        self._switch_mode = switch_mode

    # -- mission

    def set_mission(self, mission: MissionSequence) -> None:
        """Replace the mission; in AUTO the new one starts from its first waypoint, an empty one ends in HOLD."""
        self._navigator.load_mission(mission)
        if self._state.mode == modes.AUTO and not mission.waypoints():
            self._events.add(NOTICE, "Mission cleared: HOLD")
            self._switch_mode(modes.HOLD)

    def start_mission(self) -> str:
        """AUTO from the first waypoint; the vessel moves once armed."""
        refused = self._set_mode(modes.AUTO)
        if not refused:
            self._navigator.progress.restart()
        return refused

    def set_current(self, seq: int) -> str:
        """Go on from mission item `seq`, 0 for the first."""
        mission = self._navigator.mission
        if not 0 <= seq < len(mission.items):
            return self._events.refuse(f"mission item {seq} is not there; the mission has {len(mission.items)} items")
        if mission.next_waypoint(seq) is None:
            return self._events.refuse(f"mission item {seq}: no waypoint comes after it")
        self._navigator.progress.resume_from(max(seq, 1))
        return ""

    def change_speed(self, speed_mps: float) -> str:
        """Speed over ground from now on: of the mission, or of RTL and GUIDED while they last."""
        if not 0.0 < speed_mps <= 100.0:
            return self._events.refuse(f"speed {speed_mps:g} m/s; use more than 0, at most 100")
        if self._state.mode in (modes.RTL, modes.GUIDED):
            self._navigator.asked_mps = speed_mps
        else:
            self._navigator.progress.speed_mps = speed_mps
        return ""

    # -- targets of GUIDED

    def go_to(self, lat_deg: float, lon_deg: float) -> str:
        """Go to a position and stay there."""
        problem = position_problem(lat_deg, lon_deg)
        frame = self._estimator.frame
        if not problem and frame is not None and self._fence.enabled:
            clearance_m = self._fence.clearance_m(frame, self._navigator.home, lat_deg, lon_deg)
            if clearance_m < self._parameters["FENCE_MARGIN"]:
                problem = f"position {lat_deg:g}, {lon_deg:g} is not inside the fence by FENCE_MARGIN"
        return self._guide(problem or GuidedTarget(POSITION, lat_deg, lon_deg))

    def go_to_local(self, north_m: float, east_m: float) -> str:
        """As `go_to`, metres from the estimator's origin."""
        frame = self._estimator.frame
        if frame is None:
            return self._events.refuse("a local target needs a position")
        if not max(abs(north_m), abs(east_m)) < 1e6:
            return self._events.refuse(f"position {north_m:g}, {east_m:g} m; use less than 1000 km")
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
            return self._events.refuse(target)
        if self._state.mode != modes.GUIDED:
            return self._events.refuse(f"targets are for GUIDED; the mode is {modes.NAMES[self._state.mode]}")
        self._navigator.guided.set_target(target, self._state.now_ns)
        return ""

    # -- sticks, home, fence

    def rc_override(self, channels_us: tuple[int, ...], now_ns: int) -> str:
        """RC_CHANNELS_OVERRIDE."""
        problem = self._manual.override(channels_us, now_ns)
        return self._events.refuse(problem) if problem else ""

    def manual_control(self, x: int | None, y: int | None, z: int | None, r: int | None, now_ns: int) -> str:
        """MANUAL_CONTROL: y steers, z is the throttle; a boat has no use for x and r, as ArduRover."""
        problem = self._manual.set_axes(y, z, now_ns)
        return self._events.refuse(problem) if problem else ""

    def set_home(self, lat_deg: float, lon_deg: float, alt_m: float) -> str:
        """Home from now on; arming does not move it any more."""
        problem = position_problem(lat_deg, lon_deg)
        if not problem and not abs(alt_m) < 1e5:
            problem = f"altitude {alt_m:g} m is not one; use 0"
        if not problem and self._estimator.frame is None:
            problem = "home cannot be set before there is a position"
        if problem:
            return self._events.refuse(problem)
        self._navigator.home_is_set = True
        self._navigator.set_home(Home(lat_deg, lon_deg, alt_m))
        return ""

    def set_home_here(self) -> str:
        """Home is where the vessel is now."""
        if not self._state.estimate.position_valid:
            return self._events.refuse("home cannot be set here: no position")
        self._navigator.home_is_set = True
        self._navigator.set_home_here(self._estimator.frame, self._state.estimate)
        return ""

    def set_fence(self, items: Sequence[FenceItem]) -> str:
        """Replace the fence; none of it is taken when an item is refused."""
        try:
            self._fence.replace(items)
        except FenceError as error:
            return self._events.refuse(str(error))
        return ""

    def enable_fence(self, on: bool) -> str:
        """FENCE_ENABLE."""
        self._parameters.set("FENCE_ENABLE", float(on))
        return ""
