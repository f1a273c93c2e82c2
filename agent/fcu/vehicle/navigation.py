"""State of the modes: progress along the mission, targets of GUIDED, the position to keep, the return path."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

from agent.fcu.control.guidance import (
    CircleTransit,
    CourseOverGround,
    GuidanceGains,
    GuidanceInput,
    GuidanceOutput,
    PointTransit,
    StationKeeping,
    turned_about,
    wrap_angle,
)
from agent.fcu.control.manual_control import Sticks
from agent.fcu.mission import MissionSequence, make_mission, waypoint
from agent.fcu.parameters import Parameters
from agent.fcu.vehicle.mission_progress import MissionProgress, Perform, UtcClock, no_date, passed_over
from agent.fcu.vehicle.return_path import ReturnPath
from agent.fcu.vehicle_state import EventQueue
from agent.navigation.geodetic import Home, LocalProjection
from agent.navigation.measurements import StateEstimate

POSITION, VELOCITY, COURSE, TURN = range(4)
_MOST_MPS = 100.0
_MOST_RADPS = 10.0
_MOST_REACHED = 64


class GuidedTarget(NamedTuple):
    """A target. Each kind uses some of the fields. Speeds are over ground, negative astern.

    POSITION: a position. VELOCITY: over ground, with `heading_rad` if a heading was also commanded. COURSE:
    `heading_rad` and `speed_mps`. TURN: `turn_rate_radps` and `speed_mps`.
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
    """Present target, None for none. Without one, the vessel stays at its position."""

    def __init__(self) -> None:
        self.target: GuidedTarget | None = None
        self.transit: PointTransit | None = None  # the path to a position, or to the stopping point
        self.course = CourseOverGround()
        self._stamp_ns = 0

    def set_target(self, target: GuidedTarget, now_ns: int) -> None:
        """Replace the target. The same position again changes nothing."""
        if target == self.target and target.kind == POSITION:
            return
        self.transit = PointTransit(target.lat_deg, target.lon_deg) if target.kind == POSITION else None
        if target.kind != VELOCITY:
            self.course = CourseOverGround()
        self.target = target
        self._stamp_ns = now_ns

    def clear(self) -> None:
        """Remove the target."""
        self.target = None
        self.transit = None
        self.course = CourseOverGround()

    def is_stale(self, now_ns: int, timeout_ns: int) -> bool:
        """Whether a target that must be repeated was not."""
        target = self.target
        return target is not None and target.kind != POSITION and not 0 <= now_ns - self._stamp_ns <= timeout_ns


def velocity_target(
    north_mps: float, east_mps: float, yaw_rad: float | None, yaw_rate_radps: float | None
) -> GuidedTarget | str:
    """Return the target of a velocity with a heading or a turn rate, or the reason of a refusal."""
    speed_mps = math.hypot(north_mps, east_mps)
    if not speed_mps <= _MOST_MPS:
        return f"velocity {north_mps:g}, {east_mps:g} m/s; use at most {_MOST_MPS:g}"
    if yaw_rad is not None:
        if not math.isfinite(yaw_rad):
            return f"heading {yaw_rad:g} is not valid; use radians"
        along_mps = north_mps * math.cos(yaw_rad) + east_mps * math.sin(yaw_rad)
        return GuidedTarget(
            VELOCITY, north_mps=north_mps, east_mps=east_mps, heading_rad=wrap_angle(yaw_rad), speed_mps=along_mps
        )
    if yaw_rate_radps is not None:
        return turn_target(yaw_rate_radps, speed_mps)
    return GuidedTarget(VELOCITY, north_mps=north_mps, east_mps=east_mps, speed_mps=speed_mps)


def course_target(heading_rad: float, speed_mps: float) -> GuidedTarget | str:
    """Return the target of a heading and a speed, or the reason of a refusal."""
    if not (math.isfinite(heading_rad) and abs(speed_mps) <= _MOST_MPS):
        return f"heading {heading_rad:g} rad, speed {speed_mps:g} m/s; use numbers, and at most {_MOST_MPS:g} m/s"
    return GuidedTarget(COURSE, heading_rad=wrap_angle(heading_rad), speed_mps=speed_mps)


