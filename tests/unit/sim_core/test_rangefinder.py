"""Ranges of a beam against closed forms: depth over the cosine of the lean, walls, noise as configured."""

from __future__ import annotations

import math

import numpy as np
import pytest
from motion import at_rest

from sim_core.sensors.rangefinder import Rangefinder
from sim_core.sensors.spec import RangefinderSpec
from sim_core.world.plan import Wall, Walls


def measured(unit: Rangefinder, truth=None, seed: int = 1) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return unit.measure(unit.initial(1, rng), at_rest() if truth is None else truth, rng)[1].range_m


def test_it_reads_the_depth_below_its_own_place() -> None:
    assert measured(Rangefinder(RangefinderSpec(position_frd_m=(0.3, 0.0, 0.2)), bed_down_m=20.0))[0] == pytest.approx(
        19.8
    )


@pytest.mark.parametrize("roll_deg", [5.0, 20.0, -35.0])
def test_a_narrow_beam_lengthens_with_the_lean_and_a_wide_one_does_not(roll_deg: float) -> None:
    truth = at_rest(euler_rad=(math.radians(roll_deg), 0.0, 0.0))
    narrow = measured(Rangefinder(RangefinderSpec(), bed_down_m=20.0), truth)[0]
    assert narrow == pytest.approx(20.0 / math.cos(math.radians(roll_deg)))
    assert measured(Rangefinder(RangefinderSpec(beam_deg=80.0), bed_down_m=20.0), truth)[0] == pytest.approx(20.0)
    half = measured(Rangefinder(RangefinderSpec(beam_deg=6.0), bed_down_m=20.0), truth)[0]
    assert half == pytest.approx(20.0 / math.cos(math.radians(abs(roll_deg) - 3.0)))


def test_the_arm_to_the_unit_leans_too() -> None:
    """Rolled to starboard by r, a unit b to starboard is b sin(r) deeper."""
    truth = at_rest(euler_rad=(0.2, 0.0, 0.0))
    unit = Rangefinder(RangefinderSpec(position_frd_m=(0.0, 0.6, 0.0)), bed_down_m=10.0)
    assert measured(unit, truth)[0] == pytest.approx((10.0 - 0.6 * math.sin(0.2)) / math.cos(0.2))


def test_through_air_it_meets_the_surface_and_looking_up_nothing() -> None:
    down = Rangefinder(
        RangefinderSpec(through="air", position_frd_m=(0.0, 0.0, -2.0)), bed_down_m=20.0, surface_down_m=0.5
    )
    assert measured(down)[0] == pytest.approx(2.5)
    assert np.isinf(measured(Rangefinder(RangefinderSpec(direction_frd=(0.0, 0.0, -1.0)), bed_down_m=20.0))[0])
    assert np.isinf(measured(Rangefinder(RangefinderSpec(direction_frd=(1.0, 0.0, 0.0)), bed_down_m=20.0))[0])


def test_only_the_direction_counts_not_its_length() -> None:
    walls = Walls.joined([Wall((30.0, -100.0), (30.0, 100.0), -1.0, 40.0)])
    assert measured(Rangefinder(RangefinderSpec(direction_frd=(0.0, 0.0, 7.0)), bed_down_m=20.0))[0] == pytest.approx(
        20.0
    )
    slanted = Rangefinder(RangefinderSpec(direction_frd=(3.0, 3.0, 0.0)), bed_down_m=90.0, walls=walls)
    assert measured(slanted)[0] == pytest.approx(30.0 * math.sqrt(2.0))


def test_a_unit_beyond_its_plane_reads_nothing_and_noise_nothing_below() -> None:
    below = Rangefinder(RangefinderSpec(through="air", position_frd_m=(0.0, 0.0, 0.4)), bed_down_m=20.0)
    assert measured(below)[0] == 0.0
    noisy = Rangefinder(RangefinderSpec(noise_m=0.5), bed_down_m=0.0)
    assert min(measured(noisy, seed=seed)[0] for seed in range(20)) == 0.0


def test_a_wall_ahead_is_met_before_the_bed() -> None:
    walls = Walls.joined([Wall((30.0, -100.0), (30.0, 100.0), -1.0, 40.0)])
    ahead = Rangefinder(RangefinderSpec(direction_frd=(1.0, 0.0, 0.0)), bed_down_m=20.0, walls=walls)
    assert measured(ahead)[0] == pytest.approx(30.0)
    turned = at_rest(euler_rad=(0.0, 0.0, math.radians(60.0)))
    assert measured(ahead, turned)[0] == pytest.approx(60.0)


def test_noise_is_that_of_the_configuration() -> None:
    """20 m with 0.05 m and 1 %: deviation sqrt(0.05^2 + 0.2^2) = 0.206 m; of 4000 draws within 4 % (3.6 sigma)."""
    unit = Rangefinder(RangefinderSpec(noise_m=0.05, noise_share=0.01), bed_down_m=20.0)
    rng = np.random.default_rng(7)
    _, sample = unit.measure(unit.initial(4000, rng), at_rest(4000), rng)
    assert sample.range_m.std() == pytest.approx(math.hypot(0.05, 0.2), rel=0.04)
    assert sample.range_m.mean() == pytest.approx(20.0, abs=0.014)
    steps = measured(Rangefinder(RangefinderSpec(resolution_m=0.05), bed_down_m=20.013))[0]
    assert steps == pytest.approx(20.0)


@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        ("rate_hz", 0.0, "RangefinderSpec.rate_hz = 0.0"),
        ("noise_m", -1.0, "RangefinderSpec.noise_m = -1.0"),
        ("direction_frd", (0.0, 0.0, 0.0), "has no direction"),
    ],
)
def test_what_cannot_be_is_refused_by_name(field: str, value: object, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        RangefinderSpec(**{field: value})  # type: ignore[arg-type]


def test_a_bed_at_no_depth_is_refused() -> None:
    with pytest.raises(ValueError, match=r"Rangefinder\.bed_down_m = nan"):
        Rangefinder(RangefinderSpec(), math.nan)
