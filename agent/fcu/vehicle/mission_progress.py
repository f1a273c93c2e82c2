"""Progress along a mission: its stages in order, and on the way to each stage the items before it.

    steer(now)
        follow jumps, store the passed items       _advance_to
        execute the next passed item               _do_passed: CONDITIONS wait, _OWN, then `perform`
        the current stage steers                   STAGE_BEGINNINGS by its command

As in ArduPilot, the items before a stage are executed while the stage is under way, one item per cycle. A condition
delays the items after it. Items that are still delayed when the stage ends are skipped.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Callable, NamedTuple, Optional, Protocol

from agent.fcu.control.guidance import (
    CircleTransit,
    GuidanceInput,
    GuidanceLeg,
    GuidanceOutput,
    GuidanceState,
    StationKeeping,
    carry_integral,
    follow_leg,
    make_leg,
    wrap_angle,
)
from agent.fcu.mission import (
    CHANGE_SPEED,
    COMMANDS,
    CONDITION_DELAY,
    CONDITION_DISTANCE,
    DELAY,
    DO_JUMP_TAG,
    FOREVER,
    GUIDED_ENABLE,
    GUIDED_LIMITS,
    JUMP,
    JUMP_TAG,
    LOITER_TIME,
    LOITER_TURNS,
    LOITER_UNLIMITED,
    PASSAGES,
    RETURN_HOME,
    SET_YAW_SPEED,
    STAGES,
    WAYPOINT,
    MissionItem,
    MissionSequence,
)
from agent.fcu.vehicle_state import INFO, NOTICE, WARNING
from agent.navigation.geodetic import Home, LocalProjection

NOT_STARTED, UNDER_WAY, COMPLETE = range(3)
LEAST_SPEED_MPS = 0.05  # least speed that a mission can set: -1, -2 and 0 keep the present speed
_MOST_PASSED = 255
_MOST_RADIUS_M = 2550.0
_AT_HEADING_RAD = math.radians(5.0)
_DAY_S = 86_400.0

Say = Callable[[int, str], None]
Perform = Callable[[MissionItem], str]
UtcClock = Callable[[], Optional[float]]


class Stage(Protocol):
    """An item that is executed until it is `done`. ending: event at its end."""

    done: bool
    ending: tuple[int, str] | None

    def steer(self, now: GuidanceInput) -> GuidanceOutput:
        """Run one step."""


class PlaceStage:
    """Go to a position along a line, and stay there for `stay_s`.

    after: target of the next line, so that the corner is taken at speed; None to arrive slowly.
    before: this line starts at the end of this stage; None to start at the vessel's position.
    """

    def __init__(
        self,
        place: tuple[float, float],
        after: tuple[float, float] | None,
        stay_s: float,
        before: PlaceStage | None,
        say: Callable[[str], None],
    ) -> None:
        self.done = False
        self.ending: tuple[int, str] | None = None
        self._place = place
        self._after = after
        self._stay_s = stay_s
        self._before = before
        self._say = say
        self._line: GuidanceLeg | None = None
        self._frame: LocalProjection | None = None
        self._guidance = GuidanceState()
        self._station: StationKeeping | None = None
        self._stayed_s = 0.0

    def steer(self, now: GuidanceInput) -> GuidanceOutput:
        if self._station is not None:
            self._stayed_s += now.dt_s
            self.done = self._stayed_s >= self._stay_s
            return self._station.steer(now)
        if self._line is None or now.frame is not self._frame:
            self._line = self._draw_line(now)
        self._guidance, output = follow_leg(
            now.gains, self._guidance, self._line, now.pos_ne_m, now.yaw_rad, now.speed_mps, now.wanted_mps, now.dt_s
        )
        if output.reached:
            finite = 0.0 < self._stay_s < math.inf
            self._say(f". Loiter for {self._stay_s:g} seconds" if finite else "")
            self.done = self._stay_s == 0.0
            self._station = None if self.done else StationKeeping(*self._place)
        return output

    @property
    def stays(self) -> bool:
        """Whether the next line starts at the vessel's position then."""
        return self._stay_s > 0.0

    def _draw_line(self, now: GuidanceInput) -> GuidanceLeg:
        """Return the line from the end of the previous one, or from the vessel's position."""
        end = now.frame.to_local(*self._place)
        after = None if self._after is None else now.frame.to_local(*self._after)
        before = self._before if self._frame is None else None
        self._frame, self._before = now.frame, None
        if before is None or before._line is None:
            return make_leg(now.pos_ne_m, end, after)
        line = make_leg((before._line.end_north_m, before._line.end_east_m), end, after)
        self._guidance = carry_integral(before._guidance, line.course_rad - before._line.course_rad)
        return line


