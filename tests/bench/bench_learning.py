"""Vessel steps per second of `xitl.make_vec_env` with 1024 vessels in current, waves and gusts.

A vessel step is one physics step of one vessel. Observations, rewards and restarts are included.

Run by hand: `OPENBLAS_NUM_THREADS=1 python -m tests.bench.bench_learning`.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

import xitl
from tests.bench.figure import Figure, scaled

Array = NDArray[np.float64]
VESSELS, STEPS = 1024, 25
PROFILE, CONTROL_HZ = "sitl", 50.0


def reward(before: xitl.Vessels, action: Array, after: xitl.Vessels) -> Array:
    return after.velocity_frd_mps[:, 0]


def steps_per_second(threads: int, clock: Callable[[], float]) -> list[float]:
    """By wall clock or processor time, a few times."""
    env = xitl.make_vec_env(PROFILE, VESSELS, reward=reward, episode_s=2.0, control_rate_hz=CONTROL_HZ, threads=threads)
    env.reset(seed=1)
    action = np.full((VESSELS, 2), 0.5, dtype=np.float32)
    env.step(action)
    physics_hz = xitl.load_profile(PROFILE).runnable().clock.physics_rate_hz
    vessel_steps = VESSELS * STEPS * physics_hz / CONTROL_HZ
    rates = []
    for _ in range(scaled(5, 1)):
        began_s = clock()
        for _ in range(STEPS):
            env.step(action)
        rates.append(vessel_steps / (clock() - began_s))
    env.close()
    return rates


_NAME = "vessel steps of 1024 in a learning environment"
FIGURES: list[Figure] = [
    Figure(_NAME, ">= 300000", "a second", lambda: steps_per_second(1, time.perf_counter)),
    Figure(f"{_NAME}, two threads", "", "a second", lambda: steps_per_second(2, time.perf_counter)),
    Figure(f"{_NAME}, by processor time", "", "a second", lambda: steps_per_second(1, time.process_time)),
]


def main() -> None:
    for figure in FIGURES:
        rates = figure.measure()
        print(f"{figure.name:76} {np.median(rates):10.0f} {figure.unit}, at most {max(rates):.0f}")


if __name__ == "__main__":
    main()
