"""The pilot: where in the mission the vessel is, which leg it sails and how fast."""

from __future__ import annotations

import math
from typing import NamedTuple

from agent.fcu.control.guidance import (
    CourseOverGround,
    GuidanceGains,
    GuidanceLeg,
    GuidanceOutput,
    GuidanceState,
    PointTransit,
    StationKeeping,
    carry_integral,
    follow_leg,
    make_leg,
    wrap_angle,
)
from agent.fcu.control.manual_control import Sticks
from agent.fcu.geodetic import LocalProjection
from agent.fcu.mission import (
    CHANGE_SPEED,
    FOREVER,
    JUMP,
    LEGS,
    LOITER_TIME,
    LOITER_UNLIMITED,
    RETURN_HOME,
    WAYPOINT,
    MissionSequence,
)
from agent.fcu.parameters import Parameters
from agent.fcu.vehicle_state import NOTICE, EventQueue, StateEstimate

NOT_STARTED, UNDER_WAY, COMPLETE = range(3)
POSITION, VELOCITY, COURSE, TURN = range(4)
_MOST_MPS = 100.0
_MOST_RADPS = 10.0


class _Way(NamedTuple):
    """What comes next: item to sail to (0 for none), speed asked for on the way, jumps made so far by item."""

    current: int
    speed_mps: float | None
    jumps: dict[int, int]


