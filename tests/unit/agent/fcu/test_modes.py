"""Each mode on the boat of our own: what ArduRover documents of it."""

from __future__ import annotations

import math

import pytest
from boat import LAT_DEG, LON_DEG, Boat, degrees
from steered_boat import SteeredBoat

from agent.fcu.control.guidance import GuidanceGains, GuidanceInput, StationKeeping
from agent.fcu.mission import make_mission, waypoint
from agent.fcu.parameters import Parameters
from agent.fcu.vehicle import modes
from agent.navigation.geodetic import LocalProjection

CURRENTS = [(0.0, 0.0), (0.5, 0.0), (-0.35, 0.35)]


@pytest.mark.medium
def test_manual_passes_the_sticks_through_and_centres_them_when_nobody_holds_them() -> None:
    """Thrust 1 is both full ahead; half of it is a command of sqrt(0.5), the thrust being square in the command."""
    ship = SteeredBoat(MOT_SLEWRATE=0.0, RC3_DZ=0.0, RC1_DZ=0.0).set_out(modes.MANUAL)
    ship.hold_sticks(0.3, 0, 500)
    assert ship.command == (283 / 400, 283 / 400)  # of whole microseconds
    ship.hold_sticks(0.3, 250, 0)
    assert ship.command[0] > 0.0 > ship.command[1]
    ship.sail(2.7)
    assert ship.command != (0.0, 0.0)
    ship.sail(0.4)  # RC_OVERRIDE_TIME is three seconds
    assert ship.command == (0.0, 0.0)


@pytest.mark.medium
def test_acro_turns_and_sails_at_what_the_sticks_say() -> None:
    ship = SteeredBoat(ACRO_TURN_RATE=20.0, SPEED_MAX=4.0, RC1_DZ=0.0, RC3_DZ=0.0).set_out(modes.ACRO)
    ship.hold_sticks(10.0, 500, 500)
    assert math.degrees(ship.boat.yaw_rate_radps) == pytest.approx(10.0, abs=1.0)
    assert ship.speed_mps == pytest.approx(2.0, abs=0.15)
    ship.hold_sticks(10.0, -1000, 0)
    assert math.degrees(ship.boat.yaw_rate_radps) == pytest.approx(-20.0, abs=1.5)
    assert ship.boat.surge_mps == pytest.approx(0.0, abs=0.2)
    ship.hold_sticks(10.0, 0, -250)
    assert ship.boat.surge_mps == pytest.approx(-1.0, abs=0.15)
    ship.sail(12.0)
    assert (ship.boat.surge_mps, ship.boat.yaw_rate_radps) == pytest.approx((0.0, 0.0), abs=0.1)


@pytest.mark.medium
def test_steering_turns_by_lateral_acceleration_and_on_the_spot_by_turn_rate() -> None:
    """Full stick is ATC_TURN_MAX_G across: a rate of a/v."""
    ship = SteeredBoat(SPEED_MAX=4.0, ATC_TURN_MAX_G=0.1, RC1_DZ=0.0, RC3_DZ=0.0).set_out(modes.STEERING)
    ship.hold_sticks(12.0, 500, 750)
    assert ship.speed_mps == pytest.approx(3.0, abs=0.2)
    assert ship.boat.yaw_rate_radps * ship.speed_mps == pytest.approx(0.5 * 0.1 * 9.81, rel=0.15)
    ship.hold_sticks(12.0, 500, -250)  # astern the stick still says where the bow path bends
    assert ship.boat.yaw_rate_radps < 0.0
    ship.hold_sticks(12.0, 1000, 0)
    assert math.degrees(ship.boat.yaw_rate_radps) == pytest.approx(30.0, abs=2.0)


@pytest.mark.medium
def test_hold_is_neutral() -> None:
    ship = SteeredBoat().set_out(modes.HOLD)
    ship.hold_sticks(1.0, 500, 500)
    assert ship.command == (0.0, 0.0)


@pytest.mark.parametrize("current", CURRENTS, ids=str)
@pytest.mark.parametrize("loiter_type", [0, 1, 2])
@pytest.mark.medium
def test_loiter_keeps_its_place_in_a_current(current: tuple[float, float], loiter_type: int) -> None:
    """Within the radius once it has settled; 0.3 m more for what the estimate is off."""
    ship = SteeredBoat(Boat(current_ne_mps=current, yaw_rad=2.0), LOIT_RADIUS=3.0, LOIT_TYPE=loiter_type).set_out(
        modes.LOITER
    )
    here = (ship.boat.north_m, ship.boat.east_m)
    ship.sail(40.0)
    far: list[float] = []
    ship.sail(60.0, lambda: bool(far.append(ship.distance_m(*here))))
    assert max(far) < 3.3
    if loiter_type and current != (0.0, 0.0):
        upstream_rad = math.atan2(-current[1], -current[0])
        off = abs(math.remainder(ship.boat.yaw_rad - upstream_rad, 2.0 * math.pi))
        assert (off < 0.5) if loiter_type == 1 else (off > math.pi - 0.5)


