"""Modes and orders that stations expect of a boat under ArduRover: SIMPLE, CIRCLE, SMART_RTL, stern first, guided."""

from __future__ import annotations

import math

import pytest
from boat import LAT_DEG, LON_DEG, degrees
from steered_boat import SteeredBoat

from agent.fcu.fence import CIRCLE_IN, FenceItem
from agent.fcu.mission import (
    AUX_FUNCTION,
    FENCE_ENABLE,
    GUIDED_ENABLE,
    SET_HOME,
    SET_REVERSE,
    SET_SERVO,
    MissionItem,
    make_mission,
    waypoint,
)
from agent.fcu.vehicle import modes

HOME = waypoint(LAT_DEG, LON_DEG)


def do(command: int, *parameters: float) -> MissionItem:
    return MissionItem(command, parameters=(*parameters, *[0.0] * (4 - len(parameters))))


@pytest.mark.medium
@pytest.mark.parametrize(("kind", "heading_deg"), [(0, 90.0 + 45.0), (1, 45.0)])
def test_simple_goes_where_the_stick_points(kind: int, heading_deg: float) -> None:
    """From the heading at arming, or from north: forward and right is 45 degrees from there."""
    ship = SteeredBoat(SIMPLE_TYPE=kind, SPEED_MAX=3.0, RC1_DZ=0.0, RC3_DZ=0.0)
    ship.boat.yaw_rad = math.radians(90.0)
    ship.set_out(modes.MANUAL)
    ship.hold_sticks(3.0, 600, 0)  # it heads elsewhere by now
    assert ship.autopilot.set_mode(modes.SIMPLE) == ""
    ship.hold_sticks(12.0, 500, 500)
    assert math.degrees(ship.boat.yaw_rad) % 360.0 == pytest.approx(heading_deg, abs=4.0)
    assert ship.speed_mps == pytest.approx(3.0 * math.sqrt(0.5), abs=0.25)
    ship.hold_sticks(8.0, 0, 0)  # the heading is held
    assert math.degrees(ship.boat.yaw_rad) % 360.0 == pytest.approx(heading_deg, abs=6.0)
    assert ship.speed_mps < 0.3


@pytest.mark.medium
def test_circle_goes_around_where_it_was_begun() -> None:
    ship = SteeredBoat(CIRC_RADIUS=10.0, CIRC_DIR=1.0, CIRC_SPEED=1.5).set_out(modes.CIRCLE)
    ship.sail(30.0)
    off_m: list[float] = []
    ship.sail(30.0, lambda: bool(off_m.append(abs(ship.distance_m(0.0, 0.0) - 10.0))))
    assert max(off_m) < 1.5
    assert ship.boat.yaw_rate_radps < 0.0
    assert ship.speed_mps == pytest.approx(1.5, abs=0.2)


@pytest.mark.medium
def test_smart_rtl_comes_back_the_way_it_went() -> None:
    ship = SteeredBoat()
    places = [degrees(25.0, 0.0), degrees(25.0, 25.0)]
    ship.autopilot.commands.set_mission(make_mission([HOME, *(waypoint(*place) for place in places)]))
    ship.set_out(modes.AUTO)
    ship.sail(60.0, lambda: ship.mode == "HOLD")
    assert ship.autopilot.set_mode(modes.SMART_RTL) == ""
    off_m: list[float] = []

    def look() -> bool:
        north_m, east_m = ship.boat.north_m, ship.boat.east_m
        off_m.append(min(abs(north_m - 25.0), abs(east_m)))
        return "Reached destination" in ship.said

    ship.sail(80.0, look)
    assert "Reached destination" in ship.said
    assert max(off_m) < 5.0  # never across the corner, which is 12 m off the way
    ship.sail(10.0)
    assert ship.distance_m(0.0, 0.0) < 4.0
    assert ship.mode == "SMART_RTL"


