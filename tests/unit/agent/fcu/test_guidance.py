"""Integral line of sight against a point that sails where its bow points, in a current."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from python39 import pairwise

from agent.fcu.control.guidance import GuidanceGains, GuidanceState, carry_integral, follow_leg, make_leg
from agent.fcu.parameters import Parameters

GAINS = GuidanceGains.from_parameters(Parameters())
LINE = make_leg((0.0, 0.0), (400.0, 300.0), None)


@pytest.mark.parametrize("drift_mps", [-1.0, 0.0, 0.6])
def test_the_crab_angle_is_found_and_the_cross_track_vanishes(drift_mps: float) -> None:
    """Steady state of a kinematic vessel, U sin(crab) = drift, whatever the start: closed form."""
    water_mps, dt_s = 3.0, 0.02
    along, cross = 0.0, 8.0
    state = GuidanceState()
    c, s = math.cos(LINE.course_rad), math.sin(LINE.course_rad)
    yaw = LINE.course_rad
    for _ in range(4000):
        position = (along * c - cross * s, along * s + cross * c)
        state, output = follow_leg(GAINS, state, LINE, position, yaw, water_mps, 3.0, dt_s)
        yaw = output.heading_rad
        along += water_mps * math.cos(yaw - LINE.course_rad) * dt_s
        cross += (water_mps * math.sin(yaw - LINE.course_rad) + drift_mps) * dt_s
    assert output.cross_track_m == pytest.approx(cross, abs=0.1)
    assert abs(cross) < 0.01
    assert LINE.course_rad - yaw == pytest.approx(math.asin(drift_mps / water_mps), abs=0.002)


def test_cross_track_is_positive_to_the_right() -> None:
    north = make_leg((0.0, 0.0), (100.0, 0.0), None)
    _, output = follow_leg(GAINS, GuidanceState(), north, (10.0, 4.0), 0.0, 1.0, 3.0, 0.02)
    assert output.cross_track_m == pytest.approx(4.0)
    assert output.heading_rad == pytest.approx(-math.atan(4.0 / GAINS.lookahead_m))
    assert output.distance_m == pytest.approx(math.hypot(90.0, 4.0))
    assert output.bearing_rad == pytest.approx(math.atan2(-4.0, 90.0))


@pytest.mark.parametrize(("position", "reached"), [((98.1, 0.0), True), ((97.9, 0.0), False), ((100.1, 30.0), True)])
def test_a_waypoint_is_reached_within_its_radius_or_once_passed(position, reached) -> None:
    north = make_leg((0.0, 0.0), (100.0, 0.0), None)
    assert follow_leg(GAINS, GuidanceState(), north, position, 0.0, 3.0, 3.0, 0.02)[1].reached is reached


def test_speed_comes_down_before_a_corner_and_not_before_a_straight_on() -> None:
    def speed_at(to_go_m: float, after: tuple[float, float] | None) -> float:
        line = make_leg((0.0, 0.0), (100.0, 0.0), after)
        return follow_leg(GAINS, GuidanceState(), line, (100.0 - to_go_m, 0.0), 0.0, 3.0, 3.0, 0.02)[1].speed_mps

    assert speed_at(50.0, (100.0, 50.0)) == 3.0
    assert speed_at(2.0, (200.0, 0.0)) == 3.0
    assert speed_at(2.0, None) == GAINS.speed_min_mps
    arc_m = GAINS.radius_m / math.tan(math.radians(45.0))
    assert speed_at(2.0, (100.0, 50.0)) == pytest.approx(GAINS.turn_rate_radps * arc_m)
    speeds = [speed_at(to_go / 10.0, (100.0, 50.0)) for to_go in range(300, 20, -1)]
    drops = [(a * a - b * b) / 0.2 for a, b in pairwise(speeds)]
    assert max(drops) <= GAINS.deceleration_mps2 * 1.001  # v dv = a ds


def test_the_bow_must_come_round_before_speed_is_made() -> None:
    def speed_off(off_deg: float) -> float:
        leg = make_leg((0.0, 0.0), (100.0, 0.0), None)
        return follow_leg(GAINS, GuidanceState(), leg, (0.0, 0.0), math.radians(off_deg), 0.0, 3.0, 0.02)[1].speed_mps

    assert [speed_off(deg) for deg in (0.0, -20.0, 60.0, 90.0, 120.0, 180.0)] == pytest.approx(
        [3.0, 3.0, 1.0, 1.0, 0.0, 0.0]
    )


@pytest.mark.medium
def test_the_integral_is_bounded_and_turns_with_the_course() -> None:
    state = GuidanceState()
    for _ in range(100_000):
        state, _output = follow_leg(GAINS, state, LINE, (30.0, 0.0), 0.0, 3.0, 3.0, 0.02)
    limit = math.tan(math.radians(50.0)) * GAINS.lookahead_m / GAINS.kappa_mps
    assert abs(state.integral_s) <= limit
    assert carry_integral(state, math.pi).integral_s == pytest.approx(-state.integral_s)
    assert carry_integral(state, math.pi / 2.0).integral_s == pytest.approx(0.0, abs=1e-9)


places = st.tuples(st.floats(-1e5, 1e5), st.floats(-1e5, 1e5))


@pytest.mark.medium
@given(places, places, st.none() | places, places, st.floats(-4.0, 4.0), st.floats(-10.0, 10.0), st.floats(0.1, 20.0))
def test_any_geometry_gives_a_finite_course(start, end, after, position, yaw, speed, desired) -> None:
    _, output = follow_leg(GAINS, GuidanceState(), make_leg(start, end, after), position, yaw, speed, desired, 0.02)
    assert -math.pi <= output.heading_rad <= math.pi
    assert 0.0 <= output.speed_mps <= desired
    assert math.isfinite(output.cross_track_m)
