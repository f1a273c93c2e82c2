"""GUIDED on the boat of our own: places, velocities, courses, time-outs, and orders that are refused."""

from __future__ import annotations

import math

import pytest
from boat import LAT_DEG, LON_DEG, Boat, degrees
from steered_boat import SteeredBoat

from agent.fcu.mission import make_mission, waypoint
from agent.fcu.vehicle import modes
from agent.fcu.vehicle.navigation import COURSE, POSITION, TURN, VELOCITY

CURRENTS = [(0.0, 0.0), (0.5, 0.0), (-0.35, 0.35)]


@pytest.mark.medium
def test_guided_goes_to_a_place_and_stays_there() -> None:
    ship = SteeredBoat(Boat(current_ne_mps=(0.0, 0.4))).set_out(modes.GUIDED)
    here = (ship.boat.north_m, ship.boat.east_m)
    ship.sail(10.0)
    assert ship.distance_m(*here) < 2.3  # no target: it stays
    assert ship.autopilot.commands.go_to(*degrees(40.0, 20.0)) == ""
    target = ship.autopilot.guided_target
    assert target is not None
    assert target.kind == POSITION
    ship.sail(40.0)
    assert ship.distance_m(40.0, 20.0) < 2.3
    assert ship.said.count("Reached destination") == 1
    ship.repeat(3.0, lambda: ship.autopilot.commands.go_to(*degrees(40.0, 20.0)))
    assert ship.said.count("Reached destination") == 1  # the same place, many times: it was there
    ship.repeat(3.0, lambda: ship.autopilot.commands.go_to(*degrees(40.0 + 1e-9 * ship.boat.time_ns / 1e9, 20.0)))
    assert ship.said.count("Reached destination") == 1  # a place that wanders about the vessel is not reached anew
    assert ship.autopilot.commands.go_to_local(0.0, 0.0) == ""
    ship.sail(60.0)
    assert ship.distance_m(0.0, 0.0) < 2.5  # the origin is a mean of fixes


@pytest.mark.medium
@pytest.mark.parametrize("current", CURRENTS, ids=str)
def test_guided_follows_a_velocity_and_stops_when_it_is_not_repeated(current: tuple[float, float]) -> None:
    ship = SteeredBoat(Boat(current_ne_mps=current)).set_out(modes.GUIDED)
    ship.repeat(40.0, lambda: ship.autopilot.commands.set_velocity(1.2, 1.6))
    vn, ve = ship.boat.vel_ne_mps
    assert (vn, ve) == pytest.approx((1.2, 1.6), abs=0.15)
    assert ship.autopilot.guided_target is not None
    assert ship.autopilot.guided_target.kind == VELOCITY
    ship.sail(2.8)
    assert ship.autopilot.guided_target is not None
    ship.sail(0.3)
    assert ship.autopilot.guided_target is None
    assert ship.said.count("GUIDED: no target for 3 s, stopping") == 1
    ship.sail(30.0)
    here = (ship.boat.north_m, ship.boat.east_m)
    ship.sail(20.0)
    assert ship.distance_m(*here) < 2.0


@pytest.mark.medium
def test_guided_velocity_with_a_heading_may_go_astern() -> None:
    ship = SteeredBoat().set_out(modes.GUIDED)
    ship.repeat(15.0, lambda: ship.autopilot.commands.set_velocity(-0.8, 0.0, yaw_rad=0.0))
    assert ship.boat.surge_mps == pytest.approx(-0.8, abs=0.15)
    assert abs(ship.boat.yaw_rad) < 0.1
    ship.repeat(10.0, lambda: ship.autopilot.commands.set_velocity(0.0, 0.0))
    assert ship.speed_mps < 0.15


@pytest.mark.medium
def test_guided_course_and_turn_rate() -> None:
    ship = SteeredBoat().set_out(modes.GUIDED)
    ship.repeat(20.0, lambda: ship.autopilot.commands.set_course(math.radians(100.0), 1.5))
    assert math.degrees(ship.boat.yaw_rad) == pytest.approx(100.0, abs=3.0)
    assert ship.speed_mps == pytest.approx(1.5, abs=0.1)
    assert ship.autopilot.guided_target is not None
    assert ship.autopilot.guided_target.kind == COURSE
    ship.repeat(15.0, lambda: ship.autopilot.commands.set_velocity(1.0, 0.0, yaw_rate_radps=-0.2))
    assert ship.boat.yaw_rate_radps == pytest.approx(-0.2, abs=0.03)
    assert ship.speed_mps == pytest.approx(1.0, abs=0.15)
    assert ship.autopilot.guided_target.kind == TURN


