"""Echoes that stand out: where they are, and how rarely noise and clutter do."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from agent.companion.sonar import SonarPing, echo_points

ROOT = Path(__file__).parents[3]
SAMPLES = 600
PERIOD_S = 2.0 * 30.0 / 1500.0 / SAMPLES  # 5 cm a sample
STEPS_PER_DB = 3.0


def ping(level_db: NDArray[np.float64], angle_grad: int = 0) -> SonarPing:
    intensity = np.clip(np.rint(level_db * STEPS_PER_DB), 0, 255).astype(np.uint8)
    return SonarPing(0, 0, angle_grad, (0.5, -0.2, 0.3), PERIOD_S, 1500.0, intensity)


def noise_db(rng: np.random.Generator, samples: int = SAMPLES, level_db: float = 15.0) -> NDArray[np.float64]:
    """Rayleigh amplitude is exponential power."""
    return np.asarray(level_db + 10.0 * np.log10(rng.exponential(size=samples)))


@pytest.mark.parametrize(("angle_grad", "along"), [(0, (1, 0)), (100, (0, 1)), (200, (-1, 0)), (300, (0, -1))])
def test_an_echo_lies_along_the_beam_at_its_range(angle_grad: int, along: tuple[float, float]) -> None:
    level = np.full(SAMPLES, 5.0)
    level[246:249] = (40.0, 60.0, 40.0)
    points, intensity = echo_points(ping(level, angle_grad))
    range_m = 247.5 * 0.05
    expected = (0.5 + range_m * along[0], -0.2 + range_m * along[1], 0.3)
    assert points == pytest.approx(np.array([expected]), abs=1e-5)
    assert intensity.tolist() == [180]


def test_two_echoes_half_a_metre_apart_are_one_and_two_metres_apart_are_two() -> None:
    for apart, found in ((10, 1), (40, 2)):
        level = np.full(SAMPLES, 5.0)
        level[[200, 200 + apart]] = (60.0, 59.0)
        assert len(echo_points(ping(level))[0]) == found


@pytest.mark.medium
def test_noise_seldom_stands_out() -> None:
    """13 dB over its mean in decibels (2.5 under the mean power): exp(-10^1.05) = 1.3e-5 a sample, more as the mean
    is of 30 samples only; 500 pings would hold 4 then."""
    rng = np.random.default_rng(5)
    found = sum(len(echo_points(ping(noise_db(rng)))[0]) for _ in range(500))
    assert found <= 25


def test_the_edge_of_clutter_does_not_stand_out() -> None:
    """The bed begins at 15 m and goes on: 25 dB more than before, in speckle."""
    rng = np.random.default_rng(6)
    step = np.where(np.arange(SAMPLES) >= 300, 25.0, 0.0)
    found = sum(len(echo_points(ping(noise_db(rng) + step))[0]) for _ in range(200))
    assert found <= 20


def test_an_echo_in_clutter_is_found() -> None:
    rng = np.random.default_rng(7)
    found = 0
    for _ in range(100):
        level = noise_db(rng, level_db=30.0)
        level[400] = 55.0
        points, _ = echo_points(ping(level))
        found += bool(np.any(np.abs(points[:, 0] - 0.5 - 400.5 * 0.05) < 1e-3))
    assert found >= 95


def test_what_the_transducer_rings_is_not_an_echo() -> None:
    level = np.maximum(85.0 - np.arange(SAMPLES) * 6.0, 5.0)
    assert len(echo_points(ping(level))[0]) == 0


@pytest.mark.parametrize("samples", [0, 1, 20, 200])
def test_short_and_flat_echoes_hold_nothing(samples: int) -> None:
    for value in (0, 255):
        flat = ping(np.empty(0))._replace(intensity=np.full(samples, value, np.uint8))
        points, intensity = echo_points(flat)
        assert points.shape == (0, 3)
        assert intensity.shape == (0,)


NEARLY_FULL = """
import sys, tracemalloc
import numpy as np
from agent.companion.sonar import SonarPing, echo_points

