"""Measures on tracks whose answers are known beforehand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from xitl_cli.plugins.studies.manoeuvres.measures import (
    Stop,
    decay,
    radius_of_95_percent,
    response,
    spiral,
    stopping,
    time_to_95_percent,
    turning_circle,
    zig_zag,
)

TIME_S = np.arange(0.0, 60.0, 0.05)


@pytest.mark.parametrize(("side", "course"), [(1.0, 0.0), (-1.0, 0.0), (1.0, 2.5)])
def test_a_circle(side: float, course: float) -> None:
    """10 m of straight way at 2 m/s, then at once a circle of 8 m radius, with 5 degrees of drift inward."""
    radius, speed, straight = 8.0, 2.0, 10.0
    turned = np.maximum(TIME_S - straight / speed, 0.0) * speed / radius
    ahead = np.where(turned > 0, straight + radius * np.sin(turned), speed * TIME_S)
    aside = radius * (1 - np.cos(turned)) * side
    north = 100 + ahead * math.cos(course) - aside * math.sin(course)
    east = -40 + ahead * math.sin(course) + aside * math.cos(course)
    drift = math.radians(5)
    velocity = speed * np.tile([math.cos(drift), -side * math.sin(drift)], (len(TIME_S), 1))
    found = turning_circle(TIME_S, north, east, course + side * turned, velocity)
    assert found.advance_m == pytest.approx(straight + radius, rel=1e-3)
    assert found.transfer_m == pytest.approx(radius, rel=1e-2)  # the heading between two samples
    assert found.tactical_diameter_m == pytest.approx(2 * radius, rel=1e-3)
    assert found.steady_diameter_m == pytest.approx(2 * radius, rel=1e-6)
    assert found.rate_radps == pytest.approx(side * speed / radius)
    assert found.drift_rad == pytest.approx(drift)


def test_a_turn_that_is_not_completed() -> None:
    yaw = 0.02 * TIME_S
    velocity = np.tile([1.0, 0.0], (len(TIME_S), 1))
    found = turning_circle(TIME_S, np.sin(yaw) / 0.02, (1 - np.cos(yaw)) / 0.02, yaw, velocity)
    assert found.advance_m is None
    assert found.tactical_diameter_m is None
    assert found.steady_diameter_m == pytest.approx(100.0)


def test_a_zig_zag_of_a_sine() -> None:
    """Heading 14 sin(2 pi t / 12) degrees, reversed at 10: overshoots of 4, reversals half a period apart."""
    yaw = 1.0 + np.radians(14) * np.sin(2 * np.pi * TIME_S / 12)
    steering, order = np.empty_like(TIME_S), 1.0
    for sample, heading in enumerate(np.degrees(yaw - 1.0)):
        if order * heading >= 10:
            order = -order
        steering[sample] = 10 * order
    found = zig_zag(TIME_S, yaw, np.full_like(TIME_S, 3.0), steering)
    assert np.degrees(found.overshoot_rad[:4]) == pytest.approx([4.0] * 4, abs=0.4)  # a sample is 0.37 degrees
    first = 12 * math.asin(10 / 14) / (2 * math.pi)
    assert found.initial_turn_s == pytest.approx(first, abs=0.05)
    assert found.initial_turn_m == pytest.approx(3 * first, abs=0.15)
    assert found.period_s == pytest.approx(12.0, abs=0.06)


def test_the_period_of_a_zig_zag_leaves_out_its_first_swing() -> None:
    steering = np.repeat([10.0, -10.0, 10.0, -10.0, 10.0], (100, 150, 170, 190, 590))
    assert zig_zag(TIME_S, np.sin(TIME_S), 0 * TIME_S, steering).period_s == pytest.approx(0.05 * (170 + 190))


def test_a_zig_zag_that_never_turns() -> None:
    with pytest.raises(ValueError, match="not reached"):
        zig_zag(TIME_S, 0 * TIME_S, 1 + 0 * TIME_S, 10 + 0 * TIME_S)


def test_a_spiral_of_a_lag() -> None:
    """A first-order lag of 1 s behind 2 degrees per second a degree, held 10 s each."""
    steering = np.repeat([10.0, 0.0, -10.0], 200)
    time_s = 0.05 * np.arange(600)
    rate = np.empty(600)
    now = 0.0
    for sample, angle in enumerate(steering):
        now += 0.05 * (2 * angle - now)
        rate[sample] = now
    assert [angle for angle, _ in spiral(time_s, rate, steering)] == [10.0, 0.0, -10.0]
    assert [found for _, found in spiral(time_s, rate, steering)] == pytest.approx([20.0, 0.0, -20.0], abs=0.02)


def test_a_stop_at_constant_deceleration() -> None:
    """From 3 m/s by 0.5 m/s2: 6 s and 9 m, on course 30 degrees."""
    ahead = 3 - 0.5 * TIME_S
    way = 3 * TIME_S - 0.25 * TIME_S**2
    course = math.radians(30)
    found = stopping(TIME_S, way * math.cos(course), way * math.sin(course), ahead)
    assert (found.time_s, found.track_reach_m) == pytest.approx((6.0, 9.0), rel=1e-6)
    half = stopping(TIME_S, way, 0 * way, ahead, left=0.5)
    assert half.time_s == pytest.approx(3.0)
    assert stopping(TIME_S, way, 0 * way, 1 + 0 * way) == Stop(None, None)


def test_time_to_a_share_of_an_exponential() -> None:
    found = time_to_95_percent(TIME_S, 2 * (1 - np.exp(-TIME_S / 4)), 2.0)
    assert found == pytest.approx(4 * math.log(20), abs=1e-3)


@pytest.mark.parametrize("ratio", [0.02, 0.1, 0.3, 0.5])
def test_a_decay(ratio: float) -> None:
    natural = 2 * math.pi / 1.7
    time_s = np.arange(0.0, 25.0, 0.01)
    damped = natural * math.sqrt(1 - ratio**2)
    swing = np.cos(damped * time_s) + ratio / math.sqrt(1 - ratio**2) * np.sin(damped * time_s)
    found = decay(time_s, 0.1 * swing * np.exp(-ratio * natural * time_s))
    assert found is not None
    assert found.period_s == pytest.approx(1.7, rel=2e-3)
    assert found.damping_ratio == pytest.approx(ratio, rel=5e-3)


def test_a_decay_that_creeps() -> None:
    assert decay(TIME_S, np.exp(-TIME_S)) is None


def test_a_response_to_two_waves() -> None:
    phase = np.column_stack([1.3 * TIME_S + 0.2, 2.1 * TIME_S - 1.0])
    wanted = np.array([0.4 * np.exp(0.7j), 0.1 * np.exp(-2j)])
    values = 5 + (wanted * np.exp(1j * phase)).real.sum(axis=1)
    assert response(phase, values) == pytest.approx(wanted)


def test_the_radius_for_a_share_of_the_time() -> None:
    away = np.linspace(0.0, 10.0, 1001)
    assert radius_of_95_percent(3 + 0 * away, 4 + away, (3.0, 4.0)) == pytest.approx(9.5)


def test_a_turn_in_few_samples_counts_from_its_first_heading() -> None:
    """0.1 rad from one sample to the next on a circle of 8 m, begun at once on course 0.4 rad."""
    turned = 0.1 * np.arange(80)
    ahead, aside = 8.0 * np.sin(turned), 8.0 * (1.0 - np.cos(turned))
    north = ahead * math.cos(0.4) - aside * math.sin(0.4)
    east = ahead * math.sin(0.4) + aside * math.cos(0.4)
    found = turning_circle(np.arange(80.0), north, east, 0.4 + turned, np.tile([0.8, 0.0], (80, 1)))
    assert (found.advance_m, found.transfer_m) == pytest.approx((8.0, 8.0), rel=2e-3)
    assert found.tactical_diameter_m == pytest.approx(16.0, rel=2e-3)
    assert found.steady_diameter_m == pytest.approx(16.0)
    assert found.speed_mps == pytest.approx(0.8)


def test_what_is_steady_is_the_last_quarter() -> None:
    """Slower and with another rate of turn in the last 20 of 80 s, and with a drift outward."""
    time_s = np.arange(81.0)
    late = time_s >= 60.0
    yaw = np.where(late, 60.0 * 0.1 + (time_s - 60.0) * 0.2, 0.1 * time_s)
    velocity = np.where(late[:, None], [[0.3, 0.4]], [[2.0, 0.0]])
    found = turning_circle(time_s, 0.0 * time_s, 0.0 * time_s, yaw, velocity)
    assert (found.rate_radps, found.speed_mps) == pytest.approx((0.2, 0.5))
    assert found.steady_diameter_m == pytest.approx(5.0)
    assert found.drift_rad == pytest.approx(-math.atan2(0.4, 0.3))


def test_a_straight_course_has_no_diameter() -> None:
    still = turning_circle(TIME_S, TIME_S, 0 * TIME_S, 0 * TIME_S, np.tile([1.0, 0.0], (len(TIME_S), 1)))
    assert still.steady_diameter_m == math.inf
    assert (still.rate_radps, still.advance_m) == (0.0, None)


def test_the_spiral_takes_the_last_quarter_of_each_hold() -> None:
    steering = np.repeat([10.0, -10.0, 5.0], (8, 12, 3))
    rate = np.concatenate([[9.0] * 6, [1.0, 3.0], [9.0] * 9, [4.0, 5.0, 6.0], [9.0, 9.0, 7.0]])
    assert spiral(np.arange(23.0), rate, steering) == [(10.0, 2.0), (-10.0, 5.0), (5.0, 7.0)]


def test_the_order_of_a_stop_is_at_the_first_sample() -> None:
    """1 m/s less in each second: to a quarter of 4 m/s after 3 s, on a way with a bend."""
    north, east = np.array([0.0, 3.0, 3.0, 5.0, 5.0]), np.array([0.0, 0.0, 4.0, 4.0, 4.5])
    found = stopping(np.arange(10.0, 15.0), north, east, np.array([4.0, 3.0, 2.0, 1.0, 0.0]), left=0.25)
    assert (found.time_s, found.track_reach_m) == pytest.approx((3.0, 9.0))
    assert stopping(np.arange(10.0, 15.0), north, east, -np.ones(5)) == Stop(0.0, 0.0)


def test_the_overshoot_of_a_swing_that_has_not_returned_is_left_out() -> None:
    heading = np.radians([0.0, 5.0, 10.0, 13.0, 11.0, 0.0, -10.0, -12.0, -14.0])
    steering = np.array([10.0, 10.0, -10.0, -10.0, -10.0, -10.0, 10.0, 10.0, 10.0])
    found = zig_zag(np.arange(9.0), 0.7 + heading, np.full(9, 2.0), steering)
    assert np.degrees(found.overshoot_rad) == pytest.approx([3.0])
    assert (found.initial_turn_s, found.initial_turn_m, found.period_s) == (2.0, pytest.approx(4.0), None)
