"""The path of SMART_RTL: what is kept of it, what is cut off, when it is given up."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from python39 import pairwise

from agent.fcu.parameters import Parameters
from agent.fcu.vehicle.return_path import ReturnPath, thinned
from agent.fcu.vehicle_state import INFO, WARNING, EventQueue
from agent.navigation.geodetic import LocalProjection

FRAME = LocalProjection(-8.8, -63.95, 50.0)
SECOND = 1_000_000_000
PLACE = st.tuples(st.floats(-200.0, 200.0), st.floats(-200.0, 200.0))


class Trail:
    """A path that is followed by a metre a cycle at 1 Hz."""

    def __init__(self, **parameters: float) -> None:
        self.events = EventQueue()
        self.path = ReturnPath(Parameters(parameters), self.events)
        self.now_ns = 0
        self.place = (0.0, 0.0)
        self.stay(1)

    def stay(self, seconds: int, known: bool = True, saves: bool = True) -> None:
        for _ in range(seconds):
            self.now_ns += SECOND
            self.path.update(FRAME, self.place if known else None, self.now_ns, saves)

    def go(self, *places: tuple[float, float]) -> None:
        for end in places:
            north_m, east_m = self.place
            steps = math.ceil(math.dist(self.place, end))
            for step in range(1, steps + 1):
                part = step / steps
                self.place = (north_m + part * (end[0] - north_m), east_m + part * (end[1] - east_m))
                self.stay(1)

    def tidied(self) -> list[tuple[float, float]]:
        for _ in range(1000):
            if self.path.tidy():
                return self.path.points
        raise AssertionError("it never ends")


def test_corners_are_kept_and_straight_lines_thinned_out() -> None:
    trail = Trail()
    trail.go((60.0, 0.0), (60.0, 40.0), (20.0, 40.0))
    assert len(trail.path.points) < 300
    points = trail.tidied()
    assert points[0] == (0.0, 0.0)
    assert [(round(north), round(east)) for north, east in points[1:]] == [(60, 0), (60, 40), (20, 40)]


def test_a_loop_is_cut_off_where_the_path_comes_by_itself() -> None:
    trail = Trail()
    trail.go((40.0, 0.0), (40.0, 30.0), (20.0, 30.0), (20.0, -30.0))
    points = trail.tidied()
    assert len(points) == 3
    assert points[1] == pytest.approx((20.0, 0.0), abs=1.0)
    assert points[2] == pytest.approx((20.0, -30.0), abs=2.0)


@pytest.mark.parametrize("turn_deg", range(0, 360, 30))
def test_a_loop_is_cut_off_at_the_crossing_and_a_hook_that_does_not_cross_stays(turn_deg: int) -> None:
    """The first and the third line cross at two thirds of both: (60, 30) 2/3 = (60, -20) + (-30, 60) 2/3 = (40, 20)."""
    cos, sin = math.cos(math.radians(turn_deg)), math.sin(math.radians(turn_deg))

    def turned(*places: tuple[float, float]) -> list[tuple[float, float]]:
        return [(cos * north - sin * east, sin * north + cos * east) for north, east in places]

    crossing, hook = Trail(), Trail()
    crossing.go(*turned((60.0, 30.0), (60.0, -20.0), (30.0, 40.0)))
    corners = turned((60.0, 30.0), (60.0, -20.0), (30.0, -10.0))
    hook.go(*corners)
    points = crossing.tidied()
    assert len(points) == 3
    assert points[1] == pytest.approx(turned((40.0, 20.0))[0], abs=1.0)
    points = hook.tidied()
    accuracy_m = Parameters()["SRTL_ACCURACY"]
    assert all(min(math.dist(corner, point) for point in points) < 1.5 * accuracy_m for corner in corners)


def test_arming_begins_it_anew() -> None:
    trail = Trail()
    trail.go((30.0, 0.0))
    trail.path.restart()
    assert trail.path.problem == "no position yet"
    trail.stay(1)
    assert trail.path.points == [(30.0, 0.0)]
    assert trail.path.problem == ""


def test_without_a_position_for_long_it_is_given_up_until_the_next_arming() -> None:
    trail = Trail()
    trail.go((10.0, 0.0))
    trail.stay(14, known=False)
    assert trail.path.problem == ""
    trail.stay(3, known=False)
    assert trail.path.problem == "bad position"
    trail.stay(5)
    assert trail.path.points == []
    assert [event.text for event in trail.events.drain()] == ["SmartRTL deactivated: bad position"]
    trail.path.restart()
    trail.stay(1)
    assert trail.path.problem == ""


def test_a_path_that_does_not_fit_is_given_up_in_words() -> None:
    trail = Trail(SRTL_POINTS=20.0)
    radius_m, turns = 3.0, 30  # a spiral whose rounds keep apart
    for step in range(36 * turns):
        angle_rad = math.radians(10.0 * step)
        out_m = radius_m + 5.0 * step / 36
        trail.go((out_m * math.cos(angle_rad), out_m * math.sin(angle_rad)))
        if trail.path.problem:
            break
    assert trail.path.problem == "buffer full"
    said = [event.text for event in trail.events.drain()]
    assert said[-1] == "SmartRTL deactivated: buffer full"
    assert "SmartRTL Low on space!" in said


def test_there_and_back_many_times_fits() -> None:
    trail = Trail(SRTL_POINTS=60.0)
    for _ in range(12):
        trail.go((0.0, 100.0), (1.0, 0.0))
    assert trail.path.problem == ""
    assert len(trail.tidied()) <= 3


def test_no_points_means_no_path() -> None:
    trail = Trail(SRTL_POINTS=0.0)
    assert trail.path.problem == "SRTL_POINTS is 0"
    assert trail.path.points == []


def test_while_it_is_sailed_nothing_is_kept() -> None:
    trail = Trail()
    trail.place = (50.0, 0.0)
    trail.stay(3, saves=False)
    assert trail.path.points == [(0.0, 0.0)]


def test_a_new_origin_moves_it() -> None:
    trail = Trail()
    trail.go((30.0, 0.0))
    moved = LocalProjection(*FRAME.to_geodetic(10.0, 0.0), 50.0)
    trail.path.update(moved, (20.0, 0.0), trail.now_ns + SECOND, True)
    assert trail.path.points[0] == pytest.approx((-10.0, 0.0), abs=1e-3)


@pytest.mark.medium
@given(st.lists(PLACE, max_size=40), st.floats(0.1, 10.0))
def test_thinning_keeps_the_ends_and_leaves_no_point_far_off(places: list[tuple[float, float]], least_m: float) -> None:
    kept = thinned(places, least_m)
    assert kept[:1] == places[:1]
    assert kept[-1:] == places[-1:]
    for place in places:
        assert min((_off_m(place, a, b) for a, b in pairwise(kept)), default=0.0) <= least_m + 1e-9


def _off_m(place: tuple[float, float], a: tuple[float, float], b: tuple[float, float]) -> float:
    dn, de = b[0] - a[0], b[1] - a[1]
    length2 = dn * dn + de * de
    along = 0.0 if length2 == 0.0 else ((place[0] - a[0]) * dn + (place[1] - a[1]) * de) / length2
    along = min(max(along, 0.0), 1.0)
    return math.hypot(place[0] - a[0] - along * dn, place[1] - a[1] - along * de)


@pytest.mark.medium
@given(st.lists(PLACE, min_size=1, max_size=8))
def test_any_way_is_tidied_and_ends_where_it_ended(places: list[tuple[float, float]]) -> None:
    trail = Trail()
    trail.go(*places)
    points = trail.tidied()
    assert math.dist(points[0], (0.0, 0.0)) < 2.0
    assert math.dist(points[-1], trail.place) < 4.0


class Steps:
    """A path through given places, one a second."""

    def __init__(self, *places: tuple[float, float], **parameters: float) -> None:
        self.events = EventQueue()
        self.path = ReturnPath(Parameters({"SRTL_ACCURACY": 2.0, **parameters}), self.events)
        self.now_ns = 0
        self.go(*places)

    def go(self, *places: tuple[float, float], each_ns: int = SECOND) -> None:
        for place in places:
            self.now_ns += each_ns
            self.path.update(FRAME, place, self.now_ns, True)

    def tidied(self) -> list[tuple[float, float]]:
        while not self.path.tidy():
            pass
        return self.path.points


def mirrored(place: tuple[float, float], swaps: bool, sign: float) -> tuple[float, float]:
    north_m, east_m = reversed(place) if swaps else place
    return sign * north_m, east_m


@pytest.mark.parametrize("swaps", [False, True])
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("places", "expected"),
    [
        pytest.param(
            # (0, 0) + 2/3 (60, 30) = (60, -20) + 2/3 (-30, 60)
            [(0.0, 0.0), (60.0, 30.0), (60.0, -20.0), (30.0, 40.0)],
            [(0.0, 0.0), (40.0, 20.0), (30.0, 40.0)],
            id="lines that cross",
        ),
        pytest.param(
            [(0.0, 0.0), (100.0, 0.0), (100.0, 50.0), (40.0, 1.0)],
            [(0.0, 0.0), (40.0, 0.5), (40.0, 1.0)],
            id="the end is near the first line",
        ),
        pytest.param(
            [(0.0, 0.0), (100.0, 0.0), (100.0, 50.0), (40.0, 1.0), (30.0, 60.0)],
            [(0.0, 0.0), (40.0, 0.5), (30.0, 60.0)],
            id="a later corner is near the first line",
        ),
        pytest.param(
            [(0.0, 0.0), (-60.0, 10.0), (-60.0, -30.0), (1.0, -30.0), (1.0, 40.0)],
            [(0.0, 0.0), (0.5, 0.0), (1.0, 40.0)],
            id="the last line is near the start",
        ),
        pytest.param(
            [(-60.0, 10.0), (0.0, 0.0), (-60.0, -30.0), (1.0, -30.0), (1.0, 40.0)],
            [(-60.0, 10.0), (0.5, 0.0), (1.0, 40.0)],
            id="the last line is near an earlier corner",
        ),
        pytest.param(
            [(0.0, 0.0), (100.0, 0.0), (100.0, 50.0), (40.0, 1.99)],
            [(0.0, 0.0), (100.0, 0.0), (100.0, 50.0), (40.0, 1.99)],
            id="not within 0.99 SRTL_ACCURACY",
        ),
        pytest.param(
            [(0.0, 0.0), (80.0, 0.0), (80.0, 3.0), (10.0, 3.0)],
            [(0.0, 0.0), (80.0, 0.0), (80.0, 3.0), (10.0, 3.0)],
            id="back beside the way there",
        ),
        pytest.param(
            [(0.0, 0.0), (30.0, 30.0), (30.0, 10.0), (10.0, 30.0)],
            [(0.0, 0.0), (20.0, 20.0), (10.0, 30.0)],
            id="at right angles",
        ),
        pytest.param(
            # Two loops: each crosses the first line, the later one nearer to the start.
            [(0.0, 0.0), (90.0, 0.0), (90.0, 20.0), (60.0, 20.0), (60.0, -20.0), (30.0, -20.0), (30.0, 20.0)],
            [(0.0, 0.0), (30.0, 0.0), (30.0, 20.0)],
            id="two loops",
        ),
        pytest.param(
            [(0.0, 0.0), (50.0, 0.0), (50.0, 20.0), (30.0, 20.0), (30.0, -80.0), (60.0, -80.0), (20.0, -60.0)],
            [(0.0, 0.0), (30.0, 0.0), (30.0, -65.0), (20.0, -60.0)],
            id="a loop after another",
        ),
    ],
)
def test_a_path_returns_by_the_point_where_it_comes_near_itself(
    places: list[tuple[float, float]], expected: list[tuple[float, float]], swaps: bool, sign: float
) -> None:
    points = Steps(*(mirrored(place, swaps, sign) for place in places)).tidied()
    assert points == [pytest.approx(mirrored(place, swaps, sign), abs=1e-9) for place in expected]


def test_thinning_removes_points_up_to_the_distance() -> None:
    """The farthest point remains first, then those that are far from the two parts."""
    corner = [(0.0, 0.0), (5.0, 1.0), (10.0, 0.0)]
    assert thinned(corner, 1.0) == [corner[0], corner[2]]
    assert thinned(corner, 0.99) == corner
    # From (0, 0) to (10, 10), (10, 0) is 7 m off and (5, -1) lies 1 m off the line to it.
    wave = [(0.0, 0.0), (5.0, -1.0), (10.0, 0.0), (11.5, 5.0), (10.0, 10.0)]
    assert thinned(wave, 0.9) == wave
    assert thinned(wave, 1.2) == [wave[0], wave[2], wave[3], wave[4]]
    assert thinned(wave, 1.6) == [wave[0], wave[2], wave[4]]
    assert thinned(wave, 8.0) == [wave[0], wave[4]]
    # Beyond the end of the line, the distance counts to the end.
    assert thinned([(0.0, 0.0), (13.0, 0.0), (10.0, 0.0)], 2.9) == [(0.0, 0.0), (13.0, 0.0), (10.0, 0.0)]
    assert thinned([(0.0, 0.0), (-3.0, 0.0), (10.0, 0.0)], 2.9) == [(0.0, 0.0), (-3.0, 0.0), (10.0, 0.0)]
    assert thinned([(1.0, 2.0), (4.0, 6.0), (1.0, 2.0)], 4.9) == [(1.0, 2.0), (4.0, 6.0), (1.0, 2.0)]
    assert thinned([(1.0, 2.0), (4.0, 6.0), (1.0, 2.0)], 5.0) == [(1.0, 2.0), (1.0, 2.0)]


def test_a_position_is_stored_at_the_accuracy_from_the_last() -> None:
    steps = Steps((0.0, 0.0), (0.0, 1.9), (0.0, 2.0), (0.0, 3.9), (3.0, 2.0))
    assert steps.path.points == [(0.0, 0.0), (0.0, 2.0), (3.0, 2.0)]


def test_a_straight_way_is_thinned_at_each_fifty_new_positions() -> None:
    """ArduPilot's AP_SmartRTL.h: SMARTRTL_CLEANUP_POINT_TRIGGER 50."""
    way = [(2.0 * step, 0.0) for step in range(200)]
    steps = Steps(*way[:49])
    assert len(steps.path.points) == 49
    steps.go(way[49])
    assert steps.path.points == [way[0], way[49]]
    steps.go(*way[50:99])
    assert len(steps.path.points) == 51
    steps.go(way[99])
    assert steps.path.points == [way[0], way[49], way[99]]


