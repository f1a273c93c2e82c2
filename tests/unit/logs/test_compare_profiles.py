"""Differences of two logs against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_log import MadeLog
from made_vessel import Array, vessel

from xitl_cli.logs.compare.comparison import Comparison, compare
from xitl_cli.logs.model.sections import Section, Value

DURATION_S = 60.0


def section(found: Comparison, key: str) -> Section:
    return next(each for each in found.sections if each.key == key)


def facts(found: Comparison) -> dict[str, Value]:
    return {fact.key: fact.value for fact in section(found, "trajectory").facts}


def row(found: Comparison, quantity: str, key: str = "motion") -> dict[str, Value]:
    grid = section(found, key).grids[0]
    return next(dict(zip(grid.columns, row, strict=True)) for row in grid.rows if row[0] == quantity)


def circle(name: str, east_m: float = 0.0, north_m: float = 0.0) -> MadeLog:
    return vessel(
        name,
        north_m=lambda t: north_m + 20.0 * np.cos(0.1 * t),
        east_m=lambda t: east_m + 20.0 * np.sin(0.1 * t),
        yaw_deg=lambda t: 90.0 + np.degrees(0.1 * t),
    )


def test_the_integral_of_a_shifted_circle_is_its_shift_times_the_time() -> None:
    found = compare(circle("a"), circle("b", east_m=-3.0, north_m=4.0), shift_s=0.0)
    said = facts(found)
    # Degrees in 64 bits are good to 1e-8 m here; the plane leaves the ellipsoid by 0.03 mm over 20 m.
    assert said["common_time_s"] == pytest.approx(DURATION_S)
    assert said["iae_x_ms"] == pytest.approx(3.0 * DURATION_S, rel=1e-4)
    assert said["iae_y_ms"] == pytest.approx(4.0 * DURATION_S, rel=1e-4)
    assert (said["position_rms_m"], said["position_max_m"]) == pytest.approx((5.0, 5.0), rel=1e-4)
    assert (said["east_max_m"], said["north_max_m"]) == pytest.approx((3.0, 4.0), rel=1e-4)


def test_east_is_x_and_north_is_y() -> None:
    said = facts(compare(circle("a"), circle("b", east_m=2.0), shift_s=0.0))
    assert said["iae_x_ms"] == pytest.approx(2.0 * DURATION_S, rel=1e-4)
    assert said["iae_y_ms"] == pytest.approx(0.0, abs=1e-3)


def test_a_growing_error_is_integrated_over_time() -> None:
    straight = vessel("a", north_m=lambda t: t)
    drifting = vessel("b", north_m=lambda t: t, east_m=lambda t: 0.1 * t)
    said = facts(compare(straight, drifting, shift_s=0.0))
    assert said["iae_x_ms"] == pytest.approx(0.05 * DURATION_S**2, rel=1e-4)


def test_a_path_sailed_late_is_off_in_time_and_not_in_place() -> None:
    early, late = vessel("a", north_m=lambda t: 2.0 * t), vessel("b", north_m=lambda t: 2.0 * (t - 3.0))
    said = facts(compare(early, late, shift_s=0.0, from_s=3.0))
    assert said["position_rms_m"] == pytest.approx(6.0, rel=1e-4)
    assert said["path_max_m"] == pytest.approx(0.0, abs=0.01)


@pytest.mark.medium
@settings(max_examples=20, deadline=None)
@given(lag_s=st.floats(-4.0, 4.0))
def test_the_lag_of_a_sine_is_found(lag_s: float) -> None:
    def wave(t_s: Array) -> Array:
        return 2.0 + np.sin(2.0 * np.pi * t_s / 20.0)

    found = compare(
        vessel("a", speed_mps=wave), vessel("b", speed_mps=lambda t: 5.0 + 3.0 * wave(t - lag_s)), shift_s=0.0
    )
    speed = row(found, "speed over ground")
    # Sampled every 0.1 s and joined by straight lines: 0.1 % of the amplitude, so some milliseconds of a 20 s wave.
    assert speed["B later (s)"] == pytest.approx(lag_s, abs=0.02)
    assert speed["correlation"] == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("about_deg", [0.0, 10.0, 180.0, 355.0])
def test_an_angle_differs_the_short_way_round(about_deg: float) -> None:
    def yaw(t_s: Array) -> Array:
        return about_deg + 15.0 * np.sin(0.3 * t_s)

    found = compare(vessel("a", yaw_deg=yaw), vessel("b", yaw_deg=lambda t: yaw(t) + 2.0), shift_s=0.0)
    said = row(found, "yaw")
    assert (said["RMS"], said["mean"], said["most"]) == pytest.approx((2.0, 2.0, 2.0))
    assert said["IAE"] == pytest.approx(2.0 * DURATION_S, rel=1e-4)


def test_turns_more_do_not_change_the_lag() -> None:
    found = compare(
        vessel("a", yaw_deg=lambda t: 12.0 * t + 30.0 * np.sin(0.5 * t)),
        vessel("b", yaw_deg=lambda t: 12.0 * (t - 1.5) + 30.0 * np.sin(0.5 * (t - 1.5))),
        shift_s=0.0,
    )
    assert row(found, "yaw")["B later (s)"] == pytest.approx(1.5, abs=0.02)


def test_what_does_not_change_is_not_correlated() -> None:
    said = row(compare(vessel("a"), vessel("b", speed_mps=np.sin), shift_s=0.0), "speed over ground")
    assert said["correlation"] is None
    assert said["B later (s)"] is None


def test_noise_has_no_lag() -> None:
    noise = [lambda t, seed=seed: np.abs(np.random.default_rng(seed).normal(size=len(t))) for seed in (1, 2)]
    said = row(
        compare(vessel("a", speed_mps=noise[0]), vessel("b", speed_mps=noise[1]), shift_s=0.0), "speed over ground"
    )
    assert said["correlation"] is not None
    assert said["B later (s)"] is None


@pytest.mark.medium
def test_the_other_way_round_is_the_same_with_its_sign() -> None:
    a = vessel("a", north_m=lambda t: 5.0 * np.sin(0.2 * t), speed_mps=lambda t: 2.0 + np.sin(0.3 * t))
    b = vessel("b", north_m=lambda t: 5.0 * np.sin(0.2 * t - 0.3), speed_mps=lambda t: 2.5 + np.sin(0.3 * t - 0.3))
    there, back = compare(a, b, shift_s=0.0), compare(b, a, shift_s=0.0)
    for key in ("iae_x_ms", "iae_y_ms", "position_rms_m", "position_max_m"):
        assert facts(there)[key] == pytest.approx(facts(back)[key], rel=1e-4, abs=1e-4)
    one, other = row(there, "speed over ground"), row(back, "speed over ground")
    assert one["mean"] == pytest.approx(-other["mean"])  # type: ignore[operator]
    assert one["B later (s)"] == pytest.approx(-other["B later (s)"], abs=0.01)  # type: ignore[operator]


def test_only_the_asked_for_time_is_compared() -> None:
    drifting = vessel("b", east_m=lambda t: np.where(t < 20.0, 0.0, 5.0))
    after = facts(compare(vessel("a"), drifting, shift_s=0.0, from_s=20.0, until_s=30.0))
    before = facts(compare(vessel("a"), drifting, shift_s=0.0, until_s=19.0))
    assert after["iae_x_ms"] == pytest.approx(50.0, rel=1e-4)
    assert before["iae_x_ms"] == pytest.approx(0.0, abs=1e-6)


def test_a_gap_of_the_other_log_is_left_out() -> None:
    whole, holed = circle("a"), circle("b")
    table = holed.tables["POS"]
    seconds = (table.stamp_ns - table.stamp_ns[0]) * 1e-9
    kept = (seconds < 20.0) | (seconds > 40.0)
    values = {name: table.values(name)[kept] for name in table.columns}
    holed.tables["POS"] = type(table)("POS", table.stamp_ns[kept], values)
    said = facts(compare(whole, holed, shift_s=0.0))
    assert said["common_time_s"] == pytest.approx(40.0, abs=0.3)
    assert said["position_max_m"] == pytest.approx(0.0, abs=1e-3)
