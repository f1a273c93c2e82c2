"""Whether a receiver's velocity jumped against a drift of its position, on either side of each limit."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from xitl_cli.plugins.logs.analyses.gnss_drift import GnssDrift, velocity_jumped

S = 1_000_000_000
FIXES, ONSET = 600, 300


def receiver(along_mps: np.ndarray, bearing_deg: float = 60.0) -> Any:
    """Fixes at 5 Hz with a velocity along a bearing."""
    bearing = np.radians(bearing_deg)
    vel_ned_mps = np.outer(along_mps, [np.cos(bearing), np.sin(bearing), 0.0])
    return SimpleNamespace(vel_ned_mps=vel_ned_mps, stamp_ns=np.arange(FIXES) * S // 5)


def jumped(along_mps: np.ndarray, drift_mps: float = 1.0, from_s: float = ONSET / 5, bearing_deg: float = 60.0) -> bool:
    drift = GnssDrift(round(from_s * S), 110 * S, drift_mps, bearing_deg)
    return velocity_jumped(receiver(along_mps), drift)


def step(size_mps: float) -> np.ndarray:
    return np.where(np.arange(FIXES) >= ONSET, size_mps, 0.0)


@pytest.mark.parametrize(("size_mps", "found"), [(-0.61, True), (-0.59, False), (0.61, False), (-3.0, True)])
def test_the_velocity_jumps_by_three_fifths_of_the_drift_against_it(size_mps: float, found: bool) -> None:
    assert jumped(step(size_mps)) is found


@pytest.mark.parametrize(("drift_mps", "found"), [(0.51, True), (0.49, False)])
def test_a_slow_drift_is_of_the_position(drift_mps: float, found: bool) -> None:
    assert jumped(step(-1.0), drift_mps) is found


@pytest.mark.parametrize(("from_s", "found"), [(58.25, False), (58.35, True), (61.25, True), (61.35, False)])
def test_the_jump_is_within_a_second_and_a_half_of_the_onset(from_s: float, found: bool) -> None:
    """The last fix before the jump is at 59.8 s."""
    assert jumped(step(-1.0), from_s=from_s) is found


def test_a_jump_to_another_side_is_none_of_the_drift() -> None:
    assert jumped(step(-1.0), bearing_deg=100.0)  # a share of 0.77
    assert not jumped(step(-1.0), bearing_deg=120.0)
    assert not jumped(step(-1.0), bearing_deg=240.0)


@pytest.mark.parametrize("rate_mps", [-0.7, 0.7])
def test_a_turn_changes_the_velocity_evenly(rate_mps: float) -> None:
    """By this much from fix to fix, for two seconds, and back."""
    change = np.zeros(FIXES)
    change[ONSET - 5 : ONSET + 5], change[ONSET + 50 : ONSET + 60] = rate_mps, -rate_mps
    smooth = np.convolve(change, np.ones(5) / 5.0, mode="same")
    assert not jumped(np.cumsum(smooth))


@pytest.mark.parametrize(("size_mps", "found"), [(-1.5, False), (-2.5, True)])
def test_a_jump_exceeds_the_changes_by_waves(size_mps: float, found: bool) -> None:
    """Each change differs by 0.2 m/s from those next to it: 6 deviations are 6 * 1.4826 * 0.2 = 1.8 m/s."""
    waves = np.where(np.arange(FIXES) % 2, 0.05, -0.05)
    assert jumped(waves + step(size_mps)) is found


def test_an_unknown_velocity_has_not_jumped() -> None:
    along_mps = step(-1.0)
    along_mps[ONSET - 20 : ONSET + 20] = np.nan
    assert not jumped(along_mps)