class MissionProgress:
    """Sails one mission. `current` is the item ahead that is sailed to, 0 when there is none.

    The first leg, and the leg after an interruption, starts where the vessel is; every other leg joins two waypoints.
    `home` (latitude, longitude) is where RETURN_HOME goes; the mission's own item 0 when it is not set.
    """

    def __init__(self, mission: MissionSequence, default_speed_mps: float) -> None:
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
        self._leg: GuidanceLeg | None = None
        self._frame: LocalProjection | None = None
        self._guidance = GuidanceState()
        self._station: StationKeeping | None = None
        self._stayed_s = 0.0
        if self.state == COMPLETE:
            self.restart()

    def steer(
        self,
        gains: GuidanceGains,
        frame: LocalProjection,
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
        self._guidance, output = follow_leg(
            gains, self._guidance, line, pos_ne_m, yaw_rad, speed_mps, desired_mps, dt_s
        )
        self.output = output
        if not output.reached:
            return output
        if self._stays(self.current):
            self._station = StationKeeping(*frame.to_geodetic(line.end_north_m, line.end_east_m))
            self._stayed_s = 0.0
            return output
        return self._reach(frame, line, output)

    def _stay(
        self,
        station: StationKeeping,
        gains: GuidanceGains,
        frame: LocalProjection,
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

    def _reach(self, frame: LocalProjection, line: GuidanceLeg | None, output: GuidanceOutput) -> GuidanceOutput | None:
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
        self._guidance = carry_integral(self._guidance, self._leg.course_rad - line.course_rad)
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

    def _leg_from(self, frame: LocalProjection, start_ne_m: tuple[float, float]) -> GuidanceLeg:
        end = self._local(frame, self.current, start_ne_m)
        after = 0 if self._stays(self.current) else self._way(self.current + 1).current
        return make_leg(start_ne_m, end, self._local(frame, after, end) if after else None)

    def _local(self, frame: LocalProjection, seq: int, here_ne_m: tuple[float, float]) -> tuple[float, float]:
        item = self.mission.items[seq]
        if item.command == RETURN_HOME:
            home = self.mission.items[0]
            return frame.to_local(*(self.home or (home.lat_deg, home.lon_deg)))
        if item.lat_deg == 0.0 and item.lon_deg == 0.0:  # loitering "here"
            return here_ne_m
        return frame.to_local(item.lat_deg, item.lon_deg)


class ModeInput(NamedTuple):
    """One cycle as a mode sees it; `speed_mps` is over ground, negative astern."""

    now_ns: int
    dt_s: float
    estimate: StateEstimate
    frame: LocalProjection
    pos_ne_m: tuple[float, float]
    speed_mps: float
    sticks: Sticks


class Navigation:
    """`home` is (latitude, longitude); `output` is the guidance of the mode in force, None when it has none;
    `asked_mps` is a speed asked for while it is.
    """

    def __init__(self, mission: MissionSequence, parameters: Parameters, events: EventQueue) -> None:
        self.pilot = MissionProgress(mission, parameters["WP_SPEED"])
        self.guided = GuidedNavigation()
        self.station: StationKeeping | None = None
        self.homeward: PointTransit | None = None
        self.home: tuple[float, float] | None = None
        self.output: GuidanceOutput | None = None
        self.asked_mps: float | None = None
        self._events = events
        self.configure(parameters)

    def configure(self, p: Parameters) -> None:
        """Take changed parameters over."""
        self.gains = GuidanceGains.of(p)
        self.cruise_mps = p["WP_SPEED"]
        self.homeward_mps = p["RTL_SPEED"] or p["WP_SPEED"]
        # Drag, and with it thrust, grows with the square of the speed.
        self.speed_max_mps = p["SPEED_MAX"] or p["CRUISE_SPEED"] / math.sqrt(p["CRUISE_THROTTLE"] / 100.0)
        self.acro_radps = math.radians(p["ACRO_TURN_RATE"])
        self.turn_radius_m = p["TURN_RADIUS"]
        self.guided_timeout_ns = int(p["GUID_TIMEOUT"] * 1e9)
        self.pilot.default_speed_mps = p["WP_SPEED"]

    def notice(self, text: str) -> None:
        """Say it to the ground station."""
        self._events.say(NOTICE, text)

    def load(self, mission: MissionSequence) -> None:
        """A new mission, from its start."""
        self.pilot = MissionProgress(mission, self.cruise_mps)

    def depart(self) -> None:
        """AUTO: the next leg starts where the vessel is."""
        self.pilot.depart()

    def leave_station(self) -> None:
        """LOITER: stay where the vessel comes to rest next."""
        self.station = None

    def turn_home(self) -> None:
        """RTL: the way home starts where the vessel is."""
        self.homeward = None

    def await_target(self) -> None:
        """GUIDED: stay where the vessel comes to rest, until a target comes."""
        self.guided.drop()

    def stopping_place(self, now: ModeInput) -> tuple[float, float]:
        """Latitude and longitude of where the vessel comes to rest at ATC_DECEL_MAX."""
        (vn, ve, _), (north_m, east_m) = now.estimate.vel_ned_mps, now.pos_ne_m
        slowing_s = 0.5 * math.hypot(vn, ve) / self.gains.deceleration_mps2
        return now.frame.to_geodetic(north_m + slowing_s * vn, east_m + slowing_s * ve)


class GuidedTarget(NamedTuple):
    """What was asked for; the fields count for the kinds that have them.

    POSITION: a place. VELOCITY: over ground, with `heading_rad` when a heading was asked for too. COURSE: `heading_rad`
    and `speed_mps`. TURN: `turn_rate_radps` and `speed_mps`. Speeds are over ground, negative astern.
    """

    kind: int
    lat_deg: float = 0.0
    lon_deg: float = 0.0
    north_mps: float = 0.0
    east_mps: float = 0.0
    heading_rad: float | None = None
    turn_rate_radps: float = 0.0
    speed_mps: float = 0.0


class GuidedNavigation:
    """The target in force, None when there is none: then the vessel stays where it is."""

    def __init__(self) -> None:
        self.target: GuidedTarget | None = None
        self.passage: PointTransit | None = None  # the way to a place, or to where the vessel has to stop
        self.course = CourseOverGround()
        self._stamp_ns = 0

    def take(self, target: GuidedTarget, now_ns: int) -> None:
        """A new target takes the place of the old one; the same place again changes nothing."""
        if target == self.target and target.kind == POSITION:
            return
        self.passage = PointTransit(target.lat_deg, target.lon_deg) if target.kind == POSITION else None
        if target.kind != VELOCITY:
            self.course = CourseOverGround()
        self.target = target
        self._stamp_ns = now_ns

    def drop(self) -> None:
        """No target."""
        self.target = None
        self.passage = None
        self.course = CourseOverGround()

    def is_stale(self, now_ns: int, timeout_ns: int) -> bool:
        """Whether a target that has to be repeated was not."""
        target = self.target
        return target is not None and target.kind != POSITION and not 0 <= now_ns - self._stamp_ns <= timeout_ns


def velocity_target(
    north_mps: float, east_mps: float, yaw_rad: float | None, yaw_rate_radps: float | None
) -> GuidedTarget | str:
    """The target that a velocity with a heading or a turn rate asks for, or why it cannot be."""
    speed_mps = math.hypot(north_mps, east_mps)
    if not speed_mps <= _MOST_MPS:
        return f"velocity {north_mps:g}, {east_mps:g} m/s; use at most {_MOST_MPS:g}"
    if yaw_rad is not None:
        if not math.isfinite(yaw_rad):
            return f"heading {yaw_rad:g} is not one; use radians"
        along_mps = north_mps * math.cos(yaw_rad) + east_mps * math.sin(yaw_rad)
        return GuidedTarget(
            VELOCITY, north_mps=north_mps, east_mps=east_mps, heading_rad=wrap_angle(yaw_rad), speed_mps=along_mps
        )
    if yaw_rate_radps is not None:
        return turn_target(yaw_rate_radps, speed_mps)
    return GuidedTarget(VELOCITY, north_mps=north_mps, east_mps=east_mps, speed_mps=speed_mps)


def course_target(heading_rad: float, speed_mps: float) -> GuidedTarget | str:
    """A heading and a speed, or why not."""
    if not (math.isfinite(heading_rad) and abs(speed_mps) <= _MOST_MPS):
        return f"heading {heading_rad:g} rad, speed {speed_mps:g} m/s; use numbers, and at most {_MOST_MPS:g} m/s"
    return GuidedTarget(COURSE, heading_rad=wrap_angle(heading_rad), speed_mps=speed_mps)


def turn_target(turn_rate_radps: float, speed_mps: float) -> GuidedTarget | str:
    """A turn rate and a speed, or why not."""
    if not (abs(turn_rate_radps) <= _MOST_RADPS and abs(speed_mps) <= _MOST_MPS):
        return (
            f"turn rate {turn_rate_radps:g} rad/s, speed {speed_mps:g} m/s; use at most {_MOST_RADPS:g}, {_MOST_MPS:g}"
        )
    return GuidedTarget(TURN, turn_rate_radps=turn_rate_radps, speed_mps=speed_mps)
