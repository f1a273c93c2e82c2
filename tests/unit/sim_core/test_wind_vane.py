"""Apparent wind against the wind triangle, the lag against its exponential, noise as configured."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from motion import at_rest, swinging

from sim_core.sensors.spec import WindVaneSpec
from sim_core.sensors.wind_vane import WindVane, WindVaneState

RNG = np.random.default_rng(1)


def air(north: float, east: float, vessels: int = 1) -> np.ndarray:
    return np.tile([[north, east, 0.0]], (vessels, 1))


def test_at_rest_it_says_where_the_wind_comes_from() -> None:
    """Wind from the west (air goes east) on a bow to the north comes from port: -90 degrees."""
    _, sample = WindVane(WindVaneSpec()).measure(WindVaneState(), at_rest(), air(0.0, 5.0), RNG)
    assert sample.speed_mps[0] == pytest.approx(5.0)
    assert sample.direction_rad[0] == pytest.approx(-math.pi / 2)


def test_under_way_in_still_air_it_blows_from_ahead() -> None:
    truth = replace(
        at_rest(euler_rad=(0.0, 0.0, 1.0)), vel_ned_mps=3.0 * np.array([[math.cos(1.0), math.sin(1.0), 0.0]])
    )
    _, sample = WindVane(WindVaneSpec()).measure(WindVaneState(), truth, air(0.0, 0.0), RNG)
    assert sample.speed_mps[0] == pytest.approx(3.0)
    assert sample.direction_rad[0] == pytest.approx(0.0, abs=1e-12)


def test_the_wind_triangle() -> None:
    """3 m/s to the north, 4 m/s of wind from the east: 5 m/s from atan2(4, 3) to starboard."""
    truth = replace(at_rest(), vel_ned_mps=np.array([[3.0, 0.0, 0.0]]))
    _, sample = WindVane(WindVaneSpec()).measure(WindVaneState(), truth, air(0.0, -4.0), RNG)
    assert sample.speed_mps[0] == pytest.approx(5.0)
    assert sample.direction_rad[0] == pytest.approx(math.atan2(4.0, 3.0))


def test_a_mast_that_swings_feels_its_own_motion() -> None:
    """Velocity of the mast's top by differences of its place in NED, 1 ms to either side."""
    mast, half = (0.2, -0.1, -2.0), 1e-3

    def top(time_s: float) -> np.ndarray:
        truth = swinging(time_s)
        return truth.pos_ned_m[0] + truth.rot_ned_frd[0] @ mast

    truth = swinging(3.0)
    velocity = (top(3.0 + half) - top(3.0 - half)) / (2 * half)
    past = truth.rot_ned_frd[0].T @ (np.array([2.0, -3.0, 0.0]) - velocity)
    _, sample = WindVane(WindVaneSpec(position_frd_m=mast)).measure(WindVaneState(), truth, air(2.0, -3.0), RNG)
    assert sample.speed_mps[0] == pytest.approx(math.hypot(past[0], past[1]), rel=1e-5)
    assert sample.direction_rad[0] == pytest.approx(math.atan2(-past[1], -past[0]), abs=1e-5)


def test_it_follows_a_gust_with_its_time_constant() -> None:
    """From 2 to 6 m/s: 63 % of the way after one time constant, exactly, whatever the rate."""
    vane = WindVane(WindVaneSpec(rate_hz=10.0, response_s=1.0))
    state, _ = vane.measure(WindVaneState(), at_rest(), air(-2.0, 0.0), RNG)
    for _ in range(10):
        state, sample = vane.measure(state, at_rest(), air(-6.0, 0.0), RNG)
    assert sample.speed_mps[0] == pytest.approx(2.0 + 4.0 * (1.0 - math.exp(-1.0)))


def test_noise_steps_and_full_scale() -> None:
    rng = np.random.default_rng(2)
    noisy = WindVane(WindVaneSpec(speed_noise_mps=0.2, direction_noise_deg=3.0))
    _, sample = noisy.measure(WindVaneState(), at_rest(4000), air(-8.0, 0.0, 4000), rng)
    assert sample.speed_mps.std() == pytest.approx(0.2, rel=0.04)
    assert np.degrees(sample.direction_rad).std() == pytest.approx(3.0, rel=0.04)
    coarse = WindVane(WindVaneSpec(speed_resolution_mps=0.5, direction_resolution_deg=10.0, max_speed_mps=5.0))
    _, sample = coarse.measure(WindVaneState(), at_rest(), air(-4.1, 1.0), rng)
    assert sample.speed_mps[0] == pytest.approx(4.0)
    assert math.degrees(sample.direction_rad[0]) == pytest.approx(-10.0)
    _, sample = coarse.measure(WindVaneState(), at_rest(), air(-40.0, 0.0), rng)
    assert sample.speed_mps[0] == 5.0


def test_from_astern_the_direction_stays_within_half_a_turn() -> None:
    rng = np.random.default_rng(6)
    noisy = WindVane(WindVaneSpec(direction_noise_deg=10.0))
    _, sample = noisy.measure(WindVaneState(), at_rest(400), air(4.0, 0.0, 400), rng)
    assert np.all((sample.direction_rad > -math.pi) & (sample.direction_rad <= math.pi))
    assert 0.3 < (sample.direction_rad > 0.0).mean() < 0.7


def test_what_cannot_be_is_refused_by_name() -> None:
    with pytest.raises(ValueError, match=r"WindVaneSpec.response_s = -1.0"):
        WindVane(WindVaneSpec(response_s=-1.0))
