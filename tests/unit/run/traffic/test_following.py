"""The place of a follower on straight and turning tracks, and a point mass that follows it in a current."""

from __future__ import annotations

import math

import pytest

from tests.memory_size import size_bytes
from xitl_cli.run.traffic.following import FollowLaw, LeaderTrack
from xitl_cli.run.traffic.self_report import Point, SelfReport

S = 1_000_000_000


def report(at_s: float, pos: Point, vel: Point, yaw_rad: float | None = None) -> SelfReport:
    return SelfReport(round(at_s * S), pos, vel, math.atan2(vel[1], vel[0]) if yaw_rad is None else yaw_rad)


def straight(offset: tuple[float, float], course_rad: float, seconds: float = 30.0) -> LeaderTrack:
    """A leader at 3 m/s, heard ten times a second."""
    track = LeaderTrack(offset)
    rate = 3.0 * math.cos(course_rad), 3.0 * math.sin(course_rad)
    for tick in range(round(seconds * 10) + 1):
        track.add(report(tick / 10, (rate[0] * tick / 10, rate[1] * tick / 10), rate))
    return track


@pytest.mark.parametrize("offset", [(-10.0, 0.0), (-10.0, 5.0), (0.0, -8.0), (6.0, 2.0)])
@pytest.mark.parametrize("course_rad", [0.0, 2.0])
def test_on_a_straight_track_the_place_is_in_the_leaders_axes(offset: tuple[float, float], course_rad: float) -> None:
    place = straight(offset, course_rad).place(30 * S)
    assert place is not None
    north, east = (math.cos(course_rad), math.sin(course_rad)), (-math.sin(course_rad), math.cos(course_rad))
    leader = 90.0 * north[0], 90.0 * north[1]
    expected = tuple(leader[k] + offset[0] * north[k] + offset[1] * east[k] for k in (0, 1))
    assert place.pos_ne_m == pytest.approx(expected, abs=1e-6)
    assert place.speed_mps == pytest.approx(3.0, abs=0.01)


def test_between_two_reports_the_leader_goes_on() -> None:
    place = straight((-10.0, 0.0), 0.0).place(round(30.4 * S))
    assert place is not None
    assert place.pos_ne_m == pytest.approx((81.2, 0.0), abs=1e-6)


def test_a_place_astern_is_on_the_leaders_track_through_a_corner() -> None:
    """10 m north, then east: 10 m back along the way it is still on the first leg, not 10 m west of the leader."""
    track = LeaderTrack((-10.0, 0.0))
    for tick in range(61):
        way_m = 0.3 * tick
        on_first = way_m <= 10.0
        pos = (way_m, 0.0) if on_first else (10.0, way_m - 10.0)
        track.add(report(tick / 10, pos, (3.0, 0.0) if on_first else (0.0, 3.0)))
    place = track.place(6 * S)
    assert place is not None
    assert place.pos_ne_m == pytest.approx((8.0, 0.0), abs=0.3)  # 18 m were gone; a point each 0.5 m cuts the corner
    assert track.pursuit((5.0, 0.2)).left_m == pytest.approx(-0.2, abs=0.01)  # to starboard of the first leg
    assert track.pursuit((5.0, 0.2)).aim_ne_m == pytest.approx((10.0, 2.0), abs=0.3)  # 7 m on, around the corner


def test_a_leader_that_drifts_before_it_is_armed_has_no_track() -> None:
    track = LeaderTrack((-10.0, 0.0))
    for tick in range(100):
        track.add(report(tick / 10, (0.0, 0.06 * tick), (0.0, 0.6), yaw_rad=0.0)._replace(armed=False))
    place = track.place(10 * S)
    assert place is not None
    assert place.pos_ne_m == pytest.approx((-10.0, 5.94))
    assert place.speed_mps == 0.0


def test_corners_are_not_taken_faster_than_the_leader_took_them_and_a_start_is_none() -> None:
    """It gets under way slowly, turns east at 20 m at 1 m/s and goes on; the follower is far behind its place."""
    track, way_m, now_s = LeaderTrack((-10.0, 0.0)), 0.0, 0.0
    while way_m < 60.0:
        speed = 1.0 if way_m < 4.0 or 18.0 <= way_m < 24.0 else 3.0
        pos = (min(way_m, 20.0), max(way_m - 20.0, 0.0))
        track.add(report(now_s, pos, (speed, 0.0) if way_m < 20.0 else (0.0, speed)))
        way_m, now_s = way_m + 0.1 * speed, now_s + 0.1
    place = track.place(round(now_s * S))
    assert place is not None
    speeds = []
    for pos in ((1.0, 0.0), (16.0, 0.0), (20.0, 10.0)):
        own = report(now_s, pos, (3.0, 0.0))
        speeds.append(math.hypot(*FollowLaw(3.0).velocity_ne_mps(place, track.pursuit(pos), own)))
    assert speeds == pytest.approx([4.5, 1.5, 4.5])


