"""What the modes steer by: progress along the mission, targets of GUIDED, the place to keep, the way home."""

from __future__ import annotations

import math
from collections import deque
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
from agent.fcu.geodetic import Home, LocalProjection
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
from agent.fcu.vehicle_state import INFO, EventQueue, StateEstimate

NOT_STARTED, UNDER_WAY, COMPLETE = range(3)
POSITION, VELOCITY, COURSE, TURN = range(4)
_MOST_MPS = 100.0
_MOST_RADPS = 10.0
_MOST_REACHED = 64


class _NextItem(NamedTuple):
    """The item to go to (0 for none), the speed asked for on the way, and the jumps made so far by item."""

    current: int
    speed_mps: float | None
    jumps: dict[int, int]


class MissionProgress:
    """Guidance along one mission. `current` is the item under way, 0 when there is none.

    The first leg, and the leg after an interruption, starts where the vessel is; every other leg joins two waypoints.
    `home` is where RETURN_HOME goes; the mission's own item 0 when it is not set.
    """

    def __init__(self, mission: MissionSequence, default_speed_mps: float) -> None:
        self.mission = mission
        self.default_speed_mps = default_speed_mps
        self.home: Home | None = None
        self.restart()

    def restart(self) -> None:
        """Back to the first waypoint."""
        self.speed_mps: float | None = None  # what CHANGE_SPEED asked for
        self.output: GuidanceOutput | None = None
        self.reached = 0  # waypoints reached so far
        self._undrained: list[int] = []
        self._jumps: dict[int, int] = {}
        self.resume_from(1)

    def resume_from(self, seq: int) -> None:
        """Go to the first waypoint at or after `seq`."""
        self.state = NOT_STARTED
        self._advance_to(seq)
        self.start_leg()

    def start_leg(self) -> None:
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
        self._undrained.append(self.current)
        self._advance_to(self.current + 1)
        if self.current == 0:
            self.state = COMPLETE
            return None
        if line is None:
            self._leg, self._guidance = None, GuidanceState()
            return output
        self._leg = self._leg_from(frame, (line.end_north_m, line.end_east_m))
        self._guidance = carry_integral(self._guidance, self._leg.course_rad - line.course_rad)
        return output

    def drain_reached(self) -> list[int]:
        """Waypoints reached since the last call."""
        reached, self._undrained = self._undrained, []
        return reached

    def _advance_to(self, seq: int) -> None:
        self.current, self.speed_mps, self._jumps = self._next_item(seq)

    def _next_item(self, seq: int) -> _NextItem:
        """From `seq` to the next item to go to, by what stands between. Jumps in a ring end the mission."""
        items, speed_mps, jumps = self.mission.items, self.speed_mps, self._jumps
        for _ in range(2 * len(items)):
            if seq >= len(items):
                break
            item = items[seq]
            if item.command in LEGS:
                return _NextItem(seq, speed_mps, jumps)
            made = jumps.get(seq, 0)
            if item.command == CHANGE_SPEED:
                speed_mps = item.speed_mps
            if item.command == JUMP and (item.repeats == FOREVER or made < item.repeats):
                jumps = {**jumps, seq: made + 1}
                seq = item.jump_seq
            else:
                seq += 1
        return _NextItem(0, speed_mps, jumps)

    def _stays(self, seq: int) -> bool:
        item = self.mission.items[seq]
        return item.command in (LOITER_TIME, LOITER_UNLIMITED) or (item.command == WAYPOINT and item.hold_s > 0.0)

    def _leg_from(self, frame: LocalProjection, start_ne_m: tuple[float, float]) -> GuidanceLeg:
        end = self._local(frame, self.current, start_ne_m)
        after = 0 if self._stays(self.current) else self._next_item(self.current + 1).current
        return make_leg(start_ne_m, end, self._local(frame, after, end) if after else None)

    def _local(self, frame: LocalProjection, seq: int, here_ne_m: tuple[float, float]) -> tuple[float, float]:
        item = self.mission.items[seq]
        if item.command == RETURN_HOME:
            home = self.home or self.mission.items[0]
            return frame.to_local(home.lat_deg, home.lon_deg)
        if item.lat_deg == 0.0 and item.lon_deg == 0.0:  # loitering "here"
            return here_ne_m
        return frame.to_local(item.lat_deg, item.lon_deg)


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
        self.transit: PointTransit | None = None  # the way to a place, or to where the vessel has to stop
        self.course = CourseOverGround()
        self._stamp_ns = 0

    def set_target(self, target: GuidedTarget, now_ns: int) -> None:
        """A new target takes the place of the old one; the same place again changes nothing."""
        if target == self.target and target.kind == POSITION:
            return
        self.transit = PointTransit(target.lat_deg, target.lon_deg) if target.kind == POSITION else None
        if target.kind != VELOCITY:
            self.course = CourseOverGround()
        self.target = target
        self._stamp_ns = now_ns

    def clear(self) -> None:
        """No target."""
        self.target = None
        self.transit = None
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


