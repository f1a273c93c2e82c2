"""Rays into the whole scene of a site, beside a bare call of Embree: `python -m tests.bench.bench_rays`.

Asserts nothing. On one core: the package embreex casts one ray after another.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from importlib.util import find_spec

import numpy as np

from sim_core.frames import Array32
from sim_core.world.geometry import WOOD, cylinder
from sim_core.world.ray_backends import make_caster
from sim_core.world.rays import NO_BODIES, Bodies
from tests.bench.figure import Figure, scaled
from tests.river import fan, river_scenery

RUNS = 7
RAYS = 10_000
"""A frame of the lidar: 100 000 points a second, ten frames."""
LIDAR_HZ = 100_000


def available() -> bool:
    """Whether Embree is installed."""
    return find_spec("embreex") is not None


def times_real_time() -> list[float]:
    return [1.0 / (LIDAR_HZ * s_a_ray) for (s_a_ray,) in _times(_cast())]


def share_of_embree() -> list[float]:
    """Bare time over time, in turns, as the machine is noisy."""
    return [bare / own for bare, own in _times(_bare(), _cast())]


def with_bodies() -> list[float]:
    return [1.0 / (LIDAR_HZ * s_a_ray) for (s_a_ray,) in _times(_cast(_afloat(20)))]


def _cast(bodies: Bodies = NO_BODIES) -> Callable[[], object]:
    caster = make_caster(river_scenery().scene)
    origin, direction = fan(RAYS)
    delay_s = np.linspace(0.0, 0.1, RAYS, dtype=np.float32)
    return lambda: caster.cast(origin, direction, bodies, delay_s)


def _bare() -> Callable[[], object]:
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    scene = EmbreeScene()
    corners = np.concatenate([part.mesh.vertices_m[part.mesh.faces] for part in river_scenery().scene.parts])
    kept = TriangleMesh(scene, corners.astype(np.float32))
    origin, direction = fan(RAYS)
    return lambda: (kept, scene.run(origin, direction, query="INTERSECT", output=1))


def _times(*calls: Callable[[], object], turns: int = 20) -> list[list[float]]:
    """Seconds a ray of each call, of each run."""
    return [[_median_s(call, scaled(turns, 1)) / RAYS for call in calls] for _ in range(scaled(RUNS, 1))]


def _median_s(call: Callable[[], object], turns: int) -> float:
    times = []
    for _ in range(turns):
        started_s = time.perf_counter()
        call()
        times.append(time.perf_counter() - started_s)
    return statistics.median(times)


def _afloat(count: int) -> Bodies:
    """Trunks on the water around the first ray's origin."""
    rng = np.random.default_rng(3)
    origin, _ = fan(1)
    place: Array32 = origin[0] + np.column_stack([rng.uniform(-60, 60, (count, 2)), np.ones(count)]).astype(np.float32)
    velocity, level = np.tile([-0.3, 0.4, 0.0], (count, 1)), np.tile(np.eye(3), (count, 1, 1))
    return Bodies((cylinder(0.25, 5.0, WOOD),) * count, place.astype(np.float64), velocity, level)


FIGURES = [
    Figure("rays of a lidar into 100 000 triangles", ">= 10", "x real time", times_real_time),
    Figure("rays of a lidar, of a bare call of Embree", ">= 0.5", "x", share_of_embree),
    Figure("rays of a lidar with 20 bodies adrift", "", "x real time", with_bodies),
]


if __name__ == "__main__":
    for name, wanted, unit, measure in FIGURES:
        values = measure()
        print(
            f"{name}: {statistics.median(values):.3g} {unit} ({min(values):.3g} to {max(values):.3g}), wanted {wanted}"
        )
