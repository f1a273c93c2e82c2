"""The motion between two truths."""

from __future__ import annotations

import math
from typing import Any

import pytest

from agent.bridges.json_world import MotionInterpolator, TruthSample, truth_sample_from
from agent.wire import dialect as mav

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
