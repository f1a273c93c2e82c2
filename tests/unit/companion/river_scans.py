"""Clouds of a made-up river by closed forms: upright poles, a wall and turbid water, from a body that moves."""

from __future__ import annotations

import numpy as np

LEVER = np.array([1.0, 0.0, -0.8])
SPEED_MPS = 2.0
POINTS = 3000
PERIOD_S = 0.1


def pose(t_s: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
    """Place (n, 3) and attitude (n, 3, 3), body FRD to NED: ahead, with a slow turn and a roll."""
    t = np.atleast_1d(np.asarray(t_s, dtype=float))
    place = np.stack([SPEED_MPS * t, 0.5 * np.sin(0.2 * t), -0.15 + 0.03 * np.sin(2.0 * t)], axis=-1)
    yaw, roll = 0.05 * np.sin(0.3 * t), 0.03 * np.sin(2.1 * t)
    cy, sy, cr, sr, zero, one = np.cos(yaw), np.sin(yaw), np.cos(roll), np.sin(roll), 0 * t, 0 * t + 1
    turn = np.stack([cy, -sy, zero, sy, cy, zero, zero, zero, one], -1).reshape(-1, 3, 3)
    heel = np.stack([one, zero, zero, zero, cr, -sr, zero, sr, cr], -1).reshape(-1, 3, 3)
    return place, turn @ heel


def poles(seed: int = 1) -> np.ndarray:
    """(k, 3): north, east and radius of poles on both sides of the way."""
    rng = np.random.default_rng(seed)
    north = np.arange(5.0, 160.0, 3.0)
    side = np.where(np.arange(len(north)) % 2, 1.0, -1.0)
    return np.column_stack(
        [
            north + rng.uniform(-1, 1, len(north)),
            side * rng.uniform(7, 16, len(north)),
            rng.uniform(0.3, 1.0, len(north)),
        ]
    )


def scan(start_s: float, stands: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) float32 in body FRD, each at its own instant, and their offsets (n,): what a ray meets first."""
    offset = np.linspace(0.0, PERIOD_S, POINTS, endpoint=False)
    azimuth, elevation = rng.uniform(-0.6, 0.6, POINTS), rng.uniform(-0.35, 0.25, POINTS)
    ray = np.stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), -np.sin(elevation)], axis=-1
    )
    place, attitude = pose(start_s + offset)
    origin, way = place + attitude @ LEVER, np.einsum("nij,nj->ni", attitude, ray)
    range_m = np.full(POINTS, np.inf)
    for north, east, radius in stands:  # a cylinder about the vertical: a quadratic in the range
        a = way[:, 0] ** 2 + way[:, 1] ** 2
        relative = origin[:, :2] - [north, east]
        b = np.einsum("ni,ni->n", way[:, :2], relative)
        root = b**2 - a * (np.einsum("ni,ni->n", relative, relative) - radius**2)
        found = np.where(root > 0, (-b - np.sqrt(np.maximum(root, 0))) / a, np.inf)
        up = origin[:, 2] + way[:, 2] * np.where(np.isfinite(found), found, 0.0)
        range_m = np.where((found > 0) & (up > -4.0) & (up < 0.0), np.minimum(range_m, found), range_m)
    with np.errstate(divide="ignore"):
        water_m = np.where(way[:, 2] > 0, -origin[:, 2] / way[:, 2], np.inf)
    wet = water_m < range_m
    range_m = np.where(wet, water_m, range_m)
    kept = (range_m < 60.0) & (~wet | (range_m < 9.0))
    measured = range_m[kept] + rng.normal(0.0, 0.02, np.count_nonzero(kept))
    return (LEVER + ray[kept] * measured[:, None]).astype(np.float32), offset[kept].astype(np.float32)