def turn_target(turn_rate_radps: float, speed_mps: float) -> GuidedTarget | str:
    """Return the target of a turn rate and a speed, or the reason of a refusal."""
    if not (abs(turn_rate_radps) <= _MOST_RADPS and abs(speed_mps) <= _MOST_MPS):
        return (
            f"turn rate {turn_rate_radps:g} rad/s, speed {speed_mps:g} m/s; use at most {_MOST_RADPS:g}, {_MOST_MPS:g}"
        )
    return GuidedTarget(TURN, turn_rate_radps=turn_rate_radps, speed_mps=speed_mps)


class ModeInput(NamedTuple):
    """Input of a mode in each cycle."""

    now_ns: int
    dt_s: float
    estimate: StateEstimate
    frame: LocalProjection
    pos_ne_m: tuple[float, float]
    speed_mps: float
    """Over ground, negative astern."""
    sticks: Sticks

    def facing(self, astern: bool) -> tuple[float, float]:
        """Heading and speed of the bow, or of the stern."""
        if astern:
            return wrap_angle(self.estimate.yaw_rad + math.pi), -self.speed_mps
        return self.estimate.yaw_rad, self.speed_mps

    def guidance(self, gains: GuidanceGains, wanted_mps: float, astern: bool = False) -> GuidanceInput:
        """Input of the guidance, bow or stern first."""
        return GuidanceInput(gains, self.frame, self.pos_ne_m, *self.facing(astern), wanted_mps, self.dt_s)


