"""Integral line of sight against a point that sails where its bow points, in a current."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from python39 import pairwise

from agent.fcu.control.guidance import (
    BOW,
    BOW_OR_STERN,
    STERN,
    CircleTransit,
    CourseOverGround,
    GuidanceGains,
    GuidanceInput,
    GuidanceOutput,
    GuidanceState,
    StationKeeping,
    carry_integral,
    follow_leg,
    make_leg,
)
from agent.fcu.parameters import Parameters
from agent.navigation.geodetic import LocalProjection

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


MADE = GuidanceGains(
    lookahead_m=8.0,
    kappa_mps=0.5,
    radius_m=2.0,
    speed_min_mps=0.8,
    deceleration_mps2=0.4,
    lateral_acceleration_mps2=1.5,
    turn_rate_radps=0.6,
    turn_radius_m=5.0,
    loiter_radius_m=4.0,
    loiter_per_s=0.25,
    loiter_type=BOW,
)
NORTH = make_leg((0.0, 0.0), (100.0, 0.0), None)


@pytest.mark.parametrize(
    ("off_deg", "pivots", "share"),
    [
        (0.0, True, 3.0),
        (20.0, True, 3.0),
        (40.0, True, 0.8 + 2.2 * 0.5),
        (-50.0, True, 0.8 + 2.2 * 0.25),
        (60.0, True, 0.8),
        (90.0, True, 0.8),
        (105.0, True, 0.4),
        (120.0, True, 0.0),
        (170.0, True, 0.0),
        (40.0, False, 1.9),
        (105.0, False, 0.8),
        (-170.0, False, 0.8),
    ],
)
def test_the_speed_falls_with_the_error_of_the_heading(off_deg: float, pivots: bool, share: float) -> None:
    gains, yaw_rad = MADE._replace(pivots=pivots), math.radians(off_deg)
    _, output = follow_leg(gains, GuidanceState(), NORTH, (10.0, 0.0), yaw_rad, 1.0, 3.0, 0.02)
    assert output.speed_mps == pytest.approx(share)
    _, slow = follow_leg(gains, GuidanceState(), NORTH, (10.0, 0.0), yaw_rad, 1.0, 0.5, 0.02)
    assert slow.speed_mps == pytest.approx(0.5 * min(share / 0.8, 1.0)), "at most the speed of the leg"


@pytest.mark.parametrize(
    ("turn_deg", "to_go_m", "speed_mps"),
    [
        # v² = corner² + 2 a (to go - radius - 0.6 s v), at most 3 m/s
        (None, 10.0, math.sqrt(0.64 + 0.8 * (10.0 - 2.0 - 1.8))),
        (None, 3.8, 0.8),
        (None, 3.0, 0.8),
        (None, 14.3, 3.0),
        # an arc of 2 m / tan(45 degrees): 0.6 rad/s allow 1.2 m/s, and 1.5 m/s² allow 1.73 m/s
        (90.0, 3.0, 1.2),
        (-90.0, 5.0, math.sqrt(1.44 + 0.8 * 1.2)),
        # an arc of 2 m / tan(10 degrees) = 11.34 m: 6.8 m/s and 4.1 m/s
        (20.0, 3.0, 3.0),
        # an arc of 2 m / tan(60 degrees): 0.69 m/s is below WP_SPEED_MIN
        (120.0, 3.0, 0.8),
        (180.0, 3.0, 0.8),
        (0.0, 1.0, 3.0),
    ],
)
def test_a_corner_is_approached_at_the_speed_of_its_arc(
    turn_deg: float | None, to_go_m: float, speed_mps: float
) -> None:
    turn_rad = None if turn_deg is None else math.radians(turn_deg)
    leg = NORTH._replace(turn_rad=turn_rad)
    _, output = follow_leg(MADE, GuidanceState(), leg, (100.0 - to_go_m, 0.0), 0.0, 1.0, 3.0, 0.02)
    assert output.speed_mps == pytest.approx(speed_mps)


def test_lateral_acceleration_limits_a_wide_corner() -> None:
    """An arc of 2 m / tan(15 degrees) = 7.46 m: 0.2 m/s² allow 1.22 m/s, 0.6 rad/s allow 4.5 m/s."""
    gains = MADE._replace(lateral_acceleration_mps2=0.2)
    leg = NORTH._replace(turn_rad=math.radians(30.0))
    _, output = follow_leg(gains, GuidanceState(), leg, (97.0, 0.0), 0.0, 1.0, 3.0, 0.02)
    assert output.speed_mps == pytest.approx(math.sqrt(0.2 * 2.0 / math.tan(math.radians(15.0))))


@pytest.mark.parametrize(
    ("kappa_mps", "speed_mps", "before_s", "after_s"),
    [
        (0.5, 1.0, 2.0, 2.0 + 0.1 * 8.0 * 3.0 / (64.0 + 16.0)),  # aim 3 m + 0.5 m/s * 2 s
        (0.5, 0.3, 2.0, 2.0),
        (0.0, 1.0, 2.0, 2.0),
        (0.5, 1.0, 1e3, math.tan(math.radians(50.0)) * 8.0 / 0.5),
        (0.5, 1.0, -1e3, -math.tan(math.radians(50.0)) * 8.0 / 0.5),
    ],
)
def test_the_integral_grows_by_fossens_law_within_its_limit(
    kappa_mps: float, speed_mps: float, before_s: float, after_s: float
) -> None:
    """Fossen 2021, eq 12.108, 3 m to the right of the leg for 0.1 s."""
    state, output = follow_leg(
        MADE._replace(kappa_mps=kappa_mps), GuidanceState(before_s), NORTH, (10.0, 3.0), 0.0, speed_mps, 3.0, 0.1
    )
    assert state.integral_s == pytest.approx(after_s)
    assert output.heading_rad == pytest.approx(-math.atan((3.0 + kappa_mps * before_s) / 8.0))


@pytest.mark.parametrize(
    ("place", "yaw_deg", "kind", "pivots", "heading_deg", "speed_mps"),
    [
        ((0.0, 0.0), 30.0, BOW, True, 30.0, 0.0),
        ((-2.0, 0.0), 30.0, BOW, True, 30.0, 0.0),  # half of the radius
        ((-10.0, 0.0), 0.0, BOW, True, 0.0, 2.0),
        ((-10.0, 0.0), 45.0, BOW, True, 0.0, 1.5),
        ((-10.0, 0.0), 90.0, BOW, True, 0.0, 1.0),
        ((-10.0, 0.0), 170.0, BOW, True, 0.0, 1.0),
        ((-10.0, 0.0), 180.0, BOW_OR_STERN, True, 180.0, -2.0),
        ((-10.0, 0.0), 90.1, BOW_OR_STERN, True, 180.0, -1.00111),
        ((-10.0, 0.0), 89.9, BOW_OR_STERN, True, 0.0, 1.00111),
        ((-10.0, 0.0), 0.0, STERN, True, 180.0, -1.0),
        ((0.0, -10.0), 90.0, BOW, True, 90.0, 2.0),
        ((30.0, 0.0), 180.0, BOW, True, 180.0, 3.0),  # at most the permitted speed
        ((-3.0, 0.0), 90.0, BOW, False, 0.0, 0.8),  # way on to turn: 0.125 m/s would not do
        ((-3.0, 0.0), 45.0, BOW, False, 0.0, 0.4),
        ((-3.0, 0.0), 45.0, STERN, False, 180.0, -0.8),
    ],
)
def test_a_station_is_returned_to_from_half_the_radius_on(
    place: tuple[float, float], yaw_deg: float, kind: int, pivots: bool, heading_deg: float, speed_mps: float
) -> None:
    frame = LocalProjection(0.0, 0.0, 0.0)
    gains = MADE._replace(loiter_type=kind, pivots=pivots)
    output = StationKeeping(0.0, 0.0).steer(GuidanceInput(gains, frame, place, math.radians(yaw_deg), 0.0, 3.0, 0.02))
    assert math.remainder(output.heading_rad - math.radians(heading_deg), math.tau) == pytest.approx(0.0, abs=1e-6)
    assert output.speed_mps == pytest.approx(speed_mps, abs=1e-4)
    assert output.distance_m == pytest.approx(math.hypot(*place), abs=1e-6)
    assert not output.reached


def test_a_station_keeps_its_heading_while_near_if_the_vessel_can_turn() -> None:
    frame = LocalProjection(0.0, 0.0, 0.0)
    for pivots, heading_rad in ((True, 0.5), (False, 0.9)):
        station, gains = StationKeeping(0.0, 0.0), MADE._replace(pivots=pivots)
        station.steer(GuidanceInput(gains, frame, (0.0, 0.0), 0.5, 0.0, 3.0, 0.02))
        output = station.steer(GuidanceInput(gains, frame, (0.5, 0.0), 0.9, 0.0, 3.0, 0.02))
        assert (output.heading_rad, output.speed_mps) == (heading_rad, 0.0)


def test_a_course_is_made_good_by_the_distance_off_its_line() -> None:
    """Half a second to starboard at 2 m/s is 1 m; the integral grows by 0.5 s * 8 * 1 / (64 + 1)."""
    course = CourseOverGround()
    assert course.heading_rad(MADE, 0.0, (3.0, 2.0), 0.5) == pytest.approx(-math.atan(1.0 / 8.0))
    integral_s = 0.5 * 8.0 / 65.0
    assert course.heading_rad(MADE, 0.0, (3.0, 0.0), 0.5) == pytest.approx(-math.atan((1.0 + 0.5 * integral_s) / 8.0))
    turned = math.radians(60.0)
    integral_s += 0.5 * 8.0 / (64.0 + (1.0 + 0.5 * integral_s) ** 2)
    aim_m = 0.5 * (1.0 + 0.5 * integral_s)
    assert course.heading_rad(MADE, turned, (0.0, 0.0), 0.0) == pytest.approx(turned - math.atan(aim_m / 8.0))
    far = CourseOverGround()
    for _ in range(2):
        heading_rad = far.heading_rad(MADE._replace(kappa_mps=0.0), 0.0, (0.0, -30.0), 1.0)
    assert heading_rad == pytest.approx(math.atan(1.0)), "no more than the look-ahead"


CENTRE_NE_M = (30.0, -20.0)


def circling(clockwise: bool, radius_m: float = 10.0) -> tuple[CircleTransit, LocalProjection]:
    frame = LocalProjection(0.0, 0.0, 0.0)
    return CircleTransit(MADE, *frame.to_geodetic(*CENTRE_NE_M), radius_m, clockwise), frame


def from_centre(angle_rad: float, distance_m: float) -> tuple[float, float]:
    return CENTRE_NE_M[0] + distance_m * math.cos(angle_rad), CENTRE_NE_M[1] + distance_m * math.sin(angle_rad)


@pytest.mark.parametrize(
    ("radius_m", "expected_m", "speed_mps"),
    [(10.0, 10.0, math.sqrt(15.0)), (3.0, 5.0, math.sqrt(7.5)), (4.0, 5.0, math.sqrt(7.5))],
)
def test_a_circle_has_at_least_the_turning_radius_and_a_speed_for_its_curve(
    radius_m: float, expected_m: float, speed_mps: float
) -> None:
    """1.5 m/s² and 0.6 rad/s: the turn rate limits circles below 4.2 m."""
    circle, _ = circling(True, radius_m)
    assert (circle.radius_m, circle.speed_mps) == pytest.approx((expected_m, min(speed_mps, 0.6 * expected_m)))
    slow = CircleTransit(MADE._replace(turn_rate_radps=0.2), 0.0, 0.0, 10.0, True)
    assert slow.speed_mps == pytest.approx(2.0)


@pytest.mark.parametrize("clockwise", [True, False])
@pytest.mark.parametrize(("angle_deg", "outside_m"), [(0.0, 0.0), (50.0, 4.0), (200.0, -6.0), (-80.0, 30.0)])
def test_a_circle_is_approached_by_the_line_of_sight_to_its_tangent(
    clockwise: bool, angle_deg: float, outside_m: float
) -> None:
    circle, frame = circling(clockwise)
    sense, angle_rad = 1.0 if clockwise else -1.0, math.radians(angle_deg)
    heading_rad = angle_rad + sense * (0.5 * math.pi + math.atan(outside_m / 8.0))
    place = from_centre(angle_rad, 10.0 + outside_m)
    output = circle.steer(GuidanceInput(MADE, frame, place, heading_rad, 1.0, 3.0, 0.1))
    assert math.remainder(output.heading_rad - heading_rad, math.tau) == pytest.approx(0.0, abs=1e-6)
    assert math.remainder(output.bearing_rad - angle_rad - math.pi, math.tau) == pytest.approx(0.0, abs=1e-6)
    assert output.speed_mps == 3.0
    assert (output.cross_track_m, output.distance_m) == pytest.approx((-sense * outside_m, abs(outside_m)), abs=1e-5)
    assert not output.reached


@pytest.mark.parametrize("clockwise", [True, False])
def test_on_a_circle_the_angle_and_the_integral_grow(clockwise: bool) -> None:
    """A step of 0.1 s, 1 m outside: the integral grows as on a line, and the angle is counted along the way."""
    circle, frame = circling(clockwise)
    sense, integral_s = 1.0 if clockwise else -1.0, 0.0

    def steer(angle_rad: float, outside_m: float, speed_mps: float = 1.0) -> GuidanceOutput:
        place = from_centre(angle_rad, 10.0 + outside_m)
        return circle.steer(GuidanceInput(MADE, frame, place, 0.0, speed_mps, 3.0, 0.1))

    steer(3.0, 2.1)  # not yet on it
    steer(3.0 + sense * 0.2, 1.99)
    assert circle.turned_rad == 0.0
    for number in range(1, 4):
        angle_rad = 3.0 + sense * 0.2 * (number + 1)
        aim_m = 1.0 + 0.5 * integral_s
        output = steer(angle_rad, 1.0)
        assert circle.turned_rad == pytest.approx(0.2 * number, abs=1e-6)
        expected_rad = angle_rad + sense * (0.5 * math.pi + math.atan(aim_m / 8.0))
        assert math.remainder(output.heading_rad - expected_rad, math.tau) == pytest.approx(0.0, abs=1e-6)
        integral_s += 0.1 * 8.0 / (64.0 + aim_m * aim_m)
    before = steer(3.0 + sense * 0.8, 1.0, 0.3).heading_rad
    assert steer(3.0 + sense * 0.8, 1.0, 0.3).heading_rad == before, "too slow for the integral"
    assert circle.turned_rad == pytest.approx(0.6, abs=1e-6)
    for _ in range(3000):
        steer(3.0, 8.0)
    limit_m = 0.5 * math.tan(math.radians(50.0)) * 8.0 / 0.5
    expected_rad = 3.0 + sense * (0.5 * math.pi + math.atan((8.0 + limit_m) / 8.0))
    assert math.remainder(steer(3.0, 8.0).heading_rad - expected_rad, math.tau) == pytest.approx(0.0, abs=1e-6)


def test_a_leg_lies_where_it_starts_and_ends() -> None:
    leg = make_leg((20.0, -30.0), (120.0, -30.0), None)
    _, output = follow_leg(MADE, GuidanceState(), leg, (30.0, -27.0), 0.0, 1.0, 3.0, 0.1)
    assert (output.cross_track_m, output.distance_m) == pytest.approx((3.0, math.hypot(90.0, 3.0)))
    assert output.bearing_rad == pytest.approx(math.atan2(-3.0, 90.0))
