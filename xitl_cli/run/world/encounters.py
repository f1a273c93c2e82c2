"""Debris that meets the vessel on its way: drawn from the seed and launched when the vessel approaches.

A body is to be at its place on the legs when the vessel arrives. It is launched when the vessel is `ahead_m` before
that place. The launch point is as far up the current as the body drifts in that time at the mission's speed. The launch
depends on the vessel's distance and not on the clock. A vessel that starts late or makes a detour meets the same
bodies.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy import bool_, float64
from numpy.random import Generator
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from sim_core.environment.spec import Water
from sim_core.world.debris import USUAL_LENGTH_M, BodyKind, Launch, make_body
from sim_core.world.waterway import Waterway
from xitl_cli.profile.schema.world import EncountersSpec

Array = NDArray[float64]
Point = tuple[float, float]

SIZES = (0.7, 1.3)  # of the usual length
CLEAR_M = 0.5  # from fixed objects, at the launch
_SPREAD = 0.6  # of each body's share of the way, for its random place


@dataclass(frozen=True, slots=True)
class DebrisEncounter:
    """A body that the vessel encounters on its mission."""

    along_m: float
    """Distance of the encounter along the legs, from the start of the mission."""
    ahead_m: float
    """Remaining distance of the vessel to the encounter at the launch of the body."""
    right_m: float
    """Offset of the encounter to the right of the legs."""
    kind: BodyKind
    length_m: float
    heading_rad: float


def draw_encounters(keys: EncountersSpec, legs_m: float, rng: Generator) -> tuple[DebrisEncounter, ...]:
    """Return `count` encounters on legs of this total length, each on its own share of the way, in order."""
    if not keys.count or not keys.kinds:
        return ()
    near_m, far_m = min(keys.ahead_m), max(keys.ahead_m)
    first_m = min(far_m, 0.5 * legs_m)
    share_m = (legs_m - first_m) / keys.count
    made = []
    for number in range(keys.count):
        kind = BodyKind[keys.kinds[int(rng.integers(len(keys.kinds)))].upper()]
        made.append(
            DebrisEncounter(
                along_m=first_m + share_m * (number + 0.5 + _SPREAD * (rng.random() - 0.5)),
                ahead_m=float(rng.uniform(near_m, far_m)),
                right_m=float(rng.uniform(-keys.off_m, keys.off_m)),
                kind=kind,
                length_m=round(USUAL_LENGTH_M[kind] * float(rng.uniform(*SIZES)), 2),
                heading_rad=float(rng.uniform(0.0, 2.0 * math.pi)),
            )
        )
    return tuple(made)


class MissionLegs:
    """The way through places (north, east). The first place is its start."""

    def __init__(self, places_ne_m: Sequence[Point]) -> None:
        self._places = np.array(places_ne_m, dtype=float64)
        steps = np.diff(self._places, axis=0)
        self._lengths = np.hypot(steps[:, 0], steps[:, 1])
        self._ends = np.cumsum(self._lengths)
        self._ahead = steps / np.maximum(self._lengths, 1e-9)[:, None]

    @property
    def length_m(self) -> float:
        """Total length."""
        return float(self._ends[-1]) if len(self._ends) else 0.0

    def along_m(self, place_ne_m: Point, target: int) -> float:
        """Return the distance along the way of a vessel on leg `target`, by its remaining distance to the leg's end."""
        to_go = math.dist(place_ne_m, self._places[target + 1].tolist())
        return float(self._ends[target] - min(to_go, self._lengths[target]))

    def place(self, along_m: float, right_m: float) -> Array:
        """Return a place (2,) at a distance along and to the right of the way."""
        leg = min(int(np.searchsorted(self._ends, along_m)), len(self._ends) - 1)
        ahead = self._ahead[leg]
        back_m = self._ends[leg] - along_m
        place: Array = self._places[leg + 1] - back_m * ahead + right_m * np.array([-ahead[1], ahead[0]])
        return place


class DebrisEncounters:
    """The encounters of one run. `current_ned_mps`: returns the mean current (1, 3) at a place (1, 3). `tide_m`:
    returns the height of the still water above its mean level now. wind_ne_mps: returns the wind at 10 m (2,).

    no_room: encounters that were left out because of a fixed object at the meeting place.
    """

    def __init__(
        self,
        encounters: Sequence[DebrisEncounter],
        legs: MissionLegs,
        speed_mps: float,
        current_ned_mps: Callable[[Array], Array],
        waterway: Waterway,
        water: Water,
        tide_m: Callable[[], float] = lambda: 0.0,
        wind_ne_mps: Callable[[], Array] = lambda: np.zeros(2),
    ) -> None:
        self._left = list(encounters)
        self._legs = legs
        self._speed_mps = speed_mps
        self._current_ned_mps = current_ned_mps
        self._waterway = waterway
        self._water, self._tide_m, self._wind_ne_mps = water, tide_m, wind_ne_mps
        self.no_room = 0

    def due(self, now_ns: int, place_ne_m: Point, target: int | None) -> list[Launch]:
        """Return the launches that are due for a vessel at a place that heads for waypoint `target`."""
        if not self._left or target is None:
            return []
        along_m = self._legs.along_m(place_ne_m, target)
        launches = []
        while self._left and self._left[0].along_m - along_m <= self._left[0].ahead_m:
            launch = self._launch(now_ns, self._left.pop(0), along_m)
            if launch is None:
                self.no_room += 1
            else:
                launches.append(launch)
        return launches

    def _launch(self, now_ns: int, encounter: DebrisEncounter, along_m: float) -> Launch | None:
        """Return a launch as far up the current as the way is free.

        None when the body does not fit at the meeting place.
        """
        body = make_body(encounter.kind, encounter.length_m, self._water.density_kgpm3)
        meeting = self._legs.place(encounter.along_m, encounter.right_m)
        left_s = max(encounter.along_m - along_m, 0.0) / self._speed_mps
        current = self._current_ned_mps(np.array([[*meeting, 0.0]]))[0, :2]
        heading = np.array([math.cos(encounter.heading_rad), math.sin(encounter.heading_rad)])
        drift_m = left_s * (current + body.windage * self._wind_ne_mps() + body.swim_mps * heading)
        steps = int(np.hypot(*drift_m) / CLEAR_M) + 1
        way = meeting - np.linspace(0.0, 1.0, steps + 1)[:, None] * drift_m
        free = np.ones(len(way), dtype=bool_)  # whether the body would float freely at each place
        around_m = body.half_axis_m + body.radius_m + CLEAR_M
        standing, bed = self._waterway.standing, self._waterway.bed
        if len(standing):
            free &= standing.distance_m(way).min(axis=1) > around_m
        if bed is not None:
            free &= bed.bed_down_m(way) - self._water_down_m() > body.draught_m + CLEAR_M
        if not free[0]:
            return None
        north, east = way[-1 if free.all() else int(free.argmin()) - 1].tolist()
        return Launch(now_ns, encounter.kind, north, east, encounter.heading_rad, encounter.length_m)

    def afloat(self, north_m: float, east_m: float) -> bool:
        """Whether a place has water and no fixed object."""
        place, (standing, bed) = np.array([[north_m, east_m]]), (self._waterway.standing, self._waterway.bed)
        if len(standing) and standing.distance_m(place).min() < 0.0:
            return False
        return bed is None or bool(bed.bed_down_m(place)[0] > self._water_down_m())

    def _water_down_m(self) -> float:
        return -(self._water.level_m + self._tide_m())