class Navigator:
    """State that the modes keep between cycles.

    perform: executes the mission items that are not stages.
    utc_s: UTC for delays until a time of day.
    pivots: whether the vessel can turn on the spot.
    """

    def __init__(
        self,
        mission: MissionSequence,
        parameters: Parameters,
        events: EventQueue,
        perform: Perform = passed_over,
        utc_s: UtcClock = no_date,
        pivots: bool = True,
    ) -> None:
        self.guided = GuidedNavigation()
        self.station: StationKeeping | None = None
        self.way_home: PointTransit | None = None
        self.return_path = ReturnPath(parameters, events)
        self.return_progress: MissionProgress | None = None
        self.circle: CircleTransit | None = None
        self.home: Home | None = None
        """Position of arming or of the first fix, unless it was set."""
        self.home_is_set = False
        self.simple_heading_rad = 0.0
        """Reference of the headings in SIMPLE."""
        self.held_heading_rad: float | None = None
        self.output: GuidanceOutput | None = None
        """Guidance of the present mode, None without guidance."""
        self.asked_mps: float | None = None
        """Commanded speed while the mode lasts."""
        self.astern = False
        """Whether legs and circles are followed stern first."""
        self.reached: deque[int] = deque(maxlen=_MOST_REACHED)
        """Waypoints that were not drained yet."""
        self.events = events
        self._perform = perform
        self._utc_s = utc_s
        self.cruise_mps = parameters["WP_SPEED"]
        self.load_mission(mission)
        self.configure(parameters, pivots)

    def configure(self, p: Parameters, pivots: bool) -> None:
        """Apply changed parameters."""
        self.gains = GuidanceGains.from_parameters(p, pivots)
        self.cruise_mps = p["WP_SPEED"]
        self.homeward_mps = p["RTL_SPEED"] or p["WP_SPEED"]
        # Drag, and therefore thrust, grows with the square of the speed.
        self.speed_max_mps = p["SPEED_MAX"] or p["CRUISE_SPEED"] / math.sqrt(p["CRUISE_THROTTLE"] / 100.0)
        self.acro_radps = math.radians(p["ACRO_TURN_RATE"])
        self.circle_radius_m = p["CIRC_RADIUS"]
        self.circle_mps = p["CIRC_SPEED"] or p["WP_SPEED"]
        self.circles_clockwise = p["CIRC_DIR"] == 0.0
        self.simple_is_relative = p["SIMPLE_TYPE"] == 0.0
        self.guided_timeout_ns = int(p["GUID_TIMEOUT"] * 1e9)
        self.progress.default_speed_mps = p["WP_SPEED"]
        self.return_path.configure(p)

    # -- the mission

    @property
    def mission(self) -> MissionSequence:
        """Present mission, whether or not it is under way."""
        return self.progress.mission

    def load_mission(self, mission: MissionSequence) -> None:
        """Load a new mission, from its start."""
        self.progress = MissionProgress(mission, self.cruise_mps, self.events.add, self._perform, self._utc_s)

    def follow_mission(self, now: ModeInput) -> GuidanceOutput | None:
        """Run one step along the mission. Return None after its last stage."""
        self.progress.home = self.home
        output = self._sail(self.progress, now)
        self.reached.extend(self.progress.drain_reached())
        return output

    def drain_reached(self) -> list[int]:
        """Return the sequence numbers of the waypoints reached since the last call."""
        reached = list(self.reached)
        self.reached.clear()
        return reached

    def _sail(self, progress: MissionProgress, now: ModeInput) -> GuidanceOutput | None:
        astern = self.astern and progress.sails
        output = progress.steer(now.guidance(self.gains, progress.default_speed_mps, astern))
        return turned_about(output) if astern and output is not None else output

    # -- return path

    def start_return(self, frame: LocalProjection) -> None:
        """Start to return along the path, which is consumed on the way."""
        places = [waypoint(*frame.to_geodetic(*point)) for point in reversed(self.return_path.points)]
        self.return_progress = MissionProgress(make_mission([places[-1], *places]), self.homeward_mps)

    def follow_return(self, now: ModeInput) -> GuidanceOutput | None:
        """Run one step of the return. Return None at the start of the path."""
        progress = self.return_progress
        if progress is None:
            return None
        progress.speed_mps = self.asked_mps
        output = self._sail(progress, now)
        for _ in progress.drain_reached():
            if len(self.return_path.points) > 1:
                self.return_path.points.pop()
        return output

    # -- home

    def set_home(self, home: Home) -> None:
        """Set home. An active return to home restarts."""
        self.home = home
        self.way_home = None

    def set_home_here(self, frame: LocalProjection | None, estimate: StateEstimate) -> None:
        """Set home to the vessel's position, if it is known."""
        if frame is not None:
            north_m, east_m, down_m = estimate.pos_ned_m
            self.set_home(Home(*frame.to_geodetic(north_m, east_m), frame.alt_m - down_m))

    # -- entry of modes

    def enter_auto(self) -> None:
        """Start the next leg at the vessel's position."""
        self.progress.start_leg()

    def enter_loiter(self) -> None:
        """Stay at the next stopping point."""
        self.station = None

    def enter_circle(self) -> None:
        """Circle the vessel's next position."""
        self.circle = None

    def enter_simple(self) -> None:
        """With centred sticks, hold the vessel's next heading."""
        self.held_heading_rad = None

    def enter_rtl(self) -> None:
        """Start the path home at the vessel's position."""
        self.way_home = None

    def enter_smart_rtl(self) -> None:
        """Stop until the path is simplified, then return along it."""
        self.return_progress = None
        self.station = None
        self.return_path.leave()

    def enter_guided(self) -> None:
        """Stay at the next stopping point, until a target arrives."""
        self.guided.clear()

    def stopping_place(self, now: ModeInput) -> tuple[float, float]:
        """Latitude and longitude of the stopping point at ATC_DECEL_MAX."""
        (vn, ve, _), (north_m, east_m) = now.estimate.vel_ned_mps, now.pos_ne_m
        slowing_s = 0.5 * math.hypot(vn, ve) / self.gains.deceleration_mps2
        return now.frame.to_geodetic(north_m + slowing_s * vn, east_m + slowing_s * ve)