def test_loops_are_removed_when_ten_positions_are_free() -> None:
    """ArduPilot's AP_SmartRTL.h: SMARTRTL_CLEANUP_START_MARGIN 10."""
    loop = [(0.0, 0.0), (30.0, 0.0), (30.0, 20.0), (15.0, 20.0), (15.0, -20.0)]
    # A staircase, whose corners remain
    stairs = [(21.0 + 6.0 * (step // 2), -20.0 - 6.0 * ((step + 1) // 2)) for step in range(20)]
    steps = Steps(*loop, *stairs[:15], SRTL_POINTS=30.0)
    assert steps.path.points == [*loop, *stairs[:15]]
    steps.go(stairs[15])
    assert steps.path.points == [(0.0, 0.0), (15.0, 0.0), (15.0, -20.0), *stairs[:16]]
    assert not steps.events.drain()


def test_a_path_with_few_free_positions_warns_every_ten_seconds() -> None:
    stairs = [(6.0 * (step // 2), 6.0 * ((step + 1) // 2)) for step in range(100)]
    steps = Steps(*stairs[:20], SRTL_POINTS=30.0)
    assert not steps.events.drain()
    warned = []
    for place in stairs[20:]:
        steps.go(place, each_ns=SECOND)
        warned += [(steps.now_ns // SECOND, event.severity, event.text) for event in steps.events.drain()]
    # 30 positions are stored at 30 s. After 15 s without room, the path is given up.
    assert warned == [
        (21, INFO, "SmartRTL Low on space!"),
        (31, INFO, "SmartRTL Low on space!"),
        (41, INFO, "SmartRTL Low on space!"),
        (46, WARNING, "SmartRTL deactivated: buffer full"),
    ]
    assert steps.path.points == []


@pytest.mark.parametrize(("late_ns", "problem"), [(15 * SECOND, ""), (15 * SECOND + 1, "bad position")])
def test_a_path_is_given_up_after_fifteen_seconds_without_a_position(late_ns: int, problem: str) -> None:
    """ArduPilot's AP_SmartRTL.h: SMARTRTL_TIMEOUT 15000 ms."""
    steps = Steps((0.0, 0.0), (5.0, 0.0), (5.5, 0.0))  # the last one is near, and counts as a position
    steps.path.update(FRAME, None, steps.now_ns + late_ns, True)
    assert steps.path.problem == problem


def test_a_parameter_that_permits_a_path_again_starts_it_at_the_next_position() -> None:
    steps = Steps((0.0, 0.0), (5.0, 0.0))
    steps.path.configure(Parameters({"SRTL_POINTS": 0.0}))
    steps.go((9.0, 0.0))
    assert (steps.path.points, steps.path.problem) == ([], "SRTL_POINTS is 0")
    steps.path.configure(Parameters({"SRTL_ACCURACY": 0.0}))
    steps.go((12.0, 0.0))
    assert (steps.path.points, steps.path.problem) == ([], "SRTL_POINTS is 0")
    steps.path.configure(Parameters({"SRTL_ACCURACY": 1.0, "SRTL_POINTS": 1.0}))
    steps.go((15.0, 0.0), (20.0, 0.0))
    assert (steps.path.points, steps.path.problem) == ([(15.0, 0.0)], "")


def test_after_the_path_was_followed_it_grows_from_the_position_reached() -> None:
    steps = Steps((0.0, 0.0), (30.0, 0.0), (30.0, 30.0))
    assert steps.tidied() == [(0.0, 0.0), (30.0, 0.0), (30.0, 30.0)]
    steps.path.points.pop()
    steps.path.leave()
    steps.go((34.0, 0.0), (34.0, -30.0), (10.0, -30.0), (10.0, 8.0))
    assert steps.tidied() == [pytest.approx(place, abs=1e-9) for place in [(0.0, 0.0), (10.0, 0.0), (10.0, 8.0)]]