class CircleStage:
    """Circle a position a number of times."""

    def __init__(self, circle: CircleTransit, turns: float) -> None:
        self.done = turns <= 0.0
        self.ending: tuple[int, str] | None = None
        self._circle = circle
        self._turns = turns

    def steer(self, now: GuidanceInput) -> GuidanceOutput:
        output = self._circle.steer(now)
        self.done = self._circle.turned_rad >= 2.0 * math.pi * self._turns
        return output


class DelayStage:
    """Stay at the position where the vessel stops."""

    def __init__(self, now: GuidanceInput, delay_s: float) -> None:
        self.done = False
        self.ending: tuple[int, str] | None = None
        stop_m = 0.5 * now.speed_mps * now.speed_mps / now.gains.deceleration_mps2
        north_m, east_m = now.pos_ne_m
        self._station = StationKeeping(
            *now.frame.to_geodetic(north_m + stop_m * math.cos(now.yaw_rad), east_m + stop_m * math.sin(now.yaw_rad))
        )
        self._left_s = delay_s

    def steer(self, now: GuidanceInput) -> GuidanceOutput:
        self._left_s -= now.dt_s
        self.done = self._left_s <= 0.0
        return self._station.steer(now)


class HeadingStage:
    """Turn to a heading at a speed, negative astern."""

    def __init__(self, heading_rad: float, speed_mps: float) -> None:
        self.done = False
        self.ending: tuple[int, str] | None = None
        self._output = GuidanceOutput(heading_rad, speed_mps, 0.0, 0.0, heading_rad, False)

    def steer(self, now: GuidanceInput) -> GuidanceOutput:
        self.done = abs(wrap_angle(self._output.heading_rad - now.yaw_rad)) < _AT_HEADING_RAD
        return self._output


class GuidedStage:
    """Follow external targets, as in GUIDED.

    The stage ends near `place`, or when a limit of DO_GUIDED_LIMITS is exceeded.
    """

    def __init__(self, now: GuidanceInput, place: tuple[float, float] | None, most_s: float, most_m: float) -> None:
        self.done = False
        self.ending: tuple[int, str] | None = None
        self._start = now.here
        self._place = place
        self._most_s, self._most_m = most_s, most_m
        self._lasted_s = 0.0

    def steer(self, now: GuidanceInput) -> GuidanceOutput:
        self._lasted_s += now.dt_s
        near = self._place is not None and self._distance_m(now, self._place) <= now.gains.radius_m
        too_long = 0.0 < self._most_s <= self._lasted_s
        too_far = 0.0 < self._most_m < self._distance_m(now, self._start)
        self.done = near or too_long or too_far
        return GuidanceOutput(now.yaw_rad, 0.0, 0.0, 0.0, now.yaw_rad, False)

    def _distance_m(self, now: GuidanceInput, place: tuple[float, float]) -> float:
        north_m, east_m = now.frame.to_local(*place)
        return math.hypot(north_m - now.pos_ne_m[0], east_m - now.pos_ne_m[1])


class _NextItem(NamedTuple):
    """The next stage (0 for none), the items before it, the jumps made so far by item, and the texts to report."""

    current: int
    passed: tuple[int, ...]
    jumps: dict[int, int]
    texts: tuple[str, ...]


def no_date() -> float | None:
    """Clock without a date."""
    return None


