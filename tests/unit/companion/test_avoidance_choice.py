"""The avoidance planner against a second implementation, in complex numbers (north + i east), course by course."""

from __future__ import annotations

import cmath
import math
from itertools import pairwise
from types import SimpleNamespace
from typing import Any, NamedTuple, cast

import numpy as np
import pytest

from agent.companion.avoidance import (
    AROUND,
    FREE,
    STAY,
    AvoidancePlanner,
    Obstacles,
    PathLegs,
    clearance_m,
    crab_heading_rad,
    leg_course_rad,
    obstacles_near,
    simulate_courses,
)

S = 1_000_000_000
TICK_S = 0.4


def pair(place: complex) -> Any:
    return np.array((place.real, place.imag))


class Legs:
    """Straight legs between places."""

    def __init__(self, *places: complex) -> None:
        self.places = places
        self.way = [end - start for start, end in pairwise(places)]
        self.length_m = [abs(way) for way in self.way]
        self.unit = [way / abs(way) for way in self.way]
        self.planned = PathLegs(np.array([pair(place) for place in places]))

    def off(self, leg: int, place: complex) -> complex:
        """Distance along a leg, and to the right of it."""
        return (place - self.places[leg]) * self.unit[leg].conjugate()


class Sailed(NamedTuple):
    places: list[complex]
    progress_m: float
    off_m: float
    lee_m: float


def sail(
    legs: Legs, place: complex, vel: complex, bow_rad: float, held_rad: float, hold_s: float, asked_mps: float,
    horizon_s: float, current: complex,
) -> Sailed:  # fmt: skip
    """Turn at 1.2 /s of what is left, at most 22°/s; gain 0.6 and lose 0.9 m/s²; go slower in a turn."""
    course, speed, leg, last = cmath.phase(vel) if abs(vel) > 0.7 else bow_rad, abs(vel), 0, len(legs.way) - 1
    places, off_m, lee_m = [], 0.0, 0.0
    for tick in range(round(horizon_s / TICK_S)):
        if leg < last and legs.off(leg, place).real > legs.length_m[leg] - 3.0:
            leg += 1
        off, holds = legs.off(leg, place), tick * TICK_S < hold_s
        turn = math.remainder(
            (held_rad if holds else cmath.phase(legs.unit[leg]) - math.atan(off.imag / 6.0)) - course, math.tau
        )
        course += TICK_S * max(min(1.2 * turn, math.radians(22.0)), -math.radians(22.0))
        arrived = leg == last and off.real > legs.length_m[leg] - 1.0
        wanted = 0.0 if arrived and not holds else asked_mps * max(math.cos(turn), 0.25)
        speed += max(min(wanted - speed, 0.6 * TICK_S), -0.9 * TICK_S)
        place += speed * TICK_S * cmath.exp(1j * course)
        places.append(place)
        off_m += abs(off.imag)
        lee_m += max(off.imag * (current * legs.unit[leg].conjugate()).imag / max(abs(current), 0.3), 0.0)
    progress_m = sum(legs.length_m[:leg]) + min(legs.off(leg, place).real, legs.length_m[leg])
    return Sailed(places, progress_m, off_m / len(places), lee_m / len(places))


STRAIGHT, BENT = Legs(2 + 1j, 60 + 25j), Legs(-10 - 4j, 12 + 3j, 20 - 20j, 24 - 30j)


@pytest.mark.parametrize("legs", [STRAIGHT, BENT])
@pytest.mark.parametrize(
    ("vel", "current"), [(3 + 1j, 0j), (0.4 - 0.5j, -0.2 + 0.1j), (-2 + 2j, 0.6 + 0.5j), (0.5 + 0.6j, 0.1 - 0.9j)]
)
def test_courses_are_those_of_a_loop_over_one_vessel(legs: Legs, vel: complex, current: complex) -> None:
    rng = np.random.default_rng(8)
    held, hold = rng.uniform(-4.0, 4.0, 12), rng.choice((0.0, 1.6, 4.0, 30.0), 12)
    asked = rng.uniform(0.3, 4.0, 12)
    sailed = simulate_courses(legs.planned, pair(1 - 2j), pair(vel), 1.1, held, hold, asked, 22.0, pair(current))
    assert sailed.pos_ne_m.shape == (12, 55, 2)
    for number, choice in enumerate(zip(held, hold, asked, strict=True)):
        alone = sail(legs, 1 - 2j, vel, 1.1, *choice, 22.0, current)
        np.testing.assert_allclose(sailed.pos_ne_m[number] @ (1.0, 1j), alone.places, atol=1e-9)
        found = sailed.progress_m[number], sailed.off_m[number], sailed.lee_m[number]
        assert found == pytest.approx(alone[1:], abs=1e-9)
    still = simulate_courses(legs.planned, pair(1 - 2j), pair(vel), 1.1, held, hold, asked, 22.0)
    assert not still.lee_m.any()


