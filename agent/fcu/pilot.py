"""The pilot: where in the mission the vessel is, which leg it sails and how fast."""

from __future__ import annotations

from typing import NamedTuple

from agent.fcu.control.guidance import GuidanceGains, GuidanceOutput, GuidanceState, Leg, carried_over, guide, leg
from agent.fcu.control.station import Station
from agent.fcu.local_frame import LocalFrame
from agent.fcu.mission import (
    CHANGE_SPEED,
    FOREVER,
    JUMP,
    LEGS,
    LOITER_TIME,
    LOITER_UNLIMITED,
    RETURN_HOME,
    WAYPOINT,
    Mission,
)

NOT_STARTED, UNDER_WAY, COMPLETE = range(3)


class _Way(NamedTuple):
    """What comes next: item to sail to (0 for none), speed asked for on the way, jumps made so far by item."""

    current: int
    speed_mps: float | None
    jumps: dict[int, int]


class Pilot:
    """Sails one mission. `current` is the item ahead that is sailed to, 0 when there is none.

    The first leg, and the leg after an interruption, starts where the vessel is; every other leg joins two waypoints.
    `home` (latitude, longitude) is where RETURN_HOME goes; the mission's own item 0 when it is not set.
    """

    def __init__(self, mission: Mission, default_speed_mps: float) -> None:
        self.mission = mission
        self.default_speed_mps = default_speed_mps
        self.home: tuple[float, float] | None = None
        self.restart()

    def restart(self) -> None:
        """Back to the first waypoint."""
        self.speed_mps: float | None = None  # what CHANGE_SPEED asked for
        self.output: GuidanceOutput | None = None
        self.reached = 0  # waypoints reached so far
        self._fresh_reached: list[int] = []
        self._jumps: dict[int, int] = {}
        self.go_on_from(1)

    def go_on_from(self, seq: int) -> None:
        """Sail to the first waypoint at or after `seq`."""
        self.state = NOT_STARTED
        self._take_up(seq)
        self.depart()

    def depart(self) -> None:
        """The next leg starts where the vessel is; a completed mission starts again."""
        self._leg: Leg | None = None
        self._frame: LocalFrame | None = None
        self._guidance = GuidanceState()
        self._station: Station | None = None
        self._stayed_s = 0.0
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
        desired_mps = self.default_speed_mps if self.speed_mps is None else self.speed_mps
        if self._station is not None:
            return self._stay(self._station, gains, frame, pos_ne_m, yaw_rad, desired_mps, dt_s)
        line = self._leg
        if line is None or frame is not self._frame:
            self._frame = frame
            line = self._leg = self._leg_from(frame, pos_ne_m)
        self._guidance, output = guide(gains, self._guidance, line, pos_ne_m, yaw_rad, speed_mps, desired_mps, dt_s)
        self.output = output
        if not output.reached:
            return output
        if self._stays(self.current):
            self._station = Station(*frame.to_geodetic(line.end_north_m, line.end_east_m))
            self._stayed_s = 0.0
            return output
        return self._reach(frame, line, output)

    def _stay(
        self,
        station: Station,
        gains: GuidanceGains,
        frame: LocalFrame,
        pos_ne_m: tuple[float, float],
        yaw_rad: float,
        desired_mps: float,
        dt_s: float,
    ) -> GuidanceOutput | None:
        self._stayed_s += dt_s
        self.output = output = station.steer(gains, frame, pos_ne_m, yaw_rad, desired_mps)
        item = self.mission.items[self.current]
        if item.command == LOITER_UNLIMITED or self._stayed_s < item.hold_s:
            return output
        self._station = None
        return self._reach(frame, None, output)

    def _reach(self, frame: LocalFrame, line: Leg | None, output: GuidanceOutput) -> GuidanceOutput | None:
        """The current item is done; without a line the next leg starts where the vessel is."""
        self.reached += 1
        self._fresh_reached.append(self.current)
        self._take_up(self.current + 1)
        if self.current == 0:
            self.state = COMPLETE
            return None
        if line is None:
            self._leg, self._guidance = None, GuidanceState()
            return output
        self._leg = self._leg_from(frame, (line.end_north_m, line.end_east_m))
        self._guidance = carried_over(self._guidance, self._leg.course_rad - line.course_rad)
        return output

    def take_reached(self) -> list[int]:
        """Waypoints reached since the last call."""
        taken, self._fresh_reached = self._fresh_reached, []
        return taken

    def _take_up(self, seq: int) -> None:
        self.current, self.speed_mps, self._jumps = self._way(seq)

    def _way(self, seq: int) -> _Way:
        """From `seq` to the next item that is sailed to, by what stands between. Jumps in a ring end the mission."""
        items, speed_mps, jumps = self.mission.items, self.speed_mps, self._jumps
        for _ in range(2 * len(items)):
            if seq >= len(items):
                break
            item = items[seq]
            if item.command in LEGS:
                return _Way(seq, speed_mps, jumps)
            made = jumps.get(seq, 0)
            if item.command == CHANGE_SPEED:
                speed_mps = item.speed_mps
            if item.command == JUMP and (item.repeats == FOREVER or made < item.repeats):
                jumps = {**jumps, seq: made + 1}
                seq = item.jump_seq
            else:
                seq += 1
        return _Way(0, speed_mps, jumps)

    def _stays(self, seq: int) -> bool:
        item = self.mission.items[seq]
        return item.command in (LOITER_TIME, LOITER_UNLIMITED) or (item.command == WAYPOINT and item.hold_s > 0.0)

    def _leg_from(self, frame: LocalFrame, start_ne_m: tuple[float, float]) -> Leg:
        end = self._local(frame, self.current, start_ne_m)
        after = 0 if self._stays(self.current) else self._way(self.current + 1).current
        return leg(start_ne_m, end, self._local(frame, after, end) if after else None)

    def _local(self, frame: LocalFrame, seq: int, here_ne_m: tuple[float, float]) -> tuple[float, float]:
        item = self.mission.items[seq]
        if item.command == RETURN_HOME:
            home = self.mission.items[0]
            return frame.to_local(*(self.home or (home.lat_deg, home.lon_deg)))
        if item.lat_deg == 0.0 and item.lon_deg == 0.0:  # loitering "here"
            return here_ne_m
        return frame.to_local(item.lat_deg, item.lon_deg)
