"""The pilot: where in the mission the vessel is, which leg it sails and how fast."""

from __future__ import annotations

from agent.fcu.guidance import GuidanceGains, GuidanceOutput, GuidanceState, Leg, carried_over, guide, leg
from agent.fcu.local_frame import LocalFrame
from agent.fcu.mission import CHANGE_SPEED, Mission

NOT_STARTED, UNDER_WAY, COMPLETE = range(3)


class Pilot:
    """Sails one mission. `current` is the waypoint ahead, 0 when there is none.

    The first leg, and the leg after an interruption, starts where the vessel is; every other leg joins two waypoints.
    """

    def __init__(self, mission: Mission, default_speed_mps: float) -> None:
        self.mission = mission
        self.default_speed_mps = default_speed_mps
        self.restart()

    def restart(self) -> None:
        """Back to the first waypoint."""
        self.speed_mps: float | None = None  # what CHANGE_SPEED asked for
        self.output: GuidanceOutput | None = None
        self.reached = 0  # waypoints reached so far
        self.state = NOT_STARTED
        self.current = 0
        self._take_up(0)
        self._fresh_reached: list[int] = []
        self.depart()

    def depart(self) -> None:
        """The next leg starts where the vessel is; a completed mission starts again."""
        self._leg: Leg | None = None
        self._frame: LocalFrame | None = None
        self._guidance = GuidanceState()
        if self.state == COMPLETE:
            self.restart()

    def steer(
        self,
        gains: GuidanceGains,
        frame: LocalFrame,
        pos_ne_m: tuple[float, float],
        yaw_rad: float,
        speed_mps: float,
        dt_s: float,
    ) -> GuidanceOutput | None:
        """Guidance along the mission, None once the last waypoint is reached."""
        if self.current == 0:
            self.state = COMPLETE
            return None
        self.state = UNDER_WAY
        line = self._leg
        if line is None or frame is not self._frame:
            self._frame = frame
            line = self._leg = self._leg_from(frame, pos_ne_m)
        desired_mps = self.default_speed_mps if self.speed_mps is None else self.speed_mps
        self._guidance, output = guide(gains, self._guidance, line, pos_ne_m, yaw_rad, speed_mps, desired_mps, dt_s)
        self.output = output
        if not output.reached:
            return output
        self.reached += 1
        self._fresh_reached.append(self.current)
        self._take_up(self.current)
        if self.current == 0:
            self.state = COMPLETE
            return None
        self._leg = self._leg_from(frame, (line.end_north_m, line.end_east_m))
        self._guidance = carried_over(self._guidance, self._leg.course_rad - line.course_rad)
        return output

    def take_reached(self) -> list[int]:
        """Waypoints reached since the last call."""
        taken, self._fresh_reached = self._fresh_reached, []
        return taken

    def _take_up(self, done: int) -> None:
        """Go on to the waypoint after `done`, carrying out what stands between."""
        ahead = self.mission.next_waypoint(done + 1)
        for item in self.mission.items[done + 1 : ahead]:
            if item.command == CHANGE_SPEED:
                self.speed_mps = item.speed_mps
        self.current = 0 if ahead is None else ahead

    def _leg_from(self, frame: LocalFrame, start_ne_m: tuple[float, float]) -> Leg:
        after = self.mission.next_waypoint(self.current + 1)
        end = self._local(frame, self.current)
        return leg(start_ne_m, end, None if after is None else self._local(frame, after))

    def _local(self, frame: LocalFrame, seq: int) -> tuple[float, float]:
        item = self.mission.items[seq]
        return frame.to_local(item.lat_deg, item.lon_deg)