@pytest.mark.parametrize(
    ("loiter_type", "yaw_deg", "heading_deg", "speed_mps"),
    [(0, 0.0, 0.0, 2.0), (0, 180.0, 180.0, -2.0), (1, 180.0, 0.0, 1.0), (2, 0.0, 180.0, -1.0), (0, 45.0, 0.0, 1.5)],
)
def test_which_end_goes_first(loiter_type: int, yaw_deg: float, heading_deg: float, speed_mps: float) -> None:
    """Five metres north of the vessel, radius two: (5 - 2/2) m at 0.5/s, half of it with the bow 90 degrees off."""
    frame = LocalProjection(LAT_DEG, LON_DEG, 0.0)
    gains = GuidanceGains.from_parameters(Parameters({"LOIT_TYPE": loiter_type, "LOIT_RADIUS": 2.0}))
    now = GuidanceInput(gains, frame, (0.0, 0.0), math.radians(yaw_deg), 0.0, 3.0, 0.02)
    output = StationKeeping(*frame.to_geodetic(5.0, 0.0)).steer(now)
    assert math.cos(output.heading_rad - math.radians(heading_deg)) == pytest.approx(1.0)
    assert output.speed_mps == pytest.approx(speed_mps)
    assert output.distance_m == pytest.approx(5.0)


@pytest.mark.medium
def test_loiter_starts_where_the_vessel_can_stop() -> None:
    ship = SteeredBoat(RC3_DZ=0.0).set_out(modes.ACRO)
    ship.hold_sticks(12.0, 0, 600)
    start_m, speed_mps = ship.boat.north_m, ship.boat.surge_mps
    ship.autopilot.set_mode(modes.LOITER)
    ship.sail(0.1)
    assert ship.autopilot.navigator.output is not None
    assert ship.autopilot.navigator.output.distance_m == pytest.approx(speed_mps**2 / 2.0 / 0.7, rel=0.15)
    ship.sail(30.0)
    assert ship.boat.north_m - start_m < speed_mps**2 / 2.0 / 0.7 + 4.0


@pytest.mark.medium
def test_rtl_comes_home_at_its_speed_and_stays() -> None:
    ship = SteeredBoat(Boat(current_ne_mps=(0.3, 0.2)), RTL_SPEED=2.0, RC3_DZ=0.0).set_out(modes.ACRO)
    home = (ship.boat.north_m, ship.boat.east_m)
    ship.hold_sticks(25.0, 200, 700)
    assert ship.distance_m(*home) > 25.0
    assert ship.autopilot.set_mode(modes.RTL) == ""
    speeds: list[float] = []
    ship.sail(60.0, lambda: bool(speeds.append(ship.speed_mps)))
    assert max(speeds[500:]) < 2.3
    far: list[float] = []
    ship.sail(60.0, lambda: bool(far.append(ship.distance_m(*home))))
    assert max(far) < 2.3
    assert ship.said.count("Reached home") == 1
    assert ship.mode == "RTL"


@pytest.mark.parametrize("mode", [modes.STEERING, modes.LOITER, modes.RTL, modes.GUIDED])
def test_modes_that_steer_by_the_position_need_one_when_armed(mode: int) -> None:
    ship = SteeredBoat()
    ship.sail(1.0)
    assert ship.autopilot.arm(force=True) == ()
    assert "needs a position" in ship.autopilot.set_mode(mode)
    for free in (modes.MANUAL, modes.ACRO, modes.HOLD):
        assert ship.autopilot.set_mode(free) == ""


@pytest.mark.medium
@pytest.mark.parametrize(("behave", "mode"), [(0, "HOLD"), (1, "LOITER")])
def test_what_a_mission_ends_in(behave: int, mode: str) -> None:
    ship = SteeredBoat(MIS_DONE_BEHAVE=behave)
    ship.autopilot.commands.set_mission(make_mission([waypoint(LAT_DEG, LON_DEG), waypoint(*degrees(15.0, 0.0))]))
    ship.set_out(modes.AUTO)
    ship.sail(30.0)
    assert ship.mode == mode
    assert f"Mission complete: {mode}" in ship.said


@pytest.mark.medium
def test_home_that_moves_is_gone_to() -> None:
    ship = SteeredBoat().set_out(modes.RTL)
    ship.sail(5.0)
    assert ship.autopilot.commands.set_home(*degrees(30.0, 0.0), 0.0) == ""
    ship.sail(30.0)
    assert ship.distance_m(30.0, 0.0) < 2.5
    assert ship.said.count("Reached home") == 1
