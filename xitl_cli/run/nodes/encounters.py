"""Scores the distances between the vessels of a fleet, and which vessel had to give way.

Closest approach of every pair of vessels, and the start of each encounter with risk of collision. All pairs are
evaluated together: P = N (N - 1) / 2 of N vessels, (0, 1), (0, 2) … (1, 2) …
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy import bool_, intp
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from sim_core.fleet import Fleet, FleetState, joined_motion
from sim_core.frames import Array
from sim_core.world.plan import nearest_on_axis
from xitl_cli.record.topics import EncounterState
from xitl_cli.run.core.node import RunContext, RunNode, RunStep
from xitl_cli.run.traffic.colreg import EncounterGeometry, encounter_geometry
from xitl_cli.run.world.plant import Plant

RISK_DISTANCES = 3.0  # of the encounter distance: a predicted approach nearer than that is a risk
RISK_S = 120.0  # if it is not later than that
LEAST_CLOSING_MPS = 0.2  # a slower approach is none, because vessels that keep station sway
_ROUNDING_M = 1e-9  # of a hull distance
PLOTTING_S = 3.0  # time for which it must hold, because bearings are watched for a while (rule 7)

EncounterEvent = Literal["begins", "too close", "passes"]


@dataclass(frozen=True, slots=True, eq=False)
class HullPlans:
    """Hulls of N vessels in plan, H each, as capsules. A vessel with fewer hulls repeats its first."""

    axes_frd_m: Array
    """(N, H, 2, 2), ends (forward, starboard) of the axes from the vessel's place."""
    radius_m: Array
    """(N, H)."""

    @classmethod
    def from_capsules(cls, vessels: Sequence[tuple[Array, Array]]) -> HullPlans:
        """Return the hulls from (H, 2, 2) axes and (H,) radii for each vessel."""
        most = max(len(radius_m) for _, radius_m in vessels)
        rows = [[*range(len(radius_m)), *[0] * (most - len(radius_m))] for _, radius_m in vessels]
        axes = np.array([axes_m[row] for (axes_m, _), row in zip(vessels, rows, strict=True)], dtype=float)
        radii = np.array([radius_m[row] for (_, radius_m), row in zip(vessels, rows, strict=True)], dtype=float)
        return cls(axes, radii)

    @property
    def reach_m(self) -> Array:
        """(N,): largest distance of a hull's part from the vessel's place."""
        ends = np.hypot(self.axes_frd_m[..., 0], self.axes_frd_m[..., 1]).max(axis=2) + self.radius_m
        reach: Array = ends.max(axis=1)
        return reach

    def distance_m(
        self,
        first: NDArray[intp],
        second: NDArray[intp],
        places_ne_m: tuple[Array, Array],
        yaws_rad: tuple[Array, Array],
    ) -> Array:
        """Return the distance (P,) between the hulls of vessels first (P,) and second (P,), 0 if they touch.

        places_ne_m: (P, 2) of the first and of the second. yaws_rad: (P,), (P,).
        """
        a, b = (
            _turned(self.axes_frd_m[numbers], yaw_rad) + place[:, None, None]
            for numbers, place, yaw_rad in zip((first, second), places_ne_m, yaws_rad, strict=True)
        )
        reach = self.radius_m[first][:, :, None] + self.radius_m[second][:, None, :]
        gap = _axes_distance_m(a[:, :, None], b[:, None, :]) - reach
        distance: Array = np.maximum(gap.min(axis=(1, 2)), 0.0)
        return distance


@dataclass(frozen=True, slots=True)
class ClosestApproach:
    """Closest approach of one pair so far."""

    first: str
    second: str
    distance_m: float
    """Between the places, at at_s."""
    at_s: float
    hull_distance_m: float
    """Between the hulls, at hull_at_s."""
    hull_at_s: float
    too_close: bool
    """The hulls were nearer than allowed."""
    geometry: EncounterGeometry | None
    """None without a risk of collision."""
    detected_s: float | None

    @property
    def gives_way(self) -> tuple[str, ...]:
        """Names of the vessels that give way."""
        geometry, names = self.geometry, (self.first, self.second)
        return () if geometry is None else tuple(names[number] for number in geometry.gives_way)

    @property
    def stands_on(self) -> str | None:
        """Name of the vessel that keeps course and speed."""
        number = None if self.geometry is None else self.geometry.stands_on
        return None if number is None else (self.first, self.second)[number]


