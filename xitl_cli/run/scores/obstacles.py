"""Score of the obstacle detection against the true drifting bodies."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy import float64
from numpy.typing import NDArray

from sim_core.world.debris import DebrisState
from sim_core.world.rays import Bodies, RayCaster

Array = NDArray[float64]

NEAR_M = 2.0
"""A track belongs to a body when it lies within this and half the body's length of the body's middle."""
_STANDING_M = 3.0  # a track this near to a fixed object belongs to it
_GRID = 9
_ABOVE_M = 60.0
_AFLOAT_DOWN_M = 0.3


class ObstacleScore:
    """Call `see` with the truth some ten times a second, `hear` with every XITL_OBSTACLE, and `report` at the end.

    hull_m: length and width of the vessel. standing: rays at all fixed objects, None without any. water_down_m: mean
    level of the water. others: bodies that rays hit, first debris and then the hulls of other vessels; None without
    any. tide_m: returns the height of the water above its mean level now. A track of another hull is not a false one.
    Tracks are in the autopilot's local NED with the origin origin_ne_m.
    """

    def __init__(
        self,
        hull_m: tuple[float, float],
        standing: RayCaster | None = None,
        water_down_m: float = 0.0,
        others: Callable[[], Bodies] | None = None,
        tide_m: Callable[[], float] = lambda: 0.0,
    ) -> None:
        self.origin_ne_m: tuple[float, float] = (0.0, 0.0)
        self._half_m = (0.5 * hull_m[0], 0.5 * hull_m[1])
        self._standing = standing
        self._water_down_m, self._tide_m = water_down_m, tide_m
        self._others = others
        self._debris: DebrisState | None = None
        self._place_ne_m, self._yaw_rad = np.zeros(2), 0.0
        self._detected_at_m: dict[int, float] = {}
        self._clearance_m: dict[int, float] = {}
        self._of_something: dict[int, bool] = {}

    def see(self, pos_ned_m: Array, yaw_rad: float, debris: DebrisState) -> None:
        """Note the vessel's position (3,) and heading, and the drifting bodies, at one instant."""
        self._debris, self._place_ne_m, self._yaw_rad = debris, pos_ned_m[:2], yaw_rad
        for number, gap_m in enumerate(self._gaps_m(np.zeros(2), self._half_m).tolist()):
            self._clearance_m[number] = min(gap_m, self._clearance_m.get(number, math.inf))

    def hear(self, message: Any) -> None:
        """Note an XITL_OBSTACLE, as a report on the instant last seen."""
        place = np.array(message.pos_ned[:2], dtype=float) + self.origin_ne_m
        number = int(message.id)
        if not np.isfinite(place).all():
            self._of_something.setdefault(number, False)
            return
        known = self._of_something.get(number, False)
        debris = self._debris
        if debris is not None and len(debris.bodies):
            off = np.hypot(*(debris.pos_ned_m[:, :2] - place).T)
            reach = NEAR_M + 0.5 * np.array([body.length_m for body in debris.bodies])
            near = np.flatnonzero(off < reach).tolist()
            new = [body for body in near if body not in self._detected_at_m]
            if new:
                from_bow = self._gaps_m(np.array((self._half_m[0], 0.0)), (0.0, 0.0))
                self._detected_at_m.update({body: float(from_bow[body]) for body in new})
            known = known or bool(near)
        self._of_something[number] = known or self._is_near_vessel(place) or self._is_near_fixed(place)

    def _gaps_m(self, middle_fr_m: Array, half_m: tuple[float, float]) -> Array:
        """Return the distances (B,) in plan from a box of the vessel to the edges of the bodies.

        The box is `half_m` long and wide on each side of `middle_fr_m`.
        """
        debris = self._debris
        if debris is None or not len(debris.bodies):
            return np.empty(0)
        figures = debris.figures
        cos, sin = math.cos(self._yaw_rad), math.sin(self._yaw_rad)
        steps = np.linspace(-1.0, 1.0, 25)
        axis = np.stack([np.cos(debris.yaw_rad), np.sin(debris.yaw_rad)], axis=-1)
        along = (steps[None] * figures.half_axis_m[:, None])[..., None]
        off = debris.pos_ned_m[:, None, :2] + along * axis[:, None] - self._place_ne_m
        forward = np.abs(off[..., 0] * cos + off[..., 1] * sin - middle_fr_m[0]) - half_m[0]
        right = np.abs(off[..., 1] * cos - off[..., 0] * sin - middle_fr_m[1]) - half_m[1]
        gap = np.hypot(np.maximum(forward, 0.0), np.maximum(right, 0.0)).min(axis=1)
        gaps: Array = np.maximum(gap - figures.radius_m, 0.0)
        return gaps

    def _is_near_vessel(self, place_ne_m: Array) -> bool:
        """Whether another vessel is near a place."""
        if self._others is None:
            return False
        bodies, adrift = self._others(), 0 if self._debris is None else len(self._debris.bodies)
        off = np.hypot(*(bodies.pos_ned_m[adrift:, :2] - place_ne_m).T)
        reach = [NEAR_M + np.hypot(*mesh.vertices_m[:, :2].T).max() for mesh in bodies.meshes[adrift:]]
        return bool((off < reach).any())

    def _is_near_fixed(self, place_ne_m: Array) -> bool:
        """Whether a fixed object rises from the water near a place, by rays from high above."""
        if self._standing is None:
            return False
        offsets = np.linspace(-_STANDING_M, _STANDING_M, _GRID)
        north, east = (grid.ravel() for grid in np.meshgrid(offsets, offsets))
        surface_down_m = self._water_down_m - self._tide_m()
        origin = np.column_stack([north, east, np.full(len(north), surface_down_m - _ABOVE_M)])
        origin[:, :2] += place_ne_m
        down = np.tile(np.array((0.0, 0.0, 1.0), dtype=np.float32), (len(origin), 1))
        range_m = self._standing.cast(origin.astype(np.float32), down).range_m
        return bool((range_m < _ABOVE_M + _AFLOAT_DOWN_M).any())

    def report(self) -> dict[str, Any]:
        """Return the counts for the summary's section `obstacles`."""
        launched = 0 if self._debris is None else len(self._debris.bodies)
        return {
            "launched": launched,
            "detected": len(self._detected_at_m),
            "detected_at_m": [self._detected_at_m.get(number) for number in range(launched)],
            "tracks": len(self._of_something),
            "false": sum(not known for known in self._of_something.values()),
            "min_clearance_m": min(self._clearance_m.values(), default=None),
        }
