"""Echoes that stand out: where they are, and how rarely noise and clutter do."""

from __future__ import annotations

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