class PairState(NamedTuple):
    """Relative state of two vessels now."""

    pair: int
    event: EncounterEvent | None
    """Event of this update, if any."""
    distance_m: float
    closing_mps: float
    predicted_m: float
    """Distance of their places at the predicted closest approach, with constant velocities."""
    predicted_s: float
    """Time until the predicted closest approach."""


class EncounterWatch:
    """Checks all pairs of vessels and reports hulls nearer than `too_close_m`.

    Between two updates all motion is taken as linear, and the closest approach in between is found.
    """

    def __init__(self, names: Sequence[str], hulls: HullPlans, too_close_m: float) -> None:
        self.names = tuple(names)
        self._hulls = hulls
        self._too_close_m = too_close_m
        self.first, self.second = np.triu_indices(len(self.names), 1)
        count = len(self.first)
        self._reach_m = hulls.reach_m[self.first] + hulls.reach_m[self.second]
        self._distance_m, self._at_s = np.full(count, math.inf), np.zeros(count)
        self._hull_m, self._hull_at_s = np.full(count, math.inf), np.zeros(count)
        self._least_hull_m = np.zeros(count)
        """The hulls were not nearer than that at the latest update."""
        self._risk_since_s = np.full(count, math.inf)
        self._under_way = np.zeros(count, dtype=bool_)  # an encounter that is not over
        self._near = np.zeros(count, dtype=bool_)
        self._detected: dict[int, tuple[float, EncounterGeometry]] = {}
        self._last: tuple[float, Array, Array] | None = None

    def update(self, now_s: float, pos_ne_m: Array, vel_ne_mps: Array, yaw_rad: Array) -> list[PairState]:
        """Update with (N, 2), (N, 2), (N,).

        Returns the pairs in an encounter, and pairs with an encounter that just ended.
        """
        i, j = self.first, self.second
        before_s, before_m, before_rad = self._last or (now_s, pos_ne_m, yaw_rad)
        self._last = now_s, pos_ne_m.copy(), yaw_rad.copy()
        between_m, rate_mps = pos_ne_m[j] - pos_ne_m[i], vel_ne_mps[j] - vel_ne_mps[i]
        distance_m = np.sqrt(np.vecdot(between_m, between_m))

        # The closest approach since the last update.
        started_m = before_m[j] - before_m[i]
        moved_m = between_m - started_m
        square = np.vecdot(moved_m, moved_m)
        share = np.clip(-np.vecdot(started_m, moved_m) / np.where(square > 0.0, square, 1.0), 0.0, 1.0)
        share[square <= 0.0] = 1.0
        nearest = started_m + share[:, None] * moved_m
        nearest_m, nearest_s = np.sqrt(np.vecdot(nearest, nearest)), before_s + share * (now_s - before_s)
        closer = nearest_m < self._distance_m
        self._distance_m[closer], self._at_s[closer] = nearest_m[closer], nearest_s[closer]
        turn_rad = np.remainder(yaw_rad - before_rad + np.pi, 2.0 * np.pi) - np.pi
        swing_m = self._hulls.reach_m * np.abs(turn_rad)
        change_m = np.sqrt(square) + swing_m[i] + swing_m[j]
        self._update_hulls(nearest_m, nearest_s, share, change_m, (before_m, pos_ne_m), (before_rad, turn_rad))

        # Risk of collision, with constant velocities.
        speed2 = np.vecdot(rate_mps, rate_mps)
        ahead_s = -np.vecdot(between_m, rate_mps) / np.where(speed2 > 0.0, speed2, 1.0)
        passing = between_m + np.maximum(ahead_s, 0.0)[:, None] * rate_mps
        predicted_m = np.sqrt(np.vecdot(passing, passing))
        closing_mps = -np.vecdot(between_m, rate_mps) / np.maximum(distance_m, 1e-9)
        clear_m = predicted_m - self._reach_m
        risk = (closing_mps > LEAST_CLOSING_MPS) & (ahead_s <= RISK_S)
        risk &= clear_m < RISK_DISTANCES * self._too_close_m
        self._risk_since_s = np.where(risk, np.minimum(self._risk_since_s, now_s), math.inf)

        begun = ~self._under_way & (now_s - self._risk_since_s >= PLOTTING_S)
        passed = self._under_way & (ahead_s < 0.0) & (closing_mps < -LEAST_CLOSING_MPS)
        near = self._hull_m < self._too_close_m
        events: dict[int, EncounterEvent] = dict.fromkeys(np.flatnonzero(passed).tolist(), "passes")
        events |= dict.fromkeys(np.flatnonzero(near & ~self._near).tolist(), "too close")
        events |= dict.fromkeys(np.flatnonzero(begun).tolist(), "begins")
        self._near = near
        self._under_way = (self._under_way | begun) & ~passed
        for pair in np.flatnonzero(begun).tolist():
            if pair not in self._detected:
                both = [int(self.first[pair]), int(self.second[pair])]
                (north0, east0), (north1, east1) = pos_ne_m[both].tolist()
                yaw0, yaw1 = yaw_rad[both].tolist()
                speed0, speed1 = np.hypot(*vel_ne_mps[both].T).tolist()
                geometry = encounter_geometry(((north0, east0), (north1, east1)), (yaw0, yaw1), (speed0, speed1))
                self._detected[pair] = now_s, geometry
        reported = sorted({*events, *np.flatnonzero(self._under_way).tolist()})
        return [
            PairState(
                pair, events.get(pair), *(float(of[pair]) for of in (distance_m, closing_mps, predicted_m, ahead_s))
            )
            for pair in reported
        ]

    def approach(self, pair: int) -> ClosestApproach:
        """Return the closest approach of one pair so far."""
        detected = self._detected.get(pair)
        return ClosestApproach(
            self.names[self.first[pair]],
            self.names[self.second[pair]],
            float(self._distance_m[pair]),
            float(self._at_s[pair]),
            float(self._hull_m[pair]),
            float(self._hull_at_s[pair]),
            bool(self._hull_m[pair] < self._too_close_m),
            None if detected is None else detected[1],
            None if detected is None else detected[0],
        )

    def approaches(self) -> list[ClosestApproach]:
        """Return the closest approaches of all pairs, empty before the first update."""
        return [] if self._last is None else [self.approach(pair) for pair in range(len(self.first))]

    def _update_hulls(
        self,
        nearest_m: Array,
        nearest_s: Array,
        share: Array,
        change_m: Array,
        places: tuple[Array, Array],
        turns: tuple[Array, Array],
    ) -> None:
        """Compute hull distances only for pairs that can be nearer than before.

        change_m: most that a hull distance can have changed since the last update. turns: yaw then, and change of it.
        """
        self._least_hull_m -= change_m + _ROUNDING_M
        pairs = np.flatnonzero((nearest_m - self._reach_m < self._hull_m) & (self._least_hull_m < self._hull_m))
        if not len(pairs):
            return
        first, second, part = self.first[pairs], self.second[pairs], share[pairs]
        where = [
            (
                places[0][numbers] + part[:, None] * (places[1][numbers] - places[0][numbers]),
                turns[0][numbers] + part * turns[1][numbers],
            )
            for numbers in (first, second)
        ]
        hull_m = self._hulls.distance_m(first, second, (where[0][0], where[1][0]), (where[0][1], where[1][1]))
        self._least_hull_m[pairs] = hull_m - change_m[pairs]
        nearer = hull_m < self._hull_m[pairs]
        self._hull_m[pairs[nearer]], self._hull_at_s[pairs[nearer]] = hull_m[nearer], nearest_s[pairs[nearer]]