def test_legs_of_no_length_are_left_out() -> None:
    """Unless there is no other: then the vessel has arrived."""
    legs = PathLegs(np.array([(0.0, 0.0), (0.05, 0.0), (0.05, 4.0), (0.05, 4.1), (3.05, 4.1)]))
    assert legs.length_m.tolist() == pytest.approx([4.0, 3.0])
    assert legs.before_m.tolist() == pytest.approx([0.0, 4.0])
    assert (legs.last, legs.total_m) == pytest.approx((1, 7.0))
    np.testing.assert_allclose(legs.start_m, [(0.05, 0.0), (0.05, 4.1)])
    np.testing.assert_allclose(legs.along, [(0.0, 1.0), (1.0, 0.0)], atol=1e-12)
    nowhere = PathLegs(np.array([(5.0, 5.0), (5.0, 5.0)]))
    assert (nowhere.length_m.tolist(), nowhere.along.tolist(), nowhere.last) == ([0.1], [[0.0, 0.0]], 0)


@pytest.mark.parametrize(("course_deg", "current"), [(0.0, (0.0, 1.0)), (130.0, (-0.6, 0.3)), (-75.0, (0.4, 0.9))])
def test_a_vessel_that_crabs_makes_its_course_good(course_deg: float, current: tuple[float, float]) -> None:
    course_rad = math.radians(course_deg)
    heading_rad = crab_heading_rad(course_rad, 2.0, np.array(current))
    through_water = cmath.rect(2.0, course_rad) - complex(*current)
    assert cmath.phase(through_water) == pytest.approx(heading_rad)
    assert cmath.rect(abs(through_water), heading_rad) + complex(*current) == pytest.approx(cmath.rect(2.0, course_rad))


@pytest.mark.parametrize("cross_m", [-8.0, 4.0])
def test_the_course_back_to_a_leg_aims_six_metres_ahead(cross_m: float) -> None:
    course_rad, found_m = leg_course_rad(Legs(12 + 6j, 12 + 40j, 90j).planned, pair(12 - cross_m + 9j))
    assert (course_rad, found_m) == pytest.approx((math.pi / 2 - math.atan(cross_m / 6.0), cross_m))


# -- clearances


class Box(NamedTuple):
    middle: complex
    vel: complex
    length_m: float
    width_m: float
    heading_rad: float

    def gap_m(self, place: complex, after_s: float) -> float:
        """Distance, negative inside, less the uncertainty of the drift."""
        off = (place - self.middle - self.vel * after_s) * cmath.rect(1.0, -self.heading_rad)
        ahead, right = abs(off.real) - self.length_m / 2, abs(off.imag) - self.width_m / 2
        outside = abs(complex(max(ahead, 0.0), max(right, 0.0)))
        return (outside if outside > 0.0 else max(ahead, right)) - 0.06 * after_s


class Scene(NamedTuple):
    boxes: list[Box]
    points: list[complex]

    @property
    def obstacles(self) -> Obstacles:
        rows = [
            (pair(box.middle), pair(box.vel), box.length_m / 2, box.width_m / 2, box.heading_rad) for box in self.boxes
        ]
        middle, vel, half_length_m, half_width_m, heading_rad = (
            np.array([row[column] for row in rows], dtype=float) for column in range(5)
        )
        points = np.array([pair(point) for point in self.points]).reshape(-1, 2)
        return Obstacles(middle.reshape(-1, 2), vel.reshape(-1, 2), half_length_m, half_width_m, heading_rad, points)

    def track_m(self, places: list[complex]) -> list[float]:
        return [
            min([1e3, *(box.gap_m(place, TICK_S * (number + 1)) for box in self.boxes)])
            for number, place in enumerate(places)
        ]

    def point_m(self, places: list[complex]) -> list[float]:
        return [min((abs(place - point) for point in self.points), default=1e3) for place in places]