def test_a_leader_that_has_not_moved_yet_is_taken_to_have_come_the_way_it_heads() -> None:
    track = LeaderTrack((-10.0, 2.0))
    assert track.place(0) is None
    track.add(report(0.0, (5.0, 5.0), (0.0, 0.0), yaw_rad=math.pi / 2))
    place = track.place(0)
    assert place is not None
    assert place.pos_ne_m == pytest.approx((3.0, -5.0))
    assert place.speed_mps == 0.0


def test_a_leader_that_stops_has_a_place_that_stands_still() -> None:
    track = straight((-10.0, 0.0), 0.0)
    for tick in range(301, 400):
        track.add(report(tick / 10, (90.0, 0.0), (0.05 * (-1) ** tick, 0.0)))
    assert not track.moving
    place = track.place(40 * S)
    assert place is not None
    assert (place.pos_ne_m, place.speed_mps) == (pytest.approx((80.0, 0.0), abs=0.6), 0.0)


def test_a_long_track_is_not_kept() -> None:
    track = straight((-10.0, 0.0), 0.0, seconds=600.0)
    assert size_bytes(track) < 250 * 50


@pytest.mark.medium
@pytest.mark.parametrize("current", [(0.0, 0.0), (0.0, 0.6), (-0.4, -0.3)])
def test_a_follower_that_the_current_carries_off_ends_at_its_place(current: Point) -> None:
    """It takes the velocity for one through the water, with a lag of 2 s; it starts 25 m behind and 12 m beside."""
    track, law = LeaderTrack((-10.0, 0.0)), FollowLaw(3.0)
    pos, vel = (-35.0, 12.0), (0.0, 0.0)
    for tick in range(2400):
        now_s = tick / 20
        track.add(report(now_s, (2.5 * now_s, 0.0), (2.5, 0.0)))
        place = track.place(round(now_s * S))
        assert place is not None
        if tick % 4 == 0:
            own = report(now_s, pos, (vel[0] + current[0], vel[1] + current[1]), yaw_rad=0.0)
            asked = law.velocity_ne_mps(place, track.pursuit(pos), own)
        vel = vel[0] + (asked[0] - vel[0]) * 0.025, vel[1] + (asked[1] - vel[1]) * 0.025
        pos = pos[0] + 0.05 * (vel[0] + current[0]), pos[1] + 0.05 * (vel[1] + current[1])
        assert math.hypot(*asked) <= 4.5 + 1e-9
    # Along the track there is no integral: what carries it off over the gain is what is left.
    assert pos[1] == pytest.approx(0.0, abs=0.3)
    assert pos[0] - place.pos_ne_m[0] == pytest.approx(current[0] / 0.25, abs=0.3)


def test_a_leader_that_lies_and_drifts_takes_its_track_along() -> None:
    """It heads north and drifts astern and to the east, faster than what counts as making way."""
    track = straight((-10.0, 0.0), 0.0)
    for tick in range(301, 700):
        since = (tick - 300) / 10
        track.add(report(tick / 10, (90.0 - 0.6 * since, 0.3 * since), (-0.6, 0.3), yaw_rad=0.0))
    place = track.place(70 * S)
    assert not track.moving
    assert place is not None
    assert place.speed_mps == 0.0
    assert place.pos_ne_m == pytest.approx((90.0 - 24.0 - 10.0, 12.0), abs=1.0)


def test_a_leader_that_is_silent_is_taken_to_lie_where_it_was_heard_last() -> None:
    """So that its follower, who would run it down if it had stopped, stops 10 m behind."""
    track = straight((-10.0, 0.0), 0.0)
    for silent_s, north_m, speed_mps in ((1.0, 83.0, 3.0), (2.0, 80.0, 0.0), (60.0, 80.0, 0.0)):
        place = track.place(round((30.0 + silent_s) * S))
        assert place is not None
        assert place.pos_ne_m == pytest.approx((north_m, 0.0), abs=0.1)
        assert place.speed_mps == pytest.approx(speed_mps, abs=0.05)


def test_a_leader_that_gets_under_way_is_followed_by_what_it_will_do() -> None:
    """At 0.8 m/s2: the place says so, and the follower need not lag behind by what it takes to answer."""
    track, now_s = LeaderTrack((-10.0, 0.0)), 0.0
    for tick in range(30):
        now_s = tick / 10
        track.add(report(now_s, (0.4 * now_s**2, 0.0), (0.8 * now_s, 0.0), yaw_rad=0.0))
    place = track.place(round(now_s * S))
    assert place is not None
    assert place.acceleration_mps2 == pytest.approx(0.8, abs=0.1)
    assert place.speed_mps == pytest.approx(0.8 * now_s - 0.8 * 0.5, abs=0.1)  # smoothed over half a second
