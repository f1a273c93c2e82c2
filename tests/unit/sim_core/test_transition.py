"""Wind, current and waves that go over into others while a vessel is under way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.random import default_rng

from sim_core.environment.current import make_current
from sim_core.environment.environment import Environment, EnvironmentState, initial, step
from sim_core.environment.spec import CurrentSpec, GustSpec, Water, WaveSpec, WindSpec
from sim_core.environment.transition import Transition, mixed_waves
from sim_core.environment.waves import FLAT_WATER, FlatWater, WaveField, realise_waves
from sim_core.environment.wind import make_wind

PLACES = np.array([[0.0, 0.0], [12.0, -7.0], [300.0, 45.0]])
POS_NED_M = np.column_stack([PLACES, np.zeros(3)])


def sea(height_m: float, current_ne_mps: tuple[float, float] = (0.0, 0.0)) -> WaveField:
    spec = WaveSpec(spectrum="jonswap", significant_height_m=height_m, peak_period_s=3.0)
    waves = realise_waves(spec, Water(), default_rng(3), current_ne_mps)
    assert isinstance(waves, WaveField)
    return waves


def environment(speed_mps: float, wind_mps: float) -> Environment:
    wind = WindSpec(mean_mps=wind_mps, gust=GustSpec(spectrum="ornstein-uhlenbeck", deviation_mps=0.5))
    current = CurrentSpec(speed_mps=speed_mps, deviation_mps=0.1)
    return Environment(current=make_current(current), wind=make_wind(wind))


@pytest.mark.parametrize("after", [environment(1.0, 8.0), Environment()], ids=["stronger", "none"])
def test_velocities_go_from_one_to_the_other_and_end_there(after: Environment) -> None:
    before, rng = environment(0.2, 3.0), default_rng(1)
    transition = Transition(before, after, start_s=10.0, length_s=4.0)
    state = transition.begun(initial(before, 3, rng), 3, rng)
    for time_s, share in ((10.0, 0.0), (11.0, 0.15625), (12.0, 0.5), (14.0, 1.0)):
        now = transition.environment(time_s)
        state = step(now, state, 0.02, rng)
        ended = transition.ended(state)
        began = EnvironmentState(state.current[:, 0], state.wind.before)  # type: ignore[attr-defined]
        for old, new, mixed in (
            (before.current, after.current, now.current),
            (before.wind, after.wind, now.wind),
        ):
            if mixed is now.current:
                old_mps, new_mps, got_mps = (
                    one.velocity_ned_mps(own.current, POS_NED_M)  # type: ignore[union-attr, arg-type]
                    for one, own in ((old, began), (new, ended), (mixed, state))
                )
            else:
                old_mps, new_mps, got_mps = (
                    one.velocity_ned_mps(own.wind, time_s, 2.0)  # type: ignore[union-attr, arg-type]
                    for one, own in ((old, began), (new, ended), (mixed, state))
                )
            np.testing.assert_allclose(got_mps, (1.0 - share) * old_mps + share * new_mps, atol=1e-12)
        assert transition.is_over(time_s) is (time_s == 14.0)


def test_what_both_have_in_common_stays_and_draws_nothing() -> None:
    before = environment(0.2, 3.0)
    after = replace(before, waves=sea(0.2))
    transition, rng = Transition(before, after, 0.0), default_rng(1)
    state = initial(before, 1, rng)
    drawn = rng.bit_generator.state
    assert transition.begun(state, 1, rng).current is state.current
    assert rng.bit_generator.state == drawn
    now = transition.environment(1.0)
    assert (now.current, now.wind) == (before.current, before.wind)


def test_a_sea_grows_from_flat_water_and_is_the_same_sea_when_only_its_height_changes() -> None:
    low, high = sea(0.2), sea(0.4)
    assert isinstance(mixed_waves(FLAT_WATER, high, 0.0), FlatWater)
    half = mixed_waves(FLAT_WATER, high, 0.5)
    np.testing.assert_allclose(half.elevation_m(7.0, PLACES), 0.5 * high.elevation_m(7.0, PLACES), atol=1e-12)
    between = mixed_waves(low, high, 0.25)
    np.testing.assert_allclose(between.elevation_m(7.0, PLACES), 1.25 * low.elevation_m(7.0, PLACES), atol=1e-12)


def test_two_seas_on_two_currents_are_each_carried_by_their_own() -> None:
    slow, fast = sea(0.3), sea(0.3, (1.0, -0.5))
    mixed = mixed_waves(slow, fast, 0.4)
    assert isinstance(mixed, WaveField)
    expected = 0.6 * slow.elevation_m(9.0, PLACES) + 0.4 * fast.elevation_m(9.0, PLACES)
    np.testing.assert_allclose(mixed.elevation_m(9.0, PLACES), expected, atol=1e-12)
    at_hull = mixed.at_hull(np.zeros((1, 3)))
    sampled = at_hull.sample(9.0, POS_NED_M, np.tile(np.eye(3), (3, 1, 1))).point_elevation_m[:, 0]
    np.testing.assert_allclose(sampled, expected, atol=1e-5)  # single precision of the hull's sampler


def test_another_current_carries_the_same_pattern_on_from_where_it_is() -> None:
    still = sea(0.3)
    carried = still.carried_on(np.array([0.8, 0.2]), 20.0)
    np.testing.assert_allclose(carried.elevation_m(20.0, PLACES), still.elevation_m(20.0, PLACES), atol=1e-12)
    drifted = PLACES + np.array([0.8, 0.2]) * 5.0  # whoever drifts along sees the waves of still water
    np.testing.assert_allclose(carried.elevation_m(25.0, drifted), still.elevation_m(25.0, PLACES), atol=1e-12)
