"""The river site of the shipped profiles, and rays as a lidar sends them into it."""

from __future__ import annotations

import dataclasses
import math
from functools import cache

import numpy as np

from sim_core.frames import Array32
from xitl_cli.profile.load import load_profile
from xitl_cli.profile.schema import RunProfile
from xitl_cli.scenery import Scenery

HALF_VIEW_RAD = math.radians(35.2)


@cache
def river_profile() -> RunProfile:
    """The shipped run in one process, moved to the river."""
    site = load_profile("sites/santo-antonio-river")
    assert site.world is not None
    assert site.mission is not None
    return dataclasses.replace(load_profile("sitl").runnable(), world=site.world, mission=site.mission)


@cache
def river_scenery() -> Scenery:
    """Of that profile."""
    return Scenery(river_profile())


def fan(count: int, seed: int = 0) -> tuple[Array32, Array32]:
    """Origins and directions (count, 3) in NED: a round view forward along the boom, from 1.1 m above the water."""
    start, end = (np.array(place) for place in river_profile().mission.waypoints_ned_m[:2])
    north, east = (end - start) / np.linalg.norm(end - start)
    rng = np.random.default_rng(seed)
    off, turn = HALF_VIEW_RAD * np.sqrt(rng.uniform(size=count)), rng.uniform(0.0, 2 * math.pi, count)
    ahead, right, down = np.cos(off), np.sin(off) * np.cos(turn), np.sin(off) * np.sin(turn)
    direction = np.column_stack([north * ahead - east * right, east * ahead + north * right, down])
    origin = np.append(start + 0.3 * (end - start), -1.1)
    return np.tile(origin.astype(np.float32), (count, 1)), direction.astype(np.float32)
