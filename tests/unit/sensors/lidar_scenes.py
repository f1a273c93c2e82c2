"""What lidar tests look at: casters of one plane in closed form, still vessels, and open water."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from sim_core.environment.environment import Environment
from sim_core.environment.spec import Water
from sim_core.environment.waves import FlatWater, WaveField
from sim_core.frames import euler_to_quat, quat_to_matrix
from sim_core.sensors.lidar import BodyTrack, PointFates
from sim_core.sensors.optics import WaterSeen
from sim_core.world.geometry import MATERIALS, WALL, Material
from sim_core.world.rays import NO_BODIES, Bodies, Hits


@dataclass
class PlaneCaster:
    """One endless plane: points with normal . p = distance_m. Keeps what it was asked."""

    normal: tuple[float, float, float]
    distance_m: float
    material: Material = WALL
    triangles: int = 0
    asked: list[tuple[np.ndarray, np.ndarray, np.ndarray | None]] = field(default_factory=list)

    def cast(self, origin_ned_m, direction_ned, bodies: Bodies = NO_BODIES, body_delay_s=None, reach_m=None) -> Hits:
        self.asked.append((origin_ned_m, direction_ned, body_delay_s))
        origin, direction = origin_ned_m.astype(float), direction_ned.astype(float)
        normal = np.array(self.normal)
        toward = direction @ normal
        with np.errstate(divide="ignore", invalid="ignore"):
            range_m = (self.distance_m - origin @ normal) / toward
        hit = np.isfinite(range_m) & (range_m >= 0.0)
        facing = np.where((hit & (toward > 0.0))[:, None], -normal, np.where(hit[:, None], normal, 0.0))
        return Hits(
            np.where(hit, range_m, np.inf).astype(np.float32),
            facing.astype(np.float32),
            np.where(hit, MATERIALS.index(self.material), -1).astype(np.int16),
            np.full(len(range_m), -1, np.int16),
        )


class SquareOn(PlaneCaster):
    """All rays meet something `distance_m` off, square to them."""

    def __init__(self, distance_m: float, material: Material) -> None:
        super().__init__((1.0, 0.0, 0.0), distance_m, material)

    def cast(self, origin_ned_m, direction_ned, bodies: Bodies = NO_BODIES, body_delay_s=None, reach_m=None) -> Hits:
        count = len(origin_ned_m)
        return Hits(
            np.full(count, self.distance_m, np.float32),
            -direction_ned,
            np.full(count, MATERIALS.index(self.material), np.int16),
            np.full(count, -1, np.int16),
        )


NOTHING = PlaneCaster((0.0, 0.0, 1.0), -1e9)
"""A plane that is above the sky."""


def moving(
    start_ns: int = 0,
    place_ned_m=(0.0, 0.0, 0.0),
    velocity_ned_mps=(0.0, 0.0, 0.0),
    turned_deg=(0.0, 0.0, 0.0),
    turning_degps=(0.0, 0.0, 0.0),
    steps: int = 40,
    step_ns: int = 2_500_000,
) -> BodyTrack:
    """Straight on, with Euler angles (roll, pitch, yaw) that change evenly."""
    stamps_ns = start_ns + np.arange(steps + 1) * step_ns
    later_s = ((stamps_ns - start_ns) * 1e-9)[:, None]
    euler = np.radians(np.array(turned_deg) + later_s * np.array(turning_degps))
    place = np.array(place_ned_m) + later_s * np.array(velocity_ned_mps)
    return BodyTrack(stamps_ns, place, quat_to_matrix(euler_to_quat(euler)))


def water(level_m: float = -1000.0, waves: WaveField | FlatWater | None = None, time_s: float = 0.0) -> WaterSeen:
    """Far below, if not said otherwise."""
    environment = Environment(water=Water(level_m=level_m), waves=waves or FlatWater())
    return WaterSeen.around(environment, time_s, np.zeros(3))


def accounted(fates: PointFates) -> bool:
    """Every point has one fate."""
    away = fates.nothing + fates.near + fates.weak + fates.water + fates.dropped
    return fates.returned + away == fates.fired
