"""Instants of a JSON world's frames, and the true motion between the host's."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.bridges.json_world import FrameTimes, MotionInterpolator, TruthSample, truth_sample_from
from agent.wire import dialect as mav


def its_clock(clock_us: int, last_s: float, told_s: float) -> int:
    """A step in whole microseconds, what is over is cut off; the text has nine digits."""
    return int(clock_us + (told_s - last_s) * 1e6)


@pytest.mark.medium
@settings(max_examples=25, deadline=None)
@given(rate_hz=st.integers(11, 20_000), start_us=st.sampled_from([0, 10_000, 3_600_000_000]))
def test_its_clock_keeps_to_ours(rate_hz: int, start_us: int) -> None:
    times = FrameTimes(start_us)
    times.set_rate(rate_hz)
    frames = times.next_frames(start_us + 2_000_000, 100_000)
    assert len(frames) == 2 * rate_hz
    assert frames[-1][0] == start_us + 2_000_000
    clock_us, last_s = start_us, start_us * 1e-6
    for at_us, told_s in frames:
        told_s = float(f"{told_s:.9f}")
        clock_us, last_s = its_clock(clock_us, last_s, told_s), told_s
        assert clock_us == at_us


def test_at_most_so_many_and_on_from_there() -> None:
    times = FrameTimes(0)
    times.set_rate(1000)
    first, rest = times.next_frames(10_000, 4), times.next_frames(10_000, 100)
    assert [at_us for at_us, _ in first + rest] == list(range(1000, 11_000, 1000))
    assert times.next_frames(10_000, 100) == []


def test_a_new_rate_counts_from_the_last_frame() -> None:
    times = FrameTimes(0)
    times.set_rate(1000)
    times.next_frames(2000, 100)
    times.set_rate(400)
    assert [at_us for at_us, _ in times.next_frames(8000, 100)] == [4500, 7000]
    assert times.last_us == 7000


def test_slower_than_the_exchanges() -> None:
    times = FrameTimes(0)
    times.set_rate(50)
    assert [len(times.next_frames(end_us, 10)) for end_us in (10_000, 20_000, 30_000, 40_000)] == [0, 1, 0, 1]


@pytest.mark.medium
def test_what_it_is_told_stays_near() -> None:
    times = FrameTimes(0)
    times.set_rate(1200)
    at_us, told_s = times.next_frames(600_000_000, 10_000_000)[-1]
    assert told_s == pytest.approx(at_us * 1e-6, abs=1e-3)


LEVEL = (1.0, 0.0, 0.0, 0.0)


def truth(
    stamp_us: int,
    pos: tuple[float, float, float] = (0.0, 0.0, 0.0),
    vel: tuple[float, float, float] = (0.0, 0.0, 0.0),
    quat: tuple[float, float, float, float] = LEVEL,
) -> TruthSample:
    return TruthSample(stamp_us, pos, vel, quat, (0.0, 0.0, 0.0))


def message(**changes: Any) -> Any:
    fields = {
        "time_usec": 5,
        "pos_ned": [1, 2, 3],
        "vel_ned": [4, 5, 6],
        "quat": [1, 0, 0, 0],
        "gyro": [7, 8, 9],
        "wind_speed": -1,
        "wind_direction": 0,
    }
    return mav.MAVLink_xitl_truth_message(**{**fields, **changes})


def test_a_cubic_motion_is_met_exactly() -> None:
    """Constant jerk: position t^3, velocity 3 t^2; the line of the velocity is off by 3 t (1 - t)."""
    path = MotionInterpolator(truth(0), truth(1_000_000, (1.0, 0.0, 0.0), (3.0, 0.0, 0.0)))
    for at_us in (0, 250_000, 500_000, 999_999, 1_000_000):
        t = at_us * 1e-6
        motion = path.motion_at(at_us)
        assert motion[0] == pytest.approx(t**3, abs=1e-12)
        assert motion[7] == pytest.approx(3 * t, abs=1e-12)


def test_attitude_takes_the_short_way_round() -> None:
    half = math.radians(10) / 2
    turned = (-math.cos(half), 0.0, 0.0, -math.sin(half))
    middle = MotionInterpolator(truth(0), truth(10_000, quat=turned)).motion_at(5000)
    assert middle[3:7] == pytest.approx((math.cos(half / 2), 0.0, 0.0, math.sin(half / 2)))


def test_behind_the_end_it_goes_straight_on() -> None:
    path = MotionInterpolator(truth(0), truth(100_000, (5.0, 0.0, 0.0), (2.0, -1.0, 0.0)))
    assert path.motion_at(600_000)[:3] == pytest.approx((6.0, -0.5, 0.0))
    assert path.motion_at(600_000)[7:] == (2.0, -1.0, 0.0)


def test_before_the_start_it_is_the_start() -> None:
    path = MotionInterpolator(
        truth(100_000, (5.0, 0.0, 0.0), (2.0, 0.0, 0.0)), truth(200_000, (5.2, 0.0, 0.0), (2.0, 0.0, 0.0))
    )
    assert path.motion_at(0)[:3] == (5.0, 0.0, 0.0)


@pytest.mark.parametrize("second_us", [1000, 500])
def test_no_time_between_them(second_us: int) -> None:
    path = MotionInterpolator(truth(1000), truth(second_us, (1.0, 0.0, 0.0), (2.0, 0.0, 0.0)))
    assert path.motion_at(second_us)[:3] == (1.0, 0.0, 0.0)


def test_specific_force_at_rest_and_on_a_heeled_start() -> None:
    assert MotionInterpolator(truth(0), truth(0)).specific_force_frd_mps2() == pytest.approx((0.0, 0.0, -9.80665))
    half = math.radians(90) / 2
    on_the_side = (math.cos(half), math.sin(half), 0.0, 0.0)  # rolled to starboard: up is to port
    path = MotionInterpolator(truth(0), truth(100_000, vel=(0.3, 0.0, 0.0), quat=on_the_side))
    assert path.specific_force_frd_mps2() == pytest.approx((3.0, -9.80665, 0.0), abs=1e-9)


def test_a_message() -> None:
    assert truth_sample_from(message()) == TruthSample(5, (1, 2, 3), (4, 5, 6), LEVEL, (7, 8, 9))
    doubled = truth_sample_from(message(quat=[2, 0, 0, 0]))
    assert doubled is not None
    assert doubled.quat_ned_frd == LEVEL


@pytest.mark.parametrize(
    "changes",
    [
        {"pos_ned": [math.nan, 0, 0]},
        {"vel_ned": [0, math.inf, 0]},
        {"gyro": [0, 0, -math.inf]},
        {"quat": [0, 0, 0, 0]},
        {"quat": [math.nan, 0, 0, 0]},
    ],
)
def test_no_motion(changes: dict[str, Any]) -> None:
    assert truth_sample_from(message(**changes)) is None