def passed_over(item: MissionItem) -> str:
    """Return the text that reports a skipped item."""
    command = COMMANDS[item.command]
    if command.device:
        return f"Skipping cmd #{item.command} {command.name}: no {command.device}"
    return f"Skipping invalid cmd #{item.command}"  # ArduRover's text for an item that a boat cannot execute


class MissionProgress:
    """Guidance along one mission. `current` is the stage under way, 0 when there is none.

    The first leg, and the leg after an interruption, starts at the vessel's position. Every other leg joins two
    waypoints.

    say: reports progress.
    perform: executes an item that is not a stage, and returns a text if it is skipped.
    utc_s: time for a DELAY until a time of day, None without a date.
    """

    def __init__(
        self,
        mission: MissionSequence,
        default_speed_mps: float,
        say: Say = lambda severity, text: None,
        perform: Perform = passed_over,
        utc_s: UtcClock = no_date,
    ) -> None:
        self.mission = mission
        self.default_speed_mps = default_speed_mps
        self.home: Home | None = None
        """Target of RETURN_HOME, None for the mission's own item 0."""
        self._say = say
        self._perform = perform
        self._utc_s = utc_s
        self.restart()

    def restart(self) -> None:
        """Restart at the first stage."""
        self.speed_mps: float | None = None  # set by CHANGE_SPEED
        self.output: GuidanceOutput | None = None
        self.reached = 0  # number of completed stages
        self.guided_limits = (0.0, 0.0)  # seconds and metres, 0 for no limit
        self._undrained: list[int] = []
        self._passed: tuple[int, ...] = ()
        self._jumps: dict[int, int] = {}
        self._jumps_made: tuple[str, ...] = ()
        self.resume_from(1)

    def resume_from(self, seq: int) -> None:
        """Continue from `seq`: with the items before the next stage, and that stage."""
        self.state = NOT_STARTED
        self._advance_to(seq)
        self.start_leg()

    def start_leg(self) -> None:
        """Start the next leg at the vessel's position, and restart the stage. A completed mission restarts."""
        self._stage: Stage | None = None
        self._before: PlaceStage | None = None
        self._waited_s: float | None = None
        if self.state == COMPLETE:
            self.restart()

    @property
    def hands_over(self) -> bool:
        """Whether the stage under way follows targets as in GUIDED."""
        return self.state == UNDER_WAY and isinstance(self._stage, GuidedStage)

    @property
    def sails(self) -> bool:
        """Whether the stage follows a line or a circle, so that stern first is possible."""
        return self.current > 0 and self.mission.items[self.current].command in PASSAGES

    def steer(self, now: GuidanceInput) -> GuidanceOutput | None:
        """Return the guidance along the mission at the mission's speed, None after the last stage."""
        self._do_passed(now.dt_s)
        if self.current == 0:
            self._finish()
            return None
        self.state = UNDER_WAY
        item = self.mission.items[self.current]
        wanted_mps = self.default_speed_mps if self.speed_mps is None else self.speed_mps
        if now.wanted_mps != wanted_mps:
            now = now._replace(wanted_mps=wanted_mps)
        if self._stage is None:
            self._say(INFO, f"Mission: {self.current} {item.name}")
            self._stage = STAGE_BEGINNINGS[item.command](self, item, now)
        stage = self._stage
        self.output = output = stage.steer(now)
        if stage.done:
            if stage.ending is not None:
                self._say(*stage.ending)
            self.reached += 1
            self._undrained.append(self.current)
            self._leave_out_passed()
            self._stage = None
            self._before = stage if isinstance(stage, PlaceStage) and not stage.stays else None
            self._advance_to(self.current + 1)
            if self.current == 0:
                self._do_passed(0.0)
                self._finish()
        return None if self.state == COMPLETE else output

    def drain_reached(self) -> list[int]:
        """Return the stages completed since the last call."""
        reached, self._undrained = self._undrained, []
        return reached

    # -- transitions between stages

    def _finish(self) -> None:
        self._leave_out_passed()
        self.state = COMPLETE

    def _advance_to(self, seq: int) -> None:
        self.current, self._passed, self._jumps, self._jumps_made = self._next_item(seq)
        self._waited_s = None

    def _next_item(self, seq: int) -> _NextItem:
        """Find the next stage from `seq` on, with the items before it. An endless or invalid jump ends the mission."""
        items, jumps = self.mission.items, self._jumps
        passed: list[int] = []
        texts: list[str] = []
        for _ in range(_MOST_PASSED + len(items)):
            if not 0 < seq < len(items):
                break
            item = items[seq]
            if item.command in STAGES:
                return _NextItem(seq, tuple(passed), jumps, tuple(texts))
            if item.command not in (JUMP, DO_JUMP_TAG):
                passed.append(seq)
                seq += 1
                continue
            made, times = jumps.get(seq, 0), int(item.parameters[1])
            target = int(item.parameters[0])
            if item.command == DO_JUMP_TAG:
                target = self.mission.tagged(target)
            if not 0 < target < len(items):
                texts.append(f"Mission: {seq} {item.name} to {int(item.parameters[0])}: no such item, mission ends")
                return _NextItem(0, tuple(passed), jumps, tuple(texts))
            if times == FOREVER or made < times:
                jumps = {**jumps, seq: made + 1}
                texts.append(f"Mission: {seq} Jump {made + 1}/{'unlimited' if times == FOREVER else times}")
                seq = target
            else:
                jumps = {**jumps, seq: 0}  # the next pass counts from zero
                seq += 1
        else:
            passed.clear()
        return _NextItem(0, tuple(passed), jumps, tuple(texts))

    # -- items before a stage

    def _do_passed(self, dt_s: float) -> None:
        """Report the jumps and execute one item, or all items when no stage follows."""
        for text in self._jumps_made:
            self._say(INFO, text)
        self._jumps_made = ()
        while self._passed:
            seq = self._passed[0]
            item = self.mission.items[seq]
            is_met = CONDITIONS.get(item.command)
            if self._waited_s is None:
                self._waited_s = 0.0
                shown = f" {int(item.parameters[0])}" if item.command == JUMP_TAG else ""
                self._say(INFO, f"Mission: {seq} {item.name}{shown}")
            else:
                self._waited_s += dt_s
            if is_met is not None and not is_met(self, item):
                return
            self._passed = self._passed[1:]
            self._waited_s = None
            if item.command in _OWN:
                _OWN[item.command](self, item)
            elif is_met is None:
                skipped = self._perform(item)
                if skipped:
                    self._say(NOTICE, skipped)
            if self.current > 0:
                return

    def _leave_out_passed(self) -> None:
        """Report the items that still waited for a condition when the stage ended."""
        for seq in self._passed:
            item = self.mission.items[seq]
            if item.command not in CONDITIONS:
                self._say(NOTICE, f"Skipping cmd #{item.command} {item.name}: condition not met")
        self._passed = ()

    def _waited_long_enough(self, item: MissionItem) -> bool:
        return self._waited_s is not None and self._waited_s >= item.parameters[0]

    def _is_near_enough(self, item: MissionItem) -> bool:
        return self._stage is not None and self.output is not None and self.output.distance_m < item.parameters[0]

    def _change_speed(self, item: MissionItem) -> None:
        speed_mps = item.parameters[1]
        if speed_mps >= LEAST_SPEED_MPS:
            self.speed_mps = speed_mps
            self._say(INFO, f"speed: {speed_mps:.1f} m/s")

    def _limit_guided(self, item: MissionItem) -> None:
        self.guided_limits = (item.parameters[0], item.parameters[3])

    # -- start of a stage

    def _begin_place(self, item: MissionItem, now: GuidanceInput) -> Stage:
        seq = self.current
        place = self._place_of(seq) or now.here
        after: tuple[float, float] | None = None
        if item.stay_s == 0.0:
            following = self._next_item(seq + 1).current
            after = self._place_of(following) if following else None
        before, self._before = self._before, None
        stage = PlaceStage(
            place, after, item.stay_s, before, lambda more: self._say(INFO, f"Reached waypoint #{seq}{more}")
        )
        if item.command == LOITER_TIME:
            stage.ending = (WARNING, "Finished active loiter")
        return stage

    def _place_of(self, seq: int) -> tuple[float, float] | None:
        """Target position of a stage, None without one."""
        item = self.mission.items[seq]
        if item.command == RETURN_HOME:
            home = self.home or self.mission.items[0]
            return home.lat_deg, home.lon_deg
        return item.place if item.command in PASSAGES and item.command != LOITER_TURNS else None

    def _begin_circle(self, item: MissionItem, now: GuidanceInput) -> Stage:
        turns, _, radius_m, _ = item.parameters
        lat_deg, lon_deg = item.place or now.here
        circle = CircleTransit(now.gains, lat_deg, lon_deg, min(abs(radius_m), _MOST_RADIUS_M), radius_m >= 0.0)
        if circle.radius_m > abs(radius_m):
            self._say(WARNING, f"Circle: radius increased to TURN_RADIUS ({circle.radius_m:.1f})")
        if circle.speed_mps < now.wanted_mps:
            self._say(WARNING, f"Circle: max speed is {circle.speed_mps:.1f}")
        return CircleStage(circle, turns)

    def _begin_delay(self, item: MissionItem, now: GuidanceInput) -> Stage:
        seconds = item.parameters[0]
        delay_s = seconds if seconds > 0.0 else until_time_of_day_s(item.parameters[1:], self._utc_s())
        self._say(INFO, f"Delaying {int(delay_s)} sec")
        return DelayStage(now, delay_s)

    def _begin_heading(self, item: MissionItem, now: GuidanceInput) -> Stage:
        angle_deg, speed_mps, relative, _ = item.parameters
        heading_rad = wrap_angle(math.radians(angle_deg) + (now.yaw_rad if relative > 0.0 else 0.0))
        most_mps = self.default_speed_mps
        return HeadingStage(heading_rad, min(max(speed_mps, -most_mps), most_mps))

    def _begin_guided(self, item: MissionItem, now: GuidanceInput) -> Stage:
        is_on = item.parameters[0] > 0.0
        return GuidedStage(now, item.place, *self.guided_limits) if is_on else DelayStage(now, 0.0)


