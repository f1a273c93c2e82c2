"""Scores the distances between the vessels of a fleet, and which vessel had to give way."""

from __future__ import annotations

from typing import Any

import numpy as np

from sim_core.fleet import Fleet, FleetState, joined_motion
from xitl_cli.record.topics import EncounterState
from xitl_cli.run.core.node import RunContext, RunNode, RunStep
from xitl_cli.run.traffic.encounter_watch import ClosestApproach, EncounterWatch, HullPlans, PairState
from xitl_cli.run.world.plant import Plant

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
