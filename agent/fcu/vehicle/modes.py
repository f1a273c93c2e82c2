"""Modes, by ArduRover's numbers: what each one asks of the controller. A new mode is a function and a row of TABLE.

A mode's `steer` answers with an Order for the controller, with a Demand that goes past it, or with None when it has
nothing left to do. It is called while armed, and with a position when the mode needs one.
"""

from __future__ import annotations

import math
from typing import Callable, NamedTuple, Union

from agent.fcu.control.controller import STILL, Demand, Order
from agent.fcu.control.guidance import GuidanceOutput, PointTransit, StationKeeping
from agent.fcu.vehicle.navigation import COURSE, POSITION, TURN, ModeInput, Navigation
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
    steer: Callable[[Navigation, ModeInput], ModeOutput]
    enter: Callable[[Navigation], None] = lambda _: None


def _manual(navigation: Navigation, now: ModeInput) -> ModeOutput:
    return Demand(now.sticks.throttle, now.sticks.steering)


def _acro(navigation: Navigation, now: ModeInput) -> ModeOutput:
    """Turn rate and speed from the sticks; without a velocity the sticks go through as in MANUAL."""
    if not now.estimate.position_valid:
        return _manual(navigation, now)
    rate_radps = now.sticks.steering * navigation.acro_radps
    return Order(None, rate_radps, now.sticks.throttle * navigation.speed_max_mps)


def _steering(navigation: Navigation, now: ModeInput) -> ModeOutput:
    """Lateral acceleration from the steering stick, speed from the throttle; on the spot the stick is a turn rate."""
    wanted_mps = now.sticks.throttle * navigation.speed_max_mps
    if wanted_mps == 0.0:
        return Order(None, now.sticks.steering * navigation.acro_radps, 0.0)
    speed_mps = abs(now.speed_mps)
    most_mps2 = navigation.gains.lateral_acceleration_mps2
    full_mps2 = min(max(speed_mps * speed_mps / navigation.turn_radius_m, _LEAST_LATERAL_MPS2), most_mps2)
    rate_radps = now.sticks.steering * full_mps2 / max(speed_mps, _LEAST_STEERING_MPS)
    return Order(None, rate_radps if wanted_mps > 0.0 else -rate_radps, wanted_mps)


def _hold(navigation: Navigation, now: ModeInput) -> ModeOutput:
    return STILL


def _loiter(navigation: Navigation, now: ModeInput) -> ModeOutput:
    if navigation.station is None:
        navigation.station = StationKeeping(*navigation.stopping_place(now))
    return _toward(navigation, now, _kept(navigation, now, navigation.station))


def _auto(navigation: Navigation, now: ModeInput) -> ModeOutput:
    output = navigation.follow_mission(now)
    return None if output is None else _toward(navigation, now, output)


def _rtl(navigation: Navigation, now: ModeInput) -> ModeOutput:
    if navigation.home is None:
        return STILL
    if navigation.way_home is None:
        navigation.way_home = PointTransit(navigation.home.lat_deg, navigation.home.lon_deg)
    return _along(navigation, now, navigation.way_home, navigation.asked_mps or navigation.homeward_mps, "home")


def _guided(navigation: Navigation, now: ModeInput) -> ModeOutput:
    """Place, velocity, course or turn rate; without a target, and when it was not repeated, stay here."""
    guided = navigation.guided
    if guided.is_stale(now.now_ns, navigation.guided_timeout_ns):
        navigation.events.add(NOTICE, f"GUIDED: no target for {navigation.guided_timeout_ns * 1e-9:g} s, stopping")
        guided.clear()
    target = guided.target
    if target is None or target.kind == POSITION:
        if guided.transit is None:
            guided.transit = PointTransit(*navigation.stopping_place(now))
            guided.transit.arrived = True
        return _along(navigation, now, guided.transit, navigation.asked_mps or navigation.cruise_mps, "destination")
    if target.kind == TURN:
        return Order(None, target.turn_rate_radps, target.speed_mps)
    if target.kind == COURSE or target.heading_rad is not None:
        return _steered(navigation, now, target.heading_rad or 0.0, target.speed_mps)
    if target.speed_mps < _STILL_MPS:
        return Order(None, 0.0, 0.0)
    (vn, ve, _), course_rad = now.estimate.vel_ned_mps, math.atan2(target.east_mps, target.north_mps)
    heading_rad = guided.course.heading_rad(navigation.gains, course_rad, (vn, ve), now.dt_s)
    return _steered(navigation, now, heading_rad, target.speed_mps)


def _kept(navigation: Navigation, now: ModeInput, station: StationKeeping) -> GuidanceOutput:
    return station.steer(navigation.gains, now.frame, now.pos_ne_m, now.estimate.yaw_rad, navigation.cruise_mps)


def _along(navigation: Navigation, now: ModeInput, transit: PointTransit, most_mps: float, what: str) -> ModeOutput:
    under_way = transit.under_way
    output = transit.steer(
        navigation.gains, now.frame, now.pos_ne_m, now.estimate.yaw_rad, now.speed_mps, most_mps, now.dt_s
    )
    if under_way and transit.arrived:
        navigation.events.add(NOTICE, f"Reached {what}")
    return _toward(navigation, now, output)


def _toward(navigation: Navigation, now: ModeInput, output: GuidanceOutput) -> Order:
    navigation.output = output
    return Order(output.heading_rad, 0.0, output.speed_mps)


def _steered(navigation: Navigation, now: ModeInput, heading_rad: float, speed_mps: float) -> Order:
    navigation.output = GuidanceOutput(heading_rad, speed_mps, 0.0, 0.0, heading_rad, False)
    return Order(heading_rad, 0.0, speed_mps)


TABLE: tuple[Mode, ...] = (
    Mode(MANUAL, ROVER_MODES[MANUAL], False, _manual),
    Mode(ACRO, ROVER_MODES[ACRO], False, _acro),
    Mode(STEERING, ROVER_MODES[STEERING], True, _steering),
    Mode(HOLD, ROVER_MODES[HOLD], False, _hold),
    Mode(LOITER, ROVER_MODES[LOITER], True, _loiter, Navigation.enter_loiter),
    Mode(AUTO, ROVER_MODES[AUTO], True, _auto, Navigation.enter_auto),
    Mode(RTL, ROVER_MODES[RTL], True, _rtl, Navigation.enter_rtl),
    Mode(GUIDED, ROVER_MODES[GUIDED], True, _guided, Navigation.enter_guided),
)
BY_NUMBER = {mode.number: mode for mode in TABLE}
NAMES = {mode.number: mode.name for mode in TABLE}
