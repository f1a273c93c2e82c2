"""Modes, by ArduRover's numbers: each defines an order for the controller. A new mode is a function and a row of TABLE.

A mode's `steer` returns an Order for the controller, a Demand that bypasses it, or None when the mode has finished. It
is called while armed, and with a position when the mode needs one.
"""

from __future__ import annotations

import math
from typing import Callable, NamedTuple, Union

from agent.fcu.control.controller import STILL, Demand, Order
from agent.fcu.control.guidance import (
    CircleTransit,
    GuidanceOutput,
    PointTransit,
    StationKeeping,
    turned_about,
    wrap_angle,
)
from agent.fcu.vehicle.navigation import COURSE, POSITION, TURN, ModeInput, Navigator
from agent.fcu.vehicle_state import INFO, NOTICE, WARNING
from agent.mavlink.modes import (
    ACRO,
    AUTO,
    CIRCLE,
    GUIDED,
    HOLD,
    LOITER,
    MANUAL,
    ROVER_MODES,
    RTL,
    SIMPLE,
    SMART_RTL,
    STEERING,
)

__all__ = [
    "ACRO",
    "AUTO",
    "BY_NUMBER",
    "CIRCLE",
    "GUIDED",
    "HOLD",
    "LOITER",
    "MANUAL",
    "NAMES",
    "RTL",
    "SIMPLE",
    "SMART_RTL",
    "STEERING",
    "TABLE",
    "Mode",
]

_LEAST_LATERAL_MPS2 = 0.1
_LEAST_STEERING_MPS = 1.0
_STILL_MPS = 0.05

ModeOutput = Union[Order, Demand, None]


class Mode(NamedTuple):
    """One mode."""

    number: int
    name: str
    needs_position: bool
    steer: Callable[[Navigator, ModeInput], ModeOutput]
    enter: Callable[[Navigator], None] = lambda _: None
    """Prepares the mode, when it is chosen and when the vessel is armed in it."""
    steers_itself: bool = False
    """Whether it follows its own targets instead of the sticks."""
    has_speed: bool = False
    """Whether DO_CHANGE_SPEED applies."""


def _manual(navigator: Navigator, now: ModeInput) -> ModeOutput:
    return Demand(now.sticks.throttle, now.sticks.steering)


def _acro(navigator: Navigator, now: ModeInput) -> ModeOutput:
    """Turn rate and speed from the sticks. Without a velocity, the sticks are passed through as in MANUAL."""
    if not now.estimate.position_valid:
        return _manual(navigator, now)
    rate_radps = now.sticks.steering * navigator.acro_radps
    return Order(None, rate_radps, now.sticks.throttle * navigator.speed_max_mps)


def _steering(navigator: Navigator, now: ModeInput) -> ModeOutput:
    """Lateral acceleration from the steering stick, speed from the throttle.

    At zero throttle, the stick is a turn rate.
    """
    wanted_mps = now.sticks.throttle * navigator.speed_max_mps
    if wanted_mps == 0.0:
        return Order(None, now.sticks.steering * navigator.acro_radps, 0.0)
    speed_mps = abs(now.speed_mps)
    most_mps2 = navigator.gains.lateral_acceleration_mps2
    full_mps2 = min(max(speed_mps * speed_mps / navigator.gains.turn_radius_m, _LEAST_LATERAL_MPS2), most_mps2)
    rate_radps = now.sticks.steering * full_mps2 / max(speed_mps, _LEAST_STEERING_MPS)
    return Order(None, rate_radps if wanted_mps > 0.0 else -rate_radps, wanted_mps)


def _simple(navigator: Navigator, now: ModeInput) -> ModeOutput:
    """Direction of motion from the stick, relative to the heading at arming, or to north."""
    sticks = now.sticks
    part = min(math.hypot(sticks.throttle, sticks.steering), 1.0)
    if part > 0.0:
        zero_rad = navigator.simple_heading_rad if navigator.simple_is_relative else 0.0
        navigator.held_heading_rad = wrap_angle(zero_rad + math.atan2(sticks.steering, sticks.throttle))
    elif navigator.held_heading_rad is None:
        navigator.held_heading_rad = now.estimate.yaw_rad
    return Order(navigator.held_heading_rad, 0.0, part * navigator.speed_max_mps)


def _hold(navigator: Navigator, now: ModeInput) -> ModeOutput:
    return STILL


def _loiter(navigator: Navigator, now: ModeInput) -> ModeOutput:
    if navigator.station is None:
        navigator.station = StationKeeping(*navigator.stopping_place(now))
    return _toward(navigator, now, _kept(navigator, now, navigator.station))


def _circle(navigator: Navigator, now: ModeInput) -> ModeOutput:
    if navigator.circle is None:
        here = now.frame.to_geodetic(*now.pos_ne_m)
        asked_m, most_mps = navigator.circle_radius_m, navigator.circle_mps
        navigator.circle = circle = CircleTransit(navigator.gains, *here, asked_m, navigator.circles_clockwise)
        if circle.radius_m > asked_m:
            navigator.events.add(WARNING, f"Circle: radius increased to TURN_RADIUS ({circle.radius_m:.1f})")
        if circle.speed_mps < most_mps:
            navigator.events.add(WARNING, f"Circle: max speed is {circle.speed_mps:.1f}")
    most_mps = navigator.asked_mps or navigator.circle_mps
    output = navigator.circle.steer(now.guidance(navigator.gains, most_mps, navigator.astern))
    return _toward(navigator, now, turned_about(output) if navigator.astern else output)


