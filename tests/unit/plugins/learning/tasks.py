"""A task for the tests: reach a goal 20 m away."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

import xitl

Array = NDArray[np.float64]


def reward(before: xitl.Vessels, action: Array, after: xitl.Vessels) -> Array:
    """How much closer the goal is, (N,)."""
    return distance_m(before) - distance_m(after)


def arrived(vessels: xitl.Vessels) -> NDArray[np.bool_]:
    return distance_m(vessels) < 2.0


def distance_m(vessels: xitl.Vessels) -> Array:
    return np.hypot(*(vessels.goal - vessels.position_ned_m[:, :2]).T)


def around(rng: Generator, count: int) -> Array:
    """Goals in all directions, 20 m from the origin."""
    bearing_rad = rng.uniform(-np.pi, np.pi, count)
    return 20.0 * np.stack([np.cos(bearing_rad), np.sin(bearing_rad)], axis=1)


def anywhere(rng: Generator, count: int) -> tuple[Array, Array]:
    return rng.uniform(-5.0, 5.0, (count, 2)), rng.uniform(-np.pi, np.pi, count)