def until_time_of_day_s(clock: tuple[float, ...], utc_s: float | None) -> float:
    """Seconds until the next UTC time of this hour, minute and second. -1 means any, as in ArduPilot.

    0 without a date.
    """
    if utc_s is None or all(part == -1.0 for part in clock):
        return 0.0
    hour, minute, second = (int(part) for part in clock)
    period_s = _DAY_S if hour != -1 else 3600.0 if minute != -1 else 60.0
    at_s = sum(max(part, 0) * unit for part, unit in ((hour, 3600), (minute, 60), (second, 1)))
    return (at_s - utc_s) % period_s


STAGE_BEGINNINGS: Mapping[int, Callable[[MissionProgress, MissionItem, GuidanceInput], Stage]] = {
    WAYPOINT: MissionProgress._begin_place,
    LOITER_UNLIMITED: MissionProgress._begin_place,
    LOITER_TIME: MissionProgress._begin_place,
    RETURN_HOME: MissionProgress._begin_place,
    LOITER_TURNS: MissionProgress._begin_circle,
    DELAY: MissionProgress._begin_delay,
    SET_YAW_SPEED: MissionProgress._begin_heading,
    GUIDED_ENABLE: MissionProgress._begin_guided,
}
CONDITIONS: Mapping[int, Callable[[MissionProgress, MissionItem], bool]] = {
    CONDITION_DELAY: MissionProgress._waited_long_enough,
    CONDITION_DISTANCE: MissionProgress._is_near_enough,
}
_OWN: Mapping[int, Callable[[MissionProgress, MissionItem], None]] = {
    CHANGE_SPEED: MissionProgress._change_speed,
    GUIDED_LIMITS: MissionProgress._limit_guided,
    JUMP_TAG: lambda progress, item: None,
}