def scene(seed: int) -> Scene:
    """Some boxes and points ahead, north of the origin."""
    rng = np.random.default_rng(seed)
    boxes = [
        Box(
            complex(rng.uniform(6.0, 32.0), rng.uniform(-7.0, 7.0)),
            complex(*rng.uniform(-0.8, 0.8, 2)),
            rng.uniform(0.5, 7.0),
            rng.uniform(0.5, 7.0),
            rng.uniform(-3.0, 3.0),
        )
        for _ in range(rng.integers(0, 4))
    ]
    points = [complex(rng.uniform(5.0, 40.0), rng.uniform(-14.0, 14.0)) for _ in range(rng.integers(0, 12))]
    return Scene(boxes, points)


def test_clearances_are_those_of_each_box_and_point() -> None:
    rng = np.random.default_rng(2)
    for seed in range(12):
        around = scene(seed)
        places = rng.uniform(-5.0, 40.0, (3, 20, 2)) - (0.0, 17.0)
        found = clearance_m(places, around.obstacles, 1.4)
        for row, along in zip(found, places @ (1.0, 1j), strict=True):
            nearest = np.minimum(around.track_m(along), around.point_m(along))
            np.testing.assert_allclose(row, nearest - 1.4, atol=1e-6)


def test_obstacles_near_are_boxes_that_grow_with_the_time_out_of_view() -> None:
    """0.15 m/s, 1.5 m at most. What may be hidden lies ahead of the middle, or astern of it."""

    def track(north_m: float, seen_s: float, hidden_m: float = 0.0) -> Any:
        place = np.array((north_m, 5.0))
        return SimpleNamespace(
            position_at=lambda now_ns: place + 1e-9 * now_ns * np.array((0.5, 0.0)),
            state=np.array((0.0, 0.0, 0.5, -0.1)), seen_ns=round(seen_s * 1e9),
            length_m=6.0, width_m=2.0, hidden_m=hidden_m, heading_rad=math.pi / 3,
        )  # fmt: skip

    tracks = [track(10.0, 16.0), track(20.0, 2.0, 4.0), track(30.0, 20.0, -4.0), track(51.0, 20.0), track(50.0, 20.0)]
    points = np.column_stack([np.linspace(0.0, 50.0, 1001), np.zeros(1001)])
    around = obstacles_near(20 * S, cast(Any, tracks), points, np.array((0.5, 5.0)))
    middles = [(20.0, 5.0), (31.0, 5.0 + math.sqrt(3.0)), (39.0, 5.0 - math.sqrt(3.0))]
    np.testing.assert_allclose(around.middle_ne_m, [*middles, (60.0, 5.0)])
    np.testing.assert_allclose(around.vel_ne_mps, [(0.5, -0.1)] * 4)
    assert around.half_length_m.tolist() == pytest.approx([3.6, 6.5, 5.0, 3.0])
    assert around.half_width_m.tolist() == pytest.approx([1.6, 2.5, 1.0, 1.0])
    assert around.heading_rad.tolist() == [math.pi / 3] * 4
    np.testing.assert_allclose(np.sort(around.points_ne_m[:, 0]), np.linspace(0.0, 50.0, 1001)[:400])
    few = obstacles_near(0, [], points[600:], np.zeros(2))
    np.testing.assert_array_equal(few.points_ne_m, points[600:][:400])
    assert (few.middle_ne_m.shape, few.vel_ne_mps.shape, few.half_length_m.shape) == ((0, 2), (0, 2), (0,))


# -- the planner

MARGIN_M, BEGIN_M, HORIZON_S, HULL_M, SPEED_MPS = 3.0, 1.8, 10.0, 1.4, 3.0
PLANNER = AvoidancePlanner(MARGIN_M, BEGIN_M, HORIZON_S, HULL_M)


def least_m(clear: list[float]) -> float:
    """The least of them. If the vessel begins within 3 m and comes no nearer, that after 2.4 s and that of the end."""
    if clear[0] < 3.0 and min(clear) >= clear[0] - 0.05:
        return min(clear[min(5, len(clear) - 1)], clear[-1])
    return min(clear)


def staying_m(place: complex, vel: complex, around: Scene) -> float:
    """Clearance of a vessel that brakes with 0.7 m/s²."""
    places = []
    for tick in range(round(HORIZON_S / TICK_S)):
        time_s = min((tick + 1) * TICK_S, abs(vel) / 0.7)
        places.append(place + (vel * time_s * (1.0 - 0.35 * time_s / abs(vel)) if vel else 0.0))
    clear = zip(around.track_m(places), around.point_m(places), strict=True)
    return least_m([min(each) - HULL_M for each in clear])