@pytest.mark.parametrize(
    ("order", "words"),
    [
        (lambda a: a.commands.go_to(math.nan, 1.0), "position nan, 1 is not on Earth"),
        (lambda a: a.commands.go_to(91.0, 1.0), "is not on Earth"),
        (lambda a: a.commands.go_to(0.0, 0.0), "position 0, 0 is not set"),
        (lambda a: a.commands.go_to_local(math.inf, 0.0), "use less than 1000 km"),
        (lambda a: a.commands.set_velocity(math.nan, 0.0), "velocity nan, 0 m/s"),
        (lambda a: a.commands.set_velocity(1.0, 0.0, math.nan), "heading nan"),
        (lambda a: a.commands.set_velocity(1.0, 0.0, None, math.inf), "turn rate inf"),
        (lambda a: a.commands.set_course(0.0, 1000.0), "at most 100 m/s"),
        (lambda a: a.commands.set_turn_rate(math.nan, 1.0), "turn rate nan"),
        (lambda a: a.commands.set_home(math.nan, 0.0, 0.0), "not on Earth"),
        (lambda a: a.commands.set_home(1.0, 1.0, math.nan), "altitude nan"),
        (lambda a: a.commands.set_current(7), "mission item 7 does not exist"),
        (lambda a: a.commands.change_speed(math.nan), "speed nan m/s"),
    ],
)
def test_refused_orders_say_why(order, words: str) -> None:
    ship = SteeredBoat().set_out(modes.GUIDED)
    ship.autopilot.events.drain()
    assert words in order(ship.autopilot)
    assert words in ship.autopilot.events.drain()[0].text
    assert ship.autopilot.guided_target is None


def test_targets_are_for_guided_only() -> None:
    ship = SteeredBoat().set_out(modes.LOITER)
    assert "targets are for GUIDED; the mode is LOITER" in ship.autopilot.commands.go_to(*degrees(10.0, 0.0))
    assert ship.autopilot.guided_target is None


@pytest.mark.medium
def test_a_target_given_before_arming_is_kept_and_a_stale_velocity_is_not() -> None:
    ship = SteeredBoat()
    ship.sail(12.0)
    assert ship.autopilot.set_mode(modes.GUIDED) == ""
    assert ship.autopilot.commands.set_velocity(2.0, 0.0) == ""
    ship.sail(4.0)
    assert ship.autopilot.arm() == ()
    ship.sail(5.0)
    assert ship.distance_m(0.0, 0.0) < 1.5
    ship.autopilot.disarm()
    assert ship.autopilot.commands.go_to(*degrees(20.0, 0.0)) == ""
    assert ship.autopilot.arm() == ()
    ship.sail(20.0)
    assert ship.distance_m(20.0, 0.0) < 3.0


@pytest.mark.medium
@pytest.mark.parametrize("mode", [modes.GUIDED, modes.AUTO])
def test_a_change_of_speed_is_for_the_mode_it_was_asked_in(mode: int) -> None:
    ship = SteeredBoat()
    ship.autopilot.commands.set_mission(make_mission([waypoint(LAT_DEG, LON_DEG), waypoint(*degrees(300.0, 0.0))]))
    ship.set_out(mode)
    if mode == modes.GUIDED:
        ship.autopilot.commands.go_to(*degrees(300.0, 0.0))
    assert ship.autopilot.commands.change_speed(1.5) == ""
    ship.sail(15.0)
    assert ship.speed_mps == pytest.approx(1.5, abs=0.1)
    other = modes.AUTO if mode == modes.GUIDED else modes.GUIDED
    ship.autopilot.set_mode(other)
    ship.autopilot.set_mode(mode)
    if mode == modes.GUIDED:
        ship.autopilot.commands.go_to(*degrees(300.0, 0.0))
    ship.sail(15.0)
    assert ship.speed_mps == pytest.approx(1.5 if mode == modes.AUTO else 3.0, abs=0.1)