def _turned(axes_frd_m: Array, yaw_rad: Array) -> Array:
    """Rotate (P, H, 2, 2) from forward, starboard to north, east."""
    cosine, sine = np.cos(yaw_rad)[:, None, None], np.sin(yaw_rad)[:, None, None]
    forward, right = axes_frd_m[..., 0], axes_frd_m[..., 1]
    return np.stack([forward * cosine - right * sine, forward * sine + right * cosine], axis=-1)


def _axes_distance_m(a: Array, b: Array) -> Array:
    """Return the distance between straight axes (..., 2, 2): of an end from the other axis, or 0 if they cross."""
    a0, a1, b0, b1 = a[..., 0, :], a[..., 1, :], b[..., 0, :], b[..., 1, :]
    gaps = []
    for point, start, end in ((a0, b0, b1), (a1, b0, b1), (b0, a0, a1), (b1, a0, a1)):
        nearest, _ = nearest_on_axis(point, start, end)
        gaps.append(np.linalg.norm(point - nearest, axis=-1))
    crossing = (_side(a0, a1, b0) * _side(a0, a1, b1) < 0.0) & (_side(b0, b1, a0) * _side(b0, b1, a1) < 0.0)
    distance: Array = np.where(crossing, 0.0, np.minimum.reduce(gaps))
    return distance