def strings_until_it_grows():
    tracemalloc.reset_peak()
    kept_bytes, number = tracemalloc.get_traced_memory()[0], 0
    while tracemalloc.get_traced_memory()[1] - kept_bytes < 400_000:
        sys.intern(f"string {number}")
        number += 1
    return number

ping = SonarPing(0, 0, 0, (0.0, 0.0, 0.0), 1e-4, 1500.0, np.full(60, 9, np.uint8))
echo_points(ping)
tracemalloc.start()
strings_until_it_grows()
for number in range(strings_until_it_grows() - 500):
    sys.intern(f"string {number}")
tracemalloc.reset_peak()
kept_bytes = tracemalloc.get_traced_memory()[0]
for _ in range(1000):
    echo_points(ping)
print(tracemalloc.get_traced_memory()[1] - kept_bytes)
"""


@pytest.mark.medium
def test_pings_do_not_fill_the_table_of_interned_strings() -> None:
    """A full table takes a megabyte more. Strings that nothing refers to any more count until then."""
    done = subprocess.run([sys.executable, "-c", NEARLY_FULL], cwd=ROOT, capture_output=True, text=True, check=True)
    assert int(done.stdout) < 300_000


def echo_ranges(level: list[int], sample_m: float) -> list[int]:
    """Samples at which echoes begin, one sample at a time.

    13 dB over the means of 1.5 m nearer and farther, beyond half a metre; the highest within half a metre; its flank
    begins 10 dB lower.
    """
    guard, training, start = max(round(0.5 / sample_m), 4), max(round(1.5 / sample_m), 12), math.ceil(0.75 / sample_m)
    if len(level) - start < guard + training:
        return []
    found = set()
    for at in range(start, len(level)):
        around = level[max(at - guard, 0) : at + guard + 1]
        near = level[max(at - guard - training, 0) : max(at - guard, 0)]
        far = level[at + guard + 1 : at + guard + 1 + training]
        means = [sum(part) / len(part) for part in (near, far) if part]
        rises = not at or level[at] > level[at - 1]
        if rises and level[at] == max(around) and level[at] >= max([0.0, *means]) + 39.0:
            found.add(next(row for row in range(max(at - guard, start), at + 1) if level[row] >= level[at] - 30))
    return sorted(found)


@pytest.mark.medium
@pytest.mark.parametrize(("sample_m", "samples"), [(0.05, 300), (0.2, 60), (0.111, 100), (0.03, 120), (0.5, 30)])
def test_echoes_begin_where_a_loop_over_samples_finds_them(sample_m: float, samples: int) -> None:
    rng, total = np.random.default_rng(samples), 0
    for number in range(40):
        level = rng.integers(10, 60, samples) + 90 * (rng.random(samples) < 0.04)
        level[rng.integers(samples)] += 60
        level = np.clip(level + 30 * (np.arange(samples) > samples // 2) * (number % 2), 0, 255)
        level[1:] = np.maximum(level[1:], level[:-1] - 40 * (number % 3 > 0))  # flanks
        if number % 4 == 0:
            level[rng.integers(samples - 1) :][:2] = 200  # two equal ones
        echo = ping(np.empty(0))._replace(
            intensity=level.astype(np.uint8), sample_period_s=2.0 * sample_m / 1500.0, position_frd_m=(0.0, 0.0, 0.0)
        )
        expected = echo_ranges(level.tolist(), sample_m)
        points, intensity = echo_points(echo)
        np.testing.assert_allclose(points[:, 0], (np.array(expected) + 0.5) * sample_m, rtol=1e-5)
        assert intensity.tolist() == level[expected].tolist()
        total += len(expected)
    assert total >= 20


@pytest.mark.parametrize(("samples", "found"), [(15 + 10 + 30, 1), (15 + 10 + 29, 0)])
def test_a_ping_that_is_too_short_for_the_means_has_no_echoes(samples: int, found: int) -> None:
    """0.75 m, half a metre and 1.5 m."""
    level = np.full(samples, 5.0)
    level[20] = 60.0
    assert len(echo_points(ping(level))[0]) == found