def _auto(navigator: Navigator, now: ModeInput) -> ModeOutput:
    output = navigator.follow_mission(now)
    if navigator.progress.hands_over:
        return _guided(navigator, now)
    return None if output is None else _toward(navigator, now, output)


def _rtl(navigator: Navigator, now: ModeInput) -> ModeOutput:
    if navigator.home is None:
        return STILL
    if navigator.way_home is None:
        navigator.way_home = PointTransit(navigator.home.lat_deg, navigator.home.lon_deg)
    return _along(navigator, now, navigator.way_home, navigator.asked_mps or navigator.homeward_mps, "home")


def _smart_rtl(navigator: Navigator, now: ModeInput) -> ModeOutput:
    """Return along the path. The vessel stops until the path is simplified, and stays at its start."""
    if navigator.station is not None:
        return _toward(navigator, now, _kept(navigator, now, navigator.station))
    if not navigator.return_path.points:
        return STILL
    if navigator.return_progress is None:
        if not navigator.return_path.tidy():
            return Order(None, 0.0, 0.0)
        navigator.start_return(now.frame)
    output = navigator.follow_return(now)
    if output is None:
        navigator.events.add(INFO, "Reached destination")
        navigator.station = StationKeeping(*now.frame.to_geodetic(*navigator.return_path.points[0]))
        output = _kept(navigator, now, navigator.station)
    return _toward(navigator, now, output)


def _guided(navigator: Navigator, now: ModeInput) -> ModeOutput:
    """Follow a position, velocity, course or turn rate. Without a current target, stay at the present position."""
    guided = navigator.guided
    if guided.is_stale(now.now_ns, navigator.guided_timeout_ns):
        navigator.events.add(NOTICE, f"GUIDED: no target for {navigator.guided_timeout_ns * 1e-9:g} s, stopping")
        guided.clear()
    target = guided.target
    if target is None or target.kind == POSITION:
        if guided.transit is None:
            guided.transit = PointTransit(*navigator.stopping_place(now))
            guided.transit.arrived = True
        return _along(navigator, now, guided.transit, navigator.asked_mps or navigator.cruise_mps, "destination")
    if target.kind == TURN:
        return Order(None, target.turn_rate_radps, target.speed_mps)
    if target.kind == COURSE or target.heading_rad is not None:
        return _steered(navigator, now, target.heading_rad or 0.0, target.speed_mps)
    if target.speed_mps < _STILL_MPS:
        return Order(None, 0.0, 0.0)
    (vn, ve, _), course_rad = now.estimate.vel_ned_mps, math.atan2(target.east_mps, target.north_mps)
    heading_rad = guided.course.heading_rad(navigator.gains, course_rad, (vn, ve), now.dt_s)
    return _steered(navigator, now, heading_rad, target.speed_mps)


def _kept(navigator: Navigator, now: ModeInput, station: StationKeeping) -> GuidanceOutput:
    return station.steer(now.guidance(navigator.gains, navigator.cruise_mps))


def _along(navigator: Navigator, now: ModeInput, transit: PointTransit, most_mps: float, goal: str) -> ModeOutput:
    under_way = transit.under_way
    astern = navigator.astern and not transit.arrived
    output = transit.steer(now.guidance(navigator.gains, most_mps, astern))
    if under_way and transit.arrived:
        navigator.events.add(NOTICE, f"Reached {goal}")
    return _toward(navigator, now, turned_about(output) if astern else output)


def _toward(navigator: Navigator, now: ModeInput, output: GuidanceOutput) -> Order:
    navigator.output = output
    return Order(output.heading_rad, 0.0, output.speed_mps)


def _steered(navigator: Navigator, now: ModeInput, heading_rad: float, speed_mps: float) -> Order:
    navigator.output = GuidanceOutput(heading_rad, speed_mps, 0.0, 0.0, heading_rad, False)
    return Order(heading_rad, 0.0, speed_mps)


def _by_sticks(
    number: int,
    needs_position: bool,
    steer: Callable[[Navigator, ModeInput], ModeOutput],
    enter: Callable[[Navigator], None] = lambda _: None,
) -> Mode:
    return Mode(number, ROVER_MODES[number], needs_position, steer, enter)


def _by_itself(
    number: int,
    steer: Callable[[Navigator, ModeInput], ModeOutput],
    enter: Callable[[Navigator], None],
    has_speed: bool = True,
) -> Mode:
    return Mode(number, ROVER_MODES[number], True, steer, enter, True, has_speed)


TABLE: tuple[Mode, ...] = (
    _by_sticks(MANUAL, False, _manual),
    _by_sticks(ACRO, False, _acro),
    _by_sticks(STEERING, True, _steering),
    Mode(HOLD, ROVER_MODES[HOLD], False, _hold),
    _by_itself(LOITER, _loiter, Navigator.enter_loiter, has_speed=False),
    _by_sticks(SIMPLE, True, _simple, Navigator.enter_simple),
    _by_itself(CIRCLE, _circle, Navigator.enter_circle),
    _by_itself(AUTO, _auto, Navigator.enter_auto),
    _by_itself(RTL, _rtl, Navigator.enter_rtl),
    _by_itself(SMART_RTL, _smart_rtl, Navigator.enter_smart_rtl),
    _by_itself(GUIDED, _guided, Navigator.enter_guided),
)
BY_NUMBER = {mode.number: mode for mode in TABLE}
NAMES = {mode.number: mode.name for mode in TABLE}