def choice(
    legs: Legs, place: complex, vel: complex, bow_rad: float, around: Scene, last_rad: float | None, stays: bool,
    current: complex,
) -> tuple[int, float, float, float]:  # fmt: skip
    leg_rad, ahead_s = cmath.phase(legs.unit[0]), 1.5 * HORIZON_S
    candidates = [(0.0, 0.0, SPEED_MPS), (0.0, 0.0, 0.45 * SPEED_MPS)] + [
        (leg_rad + math.radians(degrees), hold_s, share * SPEED_MPS)
        for degrees in range(-120, 121, 10)
        for hold_s in (1.6, 3.2, 6.0, 10.0)
        for share in (1.0, 0.45)
    ]
    held, hold_s, speed_mps = (np.array(column) for column in zip(*candidates, strict=True))
    sailed = simulate_courses(
        legs.planned, pair(place), pair(vel), bow_rad, held, hold_s, speed_mps, ahead_s, pair(current)
    )
    none = Scene([], around.points).obstacles
    standing = np.repeat(clearance_m(sailed.pos_ne_m[:, ::2], none, HULL_M), 2, axis=1)
    standing = standing[:, : sailed.pos_ne_m.shape[1]]
    moving = clearance_m(sailed.pos_ne_m, Scene(around.boxes, []).obstacles, HULL_M)
    clear = np.minimum(standing, moving)
    costs, least = [], [least_m(row.tolist()) for row in clear]
    to_structure_m = standing.min(axis=1)
    for number, (course_rad, held_s, _) in enumerate(candidates):
        short_m = max(MARGIN_M - least[number], 0.0)
        cost = (
            max(sailed.progress_m) - sailed.progress_m[number] + 1.5 * sailed.off_m[number] + 6.0 * sailed.lee_m[number]
        )
        cost += 4.0 * short_m + 6.0 * short_m**2 + 1000.0 * (least[number] < 0.8)
        if abs(current) > 0.2:
            cost += 2.0 * max(min(2.0 * MARGIN_M, to_structure_m[0]) - to_structure_m[number], 0.0)
        if held_s:
            turn = 0.0 if last_rad is None else abs(math.remainder(course_rad - last_rad, math.tau))
            cost += 1.0 + 1.5 * min(turn, 1.5)
        costs.append(cost)
    best = costs.index(min(costs))
    at_m, stay_m = legs.off(0, place).real, staying_m(place, vel, around)
    gain_m = min((0.45 if stays else 0.3) * SPEED_MPS * ahead_s, 0.5 * (sum(legs.length_m) - at_m))
    if sailed.progress_m[best] - at_m < gain_m and stay_m > MARGIN_M / 2:
        return STAY, bow_rad, 0.0, stay_m
    if least[best] < 0.8:
        if stay_m > least[best]:
            return STAY, bow_rad, 0.0, stay_m
        best = least.index(max(least))
    return (FREE if best < 2 else AROUND), candidates[best][0], candidates[best][2], least[best]


@pytest.mark.medium
@pytest.mark.parametrize("block", range(3))
def test_the_choice_is_that_of_the_second_implementation(block: int) -> None:
    kinds = set()
    for seed in range(30 * block, 30 * block + 30):
        rng = np.random.default_rng(seed)
        around = scene(seed)
        if seed % 5 == 0:  # a wall close by
            wall_m = rng.uniform(3.0, 16.0)
            around.points.extend(complex(wall_m, east) for east in np.arange(-20.0, 20.0, 0.9))
        legs = (Legs(-3 + 0j, 50 + 3j), Legs(-3 + 1j, 20 - 2j, 24 + 20j), Legs(-1 + 0j, 9 + 0j))[seed % 3]
        vel = complex(*rng.uniform(-0.3, 3.0, 2)) if seed % 4 else 0j
        bow_rad, current = rng.uniform(-1.5, 1.5), complex(*rng.uniform(-0.6, 0.6, 2)) * (seed % 7 > 1)
        last_rad = rng.uniform(-2.0, 2.0) if seed % 2 else None
        stays = seed % 8 < 4
        found = PLANNER.choose_course(
            legs.planned, np.zeros(2), pair(vel), bow_rad, SPEED_MPS, around.obstacles, last_rad, stays, pair(current)
        )
        wanted = choice(legs, 0j, vel, bow_rad, around, last_rad, stays, current)
        assert found == pytest.approx(wanted, abs=1e-6), seed
        kinds.add(found.kind)
    assert kinds == {FREE, AROUND, STAY}


