"""Orders that leave the mode as it is: targets of GUIDED, sticks, home, the fence."""

from __future__ import annotations

from collections.abc import Sequence

from agent.fcu import modes
from agent.fcu.control.guided import POSITION, GuidedTarget, course_target, place_problem, turn_target, velocity_target
from agent.fcu.fence import FenceError, FenceItem
from agent.fcu.ship import Home, Ship


class Orders(Ship):
    """Each returns the reason when it is refused, and says it; empty when done."""

    # -- targets of GUIDED

    def go_to(self, lat_deg: float, lon_deg: float) -> str:
        """Sail to a place and stay there."""
        problem = place_problem(lat_deg, lon_deg)
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
        problem = place_problem(lat_deg, lon_deg)
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
