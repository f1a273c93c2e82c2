"""The rosette against its closed form: where it looks, how dense it is, and how much it has seen after a time."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from sim_core.sensors.lidar import MID_70_TURNS_HZ, Rosette

HOUR = 3600 * 100_000


def angle_off(looking: np.ndarray) -> np.ndarray:
    """From the axis, without the loss of an arc cosine near 1."""
    return np.arctan2(np.hypot(looking[1], looking[2]), looking[0])


@pytest.mark.parametrize("first", [0, 12_345, 10 * HOUR + 7])
def test_it_looks_where_two_prisms_turn_it(first: int) -> None:
    looking = Rosette(100_000.0).directions(first, 2000).astype(float)
    np.testing.assert_allclose(np.linalg.norm(looking, axis=0), 1.0, atol=3e-7)
    for point in (0, 1, 777, 1999):
        # Whole turns off by integers: 10 h are 3.6e9 points, and each advances 121567 and -77733 of 1e8 of a turn.
        a, b = (2.0 * math.pi * ((first + point) * turns % 10**8) / 10**8 for turns in (121_567, -77_733))
        right = math.radians(17.6) * (math.cos(a) + math.cos(b))
        down = math.radians(17.6) * (math.sin(a) + math.sin(b))
        off = math.hypot(right, down)
        wanted = (math.cos(off), math.sin(off) * right / off, math.sin(off) * down / off)
        # Angles within a call reach 16 rad in single precision: 1e-6 rad; the fraction of a turn after 10 h: 1e-9.
        np.testing.assert_allclose(looking[:, point], wanted, atol=4e-6)


def test_the_view_is_round_and_as_wide_as_the_maker_says() -> None:
    off = angle_off(Rosette(100_000.0).directions(0, 200_000).astype(float))
    assert math.degrees(off.max()) == pytest.approx(70.4 / 2, abs=0.01)
    assert Rosette(100_000.0).half_view_rad == pytest.approx(math.radians(35.2))


def test_density_from_the_axis_is_that_of_two_even_turns() -> None:
    """|d1 + d2| = 2 d |cos(phi / 2)| with phi even over a turn: P(off < r) = 1 - 2/pi acos(r / 2 d)."""
    rosette = Rosette(100_000.0)
    off = angle_off(rosette.directions(0, 1_000_000).astype(float))
    for share in (0.1, 0.3, 0.5, 0.7, 0.9, 0.99):
        inside = np.mean(off < share * rosette.half_view_rad)
        # phi turns through 1993 circles in these 10 s: the end effect is a part of one, 1/1993.
        assert inside == pytest.approx(1.0 - 2.0 / math.pi * math.acos(share), abs=1e-3)


def test_it_sees_more_of_the_view_the_longer_it_looks() -> None:
    """A pattern that repeats every frame stays where it was after the first; this one has no frame like another.

    In a second the prisms pass any place's half degree often enough for nine tenths, in four for all of it.
    """
    rosette = Rosette(100_000.0)
    seen = []
    for points in (10_000, 20_000, 30_000, 50_000, 100_000, 400_000):
        looking = rosette.directions(0, points).astype(float)
        spread = angle_off(looking) / np.maximum(np.hypot(looking[1], looking[2]), 1e-12)
        seen.append(covered(looking[1:] * spread))
    assert all(later > earlier * 1.05 for earlier, later in pairwise(seen))
    # A line meets no more cells than a band of their diagonal's width along it has room for.
    across_rad = np.linalg.norm(np.diff(looking[1:, :10_000] * spread[:10_000], axis=1), axis=0).sum()
    assert seen[0] < across_rad * math.radians(0.5) * math.sqrt(2.0) / (math.pi * math.radians(35.2) ** 2)
    assert seen[0] > 0.15
    assert seen[-2] > 0.9
    assert seen[-1] > 0.999


def covered(across_rad: np.ndarray) -> float:
    """Share of the cells of 0.5 degrees in the view that hold a point; across_rad (2, n)."""
    half = math.radians(35.2)
    edges = np.arange(-half, half + math.radians(0.5), math.radians(0.5))
    count, _, _ = np.histogram2d(*across_rad, bins=[edges, edges])
    middle = 0.5 * (edges[1:] + edges[:-1])
    inside = np.hypot(*np.meshgrid(middle, middle)) < half - math.radians(0.5)
    return float(np.mean(count[inside] > 0))


def test_the_pattern_of_one_frame_is_not_that_of_the_next() -> None:
    one, next_one = (Rosette(100_000.0).directions(first, 10_000) for first in (0, 10_000))
    assert np.abs(one - next_one).max() > 0.1
    assert all(turns * 0.1 % 1.0 > 0.05 for turns in MID_70_TURNS_HZ)


def test_a_rate_that_cannot_be_is_refused() -> None:
    with pytest.raises(ValueError, match=r"lidar\.points_hz = 0 must be a positive number"):
        Rosette(points_hz=0)
