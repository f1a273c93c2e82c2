"""Cost of a lidar's point in the river with the log boom, 100 000 triangles, and how much of it is embree's.

Run by hand: `OPENBLAS_NUM_THREADS=1 taskset -c 0 python tests/bench/bench_lidar.py`. The sensor and a bare call of
embree on the rays of the same frame take turns, so that a busy machine slows both.
"""

from __future__ import annotations

import statistics
import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy import float32

from agent.companion.clouds import PointCloud, cloud_messages
from agent.wire.codec import Packer
from sim_core.environment.environment import Environment
from sim_core.environment.waves import FlatWater
from sim_core.frames import euler_to_quat, quat_to_matrix
from sim_core.sensors.lidar import BodyTrack, Lidar
from sim_core.sensors.optics import WaterSeen
from sim_core.sensors.spec import LidarSpec
from sim_core.world.embree_rays import EmbreeCaster
from sim_core.world.rays import Hits
from tests.bench.figure import Figure, scaled
from xitl_cli.profile import load_profile
from xitl_cli.run.world.world import build_simulation
from xitl_cli.scenery import Scenery
from xitl_cli.seeds import Seeds

PROFILE = "sitl-perception"
FRAME_NS = 100_000_000
STEPS = 40
FRAMES = 60


@dataclass(slots=True)
class Witness:
    """Casts with `caster` and keeps the rays."""

    caster: EmbreeCaster
    rays: tuple[Any, Any] = (None, None)
    triangles: int = 0

    def cast(self, origin_ned_m: Any, direction_ned: Any, *more: Any) -> Hits:
        self.rays = origin_ned_m, direction_ned
        return self.caster.cast(origin_ned_m, direction_ned, *more)


@dataclass(slots=True)
class River:
    """The world of the profile: what casts, its water, and the first leg of the mission."""

    caster: EmbreeCaster
    environment: Environment
    leg_ne_m: np.ndarray

    @classmethod
    def of_profile(cls) -> River:
        profile = load_profile(PROFILE).runnable()
        scenery = Scenery(profile)
        caster = scenery.caster()
        assert isinstance(caster, EmbreeCaster)
        simulation, _ = build_simulation(profile, Seeds(1), scenery)
        legs = np.array(profile.mission.waypoints_ned_m)[:, :2]
        return cls(caster, simulation.environment, legs[:2])

    def track(self, number: int) -> BodyTrack:
        """A vessel that goes along the leg in FRAMES frames, and rolls and pitches."""
        stamps_ns = number * FRAME_NS + np.arange(STEPS + 1) * (FRAME_NS // STEPS)
        time_s = stamps_ns * 1e-9
        along = self.leg_ne_m[1] - self.leg_ne_m[0]
        heading = np.arctan2(along[1], along[0]) + 0.1 * np.sin(time_s)
        turned = np.stack([0.05 * np.sin(2.0 * time_s), 0.03 * np.sin(1.7 * time_s), heading], axis=1)
        start = self.leg_ne_m[0] + along * (number / FRAMES)
        place = start + (time_s - time_s[0])[:, None] * 1.5 * along / np.linalg.norm(along)
        return BodyTrack(
            stamps_ns, np.column_stack([place, np.zeros(STEPS + 1)]), quat_to_matrix(euler_to_quat(turned))
        )


def costs_us(river: River) -> tuple[float, float]:
    """Of a point: all of the sensor, and the bare embree."""
    witness = Witness(river.caster)
    embree = river.caster._still._scene
    lidar = Lidar(LidarSpec(position_frd_m=(1.0, 0.0, -0.8)))
    rng = np.random.default_rng(1)
    whole, bare = [], []
    for number in range(scaled(FRAMES, 2)):
        track = river.track(number)
        began = time.perf_counter()
        water = WaterSeen.around(river.environment, number * 0.1, track.pos_ned_m[0])
        scan = lidar.scan(track, witness, water, rng)
        whole.append((time.perf_counter() - began) / scan.fates.fired)
        origin, direction = (np.ascontiguousarray(each, float32) for each in witness.rays)
        began = time.perf_counter()
        embree.run(origin, direction, query="INTERSECT", output=1)
        bare.append((time.perf_counter() - began) / scan.fates.fired)
    return statistics.median(whole) * 1e6, statistics.median(bare) * 1e6


def real_time_factors() -> list[float]:
    """At 100 000 points a second."""
    river = River.of_profile()
    return [10.0 / costs_us(river)[0] for _ in range(scaled(3, 1))]


def shares_of_bare_embree() -> list[float]:
    river = River.of_profile()
    costs = [costs_us(river) for _ in range(scaled(3, 1))]
    return [bare_us / whole_us for whole_us, bare_us in costs]


def packing_ms() -> list[float]:
    """A cloud of 10 000 points into frames."""
    rng = np.random.default_rng(1)
    points = rng.uniform(-90.0, 90.0, (10_000, 3)).astype(float32)
    offset_s = np.arange(10_000, dtype=float32) * float32(1e-5)
    cloud = PointCloud(0, 1, 0, points, offset_s, rng.integers(0, 150, 10_000, dtype=np.uint8))
    packer, took = Packer(1, 1), []
    for _ in range(5):
        began = time.perf_counter()
        for message in cloud_messages(cloud):
            packer.pack(message)
        took.append((time.perf_counter() - began) * 1e3)
    return took


FIGURES = [
    Figure("lidar of 100 000 points/s, 100 000 triangles, waves", ">= 10", "x real time", real_time_factors),
    Figure("points of a lidar a second, of bare embree's", ">= 0.5", "x", shares_of_bare_embree),
    Figure("a cloud of 10 000 points into frames", "< 10", "ms", packing_ms),
]


def main() -> None:
    river = River.of_profile()
    still = replace(river, environment=replace(river.environment, waves=FlatWater()))
    for name, one in (("waves", river), ("flat water", still)):
        whole_us, bare_us = costs_us(one)
        print(f"{name}: {whole_us:.3f} us a point, bare embree {bare_us:.3f}, {river.caster.triangles} triangles")
    print(f"packing 10 000 points: {statistics.median(packing_ms()):.2f} ms")


if __name__ == "__main__":
    main()