def test_smart_rtl_is_refused_without_a_path() -> None:
    ship = SteeredBoat()
    assert ship.autopilot.set_mode(modes.SMART_RTL) == "SMART_RTL needs a path home: no position yet"
    ship.sail(12.0)
    ship.autopilot.parameters.set("SRTL_POINTS", 0.0)
    ship.sail(0.3)
    assert ship.autopilot.set_mode(modes.SMART_RTL) == "SMART_RTL needs a path home: SRTL_POINTS is 0"


def test_modes_that_are_not_there_are_refused_by_name() -> None:
    ship = SteeredBoat()
    for number, name in ((2, "LEARNING"), (6, "FOLLOW"), (8, "DOCK"), (77, "77")):
        assert f"mode {name} is not supported" in ship.autopilot.set_mode(number)


@pytest.mark.medium
def test_a_mission_is_sailed_stern_first_and_bow_first_again() -> None:
    ship = SteeredBoat(WP_SPEED=1.0, WP_SPEED_MIN=0.5)
    ship.boat.yaw_rad = math.pi
    items = [do(SET_REVERSE, 1.0), waypoint(*degrees(12.0, 0.0)), do(SET_REVERSE, 0.0), waypoint(*degrees(30.0, 0.0))]
    ship.autopilot.commands.set_mission(make_mission([HOME, *items]))
    ship.set_out(modes.AUTO)
    ship.sail(8.0)
    assert ship.boat.surge_mps < -0.3
    assert abs(math.remainder(ship.boat.yaw_rad - math.pi, 2.0 * math.pi)) < 0.3
    ship.sail(60.0, lambda: ship.mode == "HOLD")
    assert ship.mode == "HOLD"
    assert ship.boat.surge_mps > 0.0
    assert abs(math.remainder(ship.boat.yaw_rad, 2.0 * math.pi)) < 0.3


@pytest.mark.medium
def test_a_mission_leaves_the_vessel_to_guided_targets() -> None:
    ship = SteeredBoat()
    items = [do(222, 12.0), do(GUIDED_ENABLE, 1.0), waypoint(*degrees(0.0, 10.0))]
    ship.autopilot.commands.set_mission(make_mission([HOME, *items]))
    ship.set_out(modes.AUTO)
    assert "targets are for GUIDED" in ship.autopilot.commands.go_to(*degrees(8.0, 0.0))
    ship.sail(0.1)
    assert ship.autopilot.in_guided
    assert ship.autopilot.commands.go_to(*degrees(8.0, 0.0)) == ""
    ship.sail(11.5)
    assert ship.distance_m(8.0, 0.0) < 3.0
    ship.sail(40.0, lambda: ship.mode == "HOLD")
    assert ship.distance_m(0.0, 10.0) < 4.0


def test_items_of_a_mission_are_carried_out_on_board() -> None:
    ship = SteeredBoat()
    items = [do(SET_SERVO, 5.0, 1700.0), do(FENCE_ENABLE, 1.0), do(SET_HOME, 1.0), do(SET_SERVO, 1.0, 1900.0)]
    ship.autopilot.commands.set_mission(make_mission([HOME, *items, waypoint(*degrees(40.0, 0.0))]))
    ship.set_out(modes.AUTO)
    ship.sail(0.3)
    assert ship.autopilot.servos.widths_us[4] == 1700
    assert ship.autopilot.servos.widths_us[0] == 0
    assert ship.autopilot.fence.enabled
    assert ship.autopilot.navigator.home_is_set
    assert "Circle fence enabled" in ship.said
    assert "ServoRelayEvent: Channel 1 is already in use" in ship.said


def test_an_auxiliary_function_of_a_mission_switches_the_mode() -> None:
    ship = SteeredBoat()
    items = [do(AUX_FUNCTION, 56.0, 2.0), waypoint(*degrees(40.0, 0.0))]
    ship.autopilot.commands.set_mission(make_mission([HOME, *items]))
    ship.set_out(modes.AUTO)
    ship.sail(0.1)
    assert ship.mode == "LOITER"