class ModeInput(NamedTuple):
    """What a mode is given each cycle; `speed_mps` is over ground, negative astern."""

    now_ns: int
    dt_s: float
    estimate: StateEstimate
    frame: LocalProjection
    pos_ne_m: tuple[float, float]
    speed_mps: float
    sticks: Sticks


class Navigator:
    """What the modes keep from cycle to cycle.

    output: guidance of the mode in force, None when it has none. asked_mps: speed asked for while the mode lasts. home:
    where the vessel was armed, or first had a position, unless it was set. reached: waypoints nobody has drained yet.
    """

    def __init__(self, mission: MissionSequence, parameters: Parameters, events: EventQueue) -> None:
        self.progress = MissionProgress(mission, parameters["WP_SPEED"])
        self.guided = GuidedNavigation()
        self.station: StationKeeping | None = None
        self.way_home: PointTransit | None = None
        self.home: Home | None = None
        self.home_is_set = False
        self.output: GuidanceOutput | None = None
        self.asked_mps: float | None = None
        self.reached: deque[int] = deque(maxlen=_MOST_REACHED)
        self.events = events
        self.configure(parameters)

    def configure(self, p: Parameters) -> None:
        """Take changed parameters over."""
        self.gains = GuidanceGains.from_parameters(p)
        self.cruise_mps = p["WP_SPEED"]
        self.homeward_mps = p["RTL_SPEED"] or p["WP_SPEED"]
        # Drag, and with it thrust, grows with the square of the speed.
        self.speed_max_mps = p["SPEED_MAX"] or p["CRUISE_SPEED"] / math.sqrt(p["CRUISE_THROTTLE"] / 100.0)
        self.acro_radps = math.radians(p["ACRO_TURN_RATE"])
        self.turn_radius_m = p["TURN_RADIUS"]
        self.guided_timeout_ns = int(p["GUID_TIMEOUT"] * 1e9)
        self.progress.default_speed_mps = p["WP_SPEED"]

    @property
    def mission(self) -> MissionSequence:
        """The mission in force, whether or not it is under way."""
        return self.progress.mission

    def load_mission(self, mission: MissionSequence) -> None:
        """A new mission, from its start."""
        self.progress = MissionProgress(mission, self.cruise_mps)

    def follow_mission(self, now: ModeInput) -> GuidanceOutput | None:
        """One step along the mission, None once the last waypoint is reached; each waypoint reached is an event."""
        self.progress.home = self.home
        output = self.progress.steer(self.gains, now.frame, now.pos_ne_m, now.estimate.yaw_rad, now.speed_mps, now.dt_s)
        for seq in self.progress.drain_reached():
            self.reached.append(seq)
            self.events.add(INFO, f"Reached waypoint {seq}")
        return output

    def drain_reached(self) -> list[int]:
        """Sequence numbers of the waypoints reached since the last call."""
        reached = list(self.reached)
        self.reached.clear()
        return reached

    def set_home(self, home: Home) -> None:
        """Home from now on; a way home under way starts anew."""
        self.home = home
        self.way_home = None

    def set_home_here(self, frame: LocalProjection | None, estimate: StateEstimate) -> None:
        """Home is where the vessel is, as far as that is known."""
        if frame is not None:
            north_m, east_m, down_m = estimate.pos_ned_m
            self.set_home(Home(*frame.to_geodetic(north_m, east_m), frame.alt_m - down_m))

    # -- modes are entered

    def enter_auto(self) -> None:
        """The next leg starts where the vessel is."""
        self.progress.start_leg()

    def enter_loiter(self) -> None:
        """Stay where the vessel comes to rest next."""
        self.station = None

    def enter_rtl(self) -> None:
        """The way home starts where the vessel is."""
        self.way_home = None

    def enter_guided(self) -> None:
        """Stay where the vessel comes to rest, until a target comes."""
        self.guided.clear()

    def stopping_place(self, now: ModeInput) -> tuple[float, float]:
        """Latitude and longitude of where the vessel comes to rest at ATC_DECEL_MAX."""
        (vn, ve, _), (north_m, east_m) = now.estimate.vel_ned_mps, now.pos_ne_m
        slowing_s = 0.5 * math.hypot(vn, ve) / self.gains.deceleration_mps2
        return now.frame.to_geodetic(north_m + slowing_s * vn, east_m + slowing_s * ve)