def test_a_path_is_blocked_when_its_clearance_is_too_small() -> None:
    seen = set()
    for seed in range(40):
        around, vel, bow_rad = scene(seed), complex(2.0, 0.1 * (seed % 7)), 0.2
        legs = Legs(0j, complex(60.0, seed % 11 - 5))
        alone = sail(legs, 0j, vel, bow_rad, 0.0, 0.0, SPEED_MPS, HORIZON_S, 0j)
        near = zip(around.track_m(alone.places), around.point_m(alone.places), strict=True)
        clear = [min(each) - HULL_M for each in near]
        first = next((number for number, gap_m in enumerate(clear) if gap_m < BEGIN_M), len(clear) - 1)
        found = PLANNER.check_collision(legs.planned, np.zeros(2), pair(vel), bow_rad, SPEED_MPS, around.obstacles)
        assert found.clearance_m == pytest.approx(least_m(clear), abs=1e-6)
        assert found.blocked == (least_m(clear) < BEGIN_M)
        assert found.after_s == pytest.approx(TICK_S * (first + 1))
        seen.add(found.blocked)
    assert seen == {True, False}


def test_the_waiting_position_is_up_the_current_where_there_is_room() -> None:
    """Places up the current, reached at 1.2 m/s; the margin from what drifts, and twice the margin from structure."""
    chosen = set()
    for seed in range(60):
        rng = np.random.default_rng(seed)
        around, vel = scene(seed), complex(*rng.uniform(0.0, 3.0, 2))
        current = cmath.rect((0.09, 0.11, 0.6)[seed % 3], rng.uniform(-3.0, 3.0))
        rest = vel * abs(vel) / 1.4
        places, room_m = [], []
        for retreat_m in (0.0, 2.0, 4.0, 6.0, 9.0, 12.0, 16.0):
            end = rest - retreat_m * current / abs(current)
            ticks = range(1, round(HORIZON_S / TICK_S) + 1)
            way = [end * min(1.2 * TICK_S * tick / max(abs(end), 0.1), 1.0) for tick in ticks]
            structure_m = around.point_m([end])[0] - 2.0 * MARGIN_M
            places.append(end)
            room_m.append(least_m([min(gap - MARGIN_M, structure_m) - HULL_M for gap in around.track_m(way)]))
        good = [place for place, gap_m in zip(places, room_m, strict=True) if gap_m > 0.0]
        wanted = rest if abs(current) < 0.1 else (good or [places[room_m.index(max(room_m))]])[0]
        found = PLANNER.waiting_position(np.zeros(2), pair(vel), around.obstacles, pair(current))
        assert found @ (1.0, 1j) == pytest.approx(wanted, abs=1e-6), seed
        chosen.add(round(abs(wanted - rest)))
    assert len(chosen) >= 5


@pytest.mark.parametrize(
    ("ahead_m", "beside_m", "horizon_s", "judged"),
    [
        (1.88, 3.4, 10.0, 5),  # 2.05 m, then 0.03 m less, then it opens
        (2.00, 3.4, 10.0, 1),  # 0.07 m less
        (1.0, 4.30, 10.0, 5),
        (1.0, 4.45, 10.0, 0),  # it begins at more than 3 m
        (1.88, 3.4, 2.0, 4),
    ],
)
def test_a_path_that_begins_close_and_opens_is_judged_by_its_later_clearance(
    ahead_m: float, beside_m: float, horizon_s: float, judged: int
) -> None:
    """At 3 m/s to the north, past a point beside the path. Places are 1.2 m apart."""
    point = Scene([], [complex(ahead_m, beside_m)])
    places = [complex(1.2 * (number + 1), 0.0) for number in range(round(horizon_s / TICK_S))]
    clear = [gap_m - HULL_M for gap_m in point.point_m(places)]
    planner = AvoidancePlanner(MARGIN_M, BEGIN_M, horizon_s, HULL_M)
    legs = Legs(0j, 90 + 0j).planned
    found = planner.check_collision(legs, np.zeros(2), pair(3 + 0j), 0.0, SPEED_MPS, point.obstacles)
    assert found.clearance_m == pytest.approx(clear[judged], abs=1e-9)