def _side(start: Array, end: Array, point: Array) -> Array:
    along, across = end - start, point - start
    side: Array = along[..., 0] * across[..., 1] - along[..., 1] * across[..., 0]
    return side


WATCH_HZ = 10.0
TOLD_S = 1.0  # interval between two records of an active encounter


class EncounterNode(RunNode):
    """Watches all pairs by the truth, with scripted vessels; reports hulls nearer than `too_close_m`."""

    def __init__(self, plant: Plant, fleet: Fleet, too_close_m: float, physics_rate_hz: float) -> None:
        self._plant = plant
        self._fleet = fleet
        self.record_every = max(round(physics_rate_hz / WATCH_HZ), 1)
        own, scripted = len(fleet.names), len(fleet.traffic)
        self._order = np.concatenate([np.argsort(np.concatenate(fleet.members)), own + np.arange(scripted)])
        outlines = [fleet.of(number).outline for number in range(own)] + [vessel.outline for vessel in fleet.traffic]
        names = [*fleet.names, *(vessel.name for vessel in fleet.traffic)]
        plans = [(outline.ends_frd_m[:, :2].reshape(-1, 2, 2), outline.radius_m) for outline in outlines]
        self._watch = EncounterWatch(names, HullPlans.from_capsules(plans), too_close_m)
        self._too_close_m = too_close_m
        self._told_s: dict[int, float] = {}

    def begin(self, context: RunContext) -> None:
        self._recorder = context.recorder

    def record(self, step: RunStep) -> None:
        state, now_s = self._plant.state, step.now_ns * 1e-9
        assert isinstance(state, FleetState)
        motion = joined_motion(self._fleet, state)
        rotation = motion.rot_ned_frd[self._order]
        yaw_rad = np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0])
        places, rates = motion.pos_ned_m[self._order, :2], motion.vel_ned_mps[self._order, :2]
        for pair in self._watch.update(now_s, places, rates, yaw_rad):
            if pair.event is not None or now_s - self._told_s.get(pair.pair, -TOLD_S) >= TOLD_S - 1e-6:
                self._told_s[pair.pair] = now_s
                self._recorder.write(step.now_ns, _record(pair, self._watch.approach(pair.pair)))

    def report(self) -> dict[str, Any]:
        """Return `encounters`: see docs/fleets.md."""
        approaches = self._watch.approaches()
        nearest = min(approaches, key=lambda approach: approach.hull_distance_m, default=None)
        pairs = []
        for approach in approaches:
            geometry = approach.geometry
            pairs.append(
                {
                    "vessels": [approach.first, approach.second],
                    "distance_m": approach.hull_distance_m,
                    "at_s": approach.hull_at_s,
                    "centre_distance_m": approach.distance_m,
                    "centre_at_s": approach.at_s,
                    "too_close": approach.too_close,
                    "rule": None if geometry is None else geometry.rule,
                    "geometry": None if geometry is None else geometry.geometry,
                    "gives_way": list(approach.gives_way),
                    "stands_on": approach.stands_on,
                    "bearings_deg": None if geometry is None else list(geometry.bearings_deg),
                    "detected_s": approach.detected_s,
                }
            )
        return {
            "encounters": {
                "encounter_distance_m": self._too_close_m,
                "closest_m": None if nearest is None else nearest.hull_distance_m,
                "closest": None if nearest is None else [nearest.first, nearest.second],
                "too_close": sum(approach.too_close for approach in approaches),
                "pairs": pairs,
            }
        }


def _record(pair: PairState, approach: ClosestApproach) -> EncounterState:
    geometry = approach.geometry
    return EncounterState(
        first=approach.first,
        second=approach.second,
        event=pair.event or "",
        rule=0 if geometry is None else geometry.rule,
        geometry="" if geometry is None else geometry.geometry,
        gives_way=", ".join(approach.gives_way),
        stands_on=approach.stands_on or "",
        distance_m=pair.distance_m,
        closing_mps=pair.closing_mps,
        predicted_m=pair.predicted_m,
        predicted_s=pair.predicted_s,
        hull_closest_m=approach.hull_distance_m,
    )
