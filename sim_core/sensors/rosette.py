"""Where a lidar with two counter-rotating wedge prisms looks.

A thin wedge turns a ray by a constant angle toward its thick side; two that turn in opposite senses at rates of no
simple ratio draw a rosette that does not repeat, so that the share of the view that has been seen grows with time
(Livox Mid-40/Mid-70 point cloud characteristics; small angles of prisms add as vectors: Risley prisms,
Marshall 1999, "Risley prism scan patterns", eq 1).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy import float32
from numpy.typing import NDArray

Array32 = NDArray[float32]

MID_70_TURNS_HZ = (121.567, -77.733)
MID_70_WEDGE_DEG = (17.6, 17.6)


@dataclass(frozen=True, slots=True)
class Rosette:
    """A pattern of `points_hz` points a second; turns_hz and wedge_deg of the two prisms.

    Directions are in the sensor's axes: forward along the middle of the view, right, down.
    """

    points_hz: float = 100_000.0
    turns_hz: tuple[float, float] = MID_70_TURNS_HZ
    wedge_deg: tuple[float, float] = MID_70_WEDGE_DEG

    def __post_init__(self) -> None:
        if not (math.isfinite(self.points_hz) and self.points_hz > 0.0):
            raise ValueError(f"lidar.points_hz = {self.points_hz} must be a positive number")

    @property
    def half_view_rad(self) -> float:
        """From the axis to the rim of the view."""
        return math.radians(sum(self.wedge_deg))

    def directions(self, first: int, count: int) -> Array32:
        """(3, count) forward, right and down of unit vectors: of the points first, first + 1, ... since the start.

        The deflection, right and down, is d1 (cos a1, sin a1) + d2 (cos a2, sin a2), an angle from the axis.
        """
        # Whole turns come off in double precision: after an hour there are 4e5 of them.
        start_s = first / self.points_hz
        later_s = np.arange(count, dtype=float32) * float32(1.0 / self.points_hz)
        directions = np.zeros((3, count), dtype=float32)
        forward, right, down = directions
        for turns_hz, wedge_deg in zip(self.turns_hz, self.wedge_deg, strict=True):
            angle = later_s * float32(2.0 * math.pi * turns_hz)
            angle += float32(2.0 * math.pi * math.fmod(turns_hz * start_s, 1.0))
            wedge = float32(math.radians(wedge_deg))
            right += wedge * np.cos(angle)
            down += wedge * np.sin(angle)
        off = np.sqrt(right * right + down * down)
        np.maximum(off, float32(1e-9), out=off)
        np.cos(off, out=forward)
        directions[1:] *= np.sin(off) / off
        return directions
