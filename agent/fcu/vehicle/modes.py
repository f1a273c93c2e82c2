"""Modes, by ArduRover's numbers: what each one asks of the controller. A new mode is a function and a row of TABLE.

A mode's `steer` answers with an Order for the controller, with a Demand that goes past it, or with None when it has
nothing left to do. It is called while armed, and with a position when the mode needs one.
"""

from __future__ import annotations

import math
from typing import Callable, NamedTuple, Union

from agent.fcu.control.controller import STILL, Demand, Order
from agent.fcu.control.guidance import GuidanceOutput, PointTransit, StationKeeping
from agent.fcu.vehicle.navigation import COURSE, POSITION, TURN, ModeInput, Navigator
from agent.fcu.vehicle_state import NOTICE
from agent.mavlink.modes import ACRO, AUTO, GUIDED, HOLD, LOITER, MANUAL, ROVER_MODES, RTL, STEERING

__all__ = [
    "ACRO",
    "AUTO",
    "BY_NUMBER",
    "GUIDED",
    "HOLD",
    "LOITER",
    "MANUAL",
    "NAMES",
    "RTL",
    "STEERING",
    "TABLE",
    "Mode",
]

_LEAST_LATERAL_MPS2 = 0.1
_LEAST_STEERING_MPS = 1.0
_STILL_MPS = 0.05

ModeOutput = Union[Order, Demand, None]


class Mode(NamedTuple):
    """One mode. `enter` prepares it, when it is chosen and when the vessel is armed in it."""

    number: int
    name: str
    needs_position: bool
    steer: Callable[[Navigator, ModeInput], ModeOutput]
    enter: Callable[[Navigator], None] = lambda _: None


def _manual(navigator: Navigator, now: ModeInput) -> ModeOutput:
    return Demand(now.sticks.throttle, now.sticks.steering)


def _acro(navigator: Navigator, now: ModeInput) -> ModeOutput:
    """Turn rate and speed from the sticks; without a velocity the sticks go through as in MANUAL."""
    if not now.estimate.position_valid:
        return _manual(navigator, now)
    rate_radps = now.sticks.steering * navigator.acro_radps
    return Order(None, rate_radps, now.sticks.throttle * navigator.speed_max_mps)


def _steering(navigator: Navigator, now: ModeInput) -> ModeOutput:
    """Lateral acceleration from the steering stick, speed from the throttle; on the spot the stick is a turn rate."""
    wanted_mps = now.sticks.throttle * navigator.speed_max_mps
    if wanted_mps == 0.0:
        return Order(None, now.sticks.steering * navigator.acro_radps, 0.0)
    speed_mps = abs(now.speed_mps)
    most_mps2 = navigator.gains.lateral_acceleration_mps2
    full_mps2 = min(max(speed_mps * speed_mps / navigator.turn_radius_m, _LEAST_LATERAL_MPS2), most_mps2)
    rate_radps = now.sticks.steering * full_mps2 / max(speed_mps, _LEAST_STEERING_MPS)
    return Order(None, rate_radps if wanted_mps > 0.0 else -rate_radps, wanted_mps)


def _hold(navigator: Navigator, now: ModeInput) -> ModeOutput:
    return STILL


def _loiter(navigator: Navigator, now: ModeInput) -> ModeOutput:
    if navigator.station is None:
        navigator.station = StationKeeping(*navigator.stopping_place(now))
    return _toward(navigator, now, _kept(navigator, now, navigator.station))


def _auto(navigator: Navigator, now: ModeInput) -> ModeOutput:
    output = navigator.follow_mission(now)
    return None if output is None else _toward(navigator, now, output)


def _rtl(navigator: Navigator, now: ModeInput) -> ModeOutput:
    if navigator.home is None:
        return STILL
    if navigator.way_home is None:
        navigator.way_home = PointTransit(navigator.home.lat_deg, navigator.home.lon_deg)
    return _along(navigator, now, navigator.way_home, navigator.asked_mps or navigator.homeward_mps, "home")


def _guided(navigator: Navigator, now: ModeInput) -> ModeOutput:
    """Place, velocity, course or turn rate; without a target, and when it was not repeated, stay here."""
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
    return station.steer(navigator.gains, now.frame, now.pos_ne_m, now.estimate.yaw_rad, navigator.cruise_mps)


def _along(navigator: Navigator, now: ModeInput, transit: PointTransit, most_mps: float, what: str) -> ModeOutput:
    under_way = transit.under_way
    output = transit.steer(
        navigator.gains, now.frame, now.pos_ne_m, now.estimate.yaw_rad, now.speed_mps, most_mps, now.dt_s
    )
    if under_way and transit.arrived:
        navigator.events.add(NOTICE, f"Reached {what}")
    return _toward(navigator, now, output)


def _toward(navigator: Navigator, now: ModeInput, output: GuidanceOutput) -> Order:
    navigator.output = output
    return Order(output.heading_rad, 0.0, output.speed_mps)


def _steered(navigator: Navigator, now: ModeInput, heading_rad: float, speed_mps: float) -> Order:
    navigator.output = GuidanceOutput(heading_rad, speed_mps, 0.0, 0.0, heading_rad, False)
    return Order(heading_rad, 0.0, speed_mps)


TABLE: tuple[Mode, ...] = (
    Mode(MANUAL, ROVER_MODES[MANUAL], False, _manual),
    Mode(ACRO, ROVER_MODES[ACRO], False, _acro),
    Mode(STEERING, ROVER_MODES[STEERING], True, _steering),
    Mode(HOLD, ROVER_MODES[HOLD], False, _hold),
    Mode(LOITER, ROVER_MODES[LOITER], True, _loiter, Navigator.enter_loiter),
    Mode(AUTO, ROVER_MODES[AUTO], True, _auto, Navigator.enter_auto),
    Mode(RTL, ROVER_MODES[RTL], True, _rtl, Navigator.enter_rtl),
    Mode(GUIDED, ROVER_MODES[GUIDED], True, _guided, Navigator.enter_guided),
)
BY_NUMBER = {mode.number: mode for mode in TABLE}
NAMES = {mode.number: mode.name for mode in TABLE}