def test_switches_act_as_those_of_a_transmitter() -> None:
    """Numbers of RCx_OPTION in ArduRover. A switch has the positions 0 low, 1 middle, 2 high."""
    fence, mission_reset, clear_mission, disarm, arm_disarm = 11, 24, 58, 81, 153
    ship = SteeredBoat()
    ship.sail(12.0)
    autopilot, switch = ship.autopilot, ship.autopilot.commands.aux_function

    armed = []
    for function, position in (
        (arm_disarm, 1),
        (arm_disarm, 2),
        (arm_disarm, 1),
        (disarm, 0),
        (disarm, 2),
        (disarm, 0),
    ):
        assert switch(function, position) == ""
        armed.append(autopilot.state.armed)
    assert armed == [False, True, True, True, False, False]
    assert switch(arm_disarm, 2) == ""
    assert switch(arm_disarm, 0) == ""
    assert not autopilot.state.armed

    autopilot.commands.set_mission(make_mission([HOME, *(waypoint(*degrees(float(n), 0.0)) for n in (10, 20, 30))]))
    autopilot.commands.set_current(2)
    for function, position, current in ((mission_reset, 0, 2), (clear_mission, 1, 2), (mission_reset, 2, 1)):
        assert switch(function, position) == ""
        assert autopilot.navigator.progress.current == current
    assert len(autopilot.navigator.mission.items) == 4
    assert switch(clear_mission, 2) == ""
    assert len(autopilot.navigator.mission.items) == 0

    autopilot.commands.set_fence([FenceItem(CIRCLE_IN, LAT_DEG, LON_DEG, 50.0)])
    for position, enabled in ((2, True), (1, False), (2, True), (0, False)):
        assert switch(fence, position) == ""
        assert autopilot.fence.enabled == enabled


def test_a_servo_is_moved_to_and_fro() -> None:
    servos = SteeredBoat().autopilot.servos
    assert servos.repeat(5, 1900, 2, 2.0) == ""
    seen = []
    for tenth in range(60):
        servos.update(tenth * 100_000_000)
        seen.append(servos.widths_us[4])
    assert [seen[at] for at in (0, 5, 10, 20, 30, 59)] == [1900, 1900, 1500, 1900, 1500, 1500]
    assert servos.repeat(5, 1900, 1, math.nan) == ""
    assert "does not exist" in servos.set(17, 1500)
    assert "use 500 to 2500" in servos.set(5, 100)


@pytest.mark.medium
def test_prearm_problems_are_repeated() -> None:
    """Every 30 s, and 4 s after the last time when a check begins to fail."""
    ship = SteeredBoat()
    ship.sensors.latency_ns = 10**12  # no fix ever
    ship.autopilot.set_mode(modes.GUIDED)
    ship.sail(35.0)
    said = [text for text in ship.said if text.startswith("PreArm: GPS")]
    assert said == ["PreArm: GPS 1: Bad fix"]
    ship.autopilot.set_mode(modes.HOLD)
    ship.sail(2.0)
    ship.said.clear()
    ship.autopilot.set_mode(modes.GUIDED)
    ship.sail(8.0)
    assert [text for text in ship.said if "Bad fix" in text] == ["PreArm: GPS 1: Bad fix"]


def test_an_origin_that_was_set_is_kept_and_one_that_is_there_stays() -> None:
    ship = SteeredBoat()
    assert ship.autopilot.commands.set_origin(*degrees(-30.0, 10.0), 40.0) == ""
    ship.set_out(modes.HOLD)
    frame = ship.autopilot.estimator.frame
    assert frame is not None
    assert (frame.lat_deg, frame.lon_deg) == degrees(-30.0, 10.0)
    assert ship.autopilot.state.estimate.pos_ned_m[:2] == pytest.approx((30.0, -10.0), abs=1.5)
    assert "is set already" in ship.autopilot.commands.set_origin(*degrees(0.0, 0.0), 0.0)
