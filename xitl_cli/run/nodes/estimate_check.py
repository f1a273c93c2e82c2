"""What an autopilot believes, held against what was true at that instant."""

from __future__ import annotations

import math

from sim_core.kinematics import Kinematics
from xitl_cli.record.records import Estimate
from xitl_cli.run.nodes.score import EstimationScore
from xitl_cli.run.nodes.truth_history import TruthHistory


class EstimateCheck:
    """Truth goes in as it happens, estimates as they come. score: of those while armed, position_error_m: newest."""

    def __init__(self, physics_rate_hz: float) -> None:
        self._history = TruthHistory(physics_rate_hz)
        self.score = EstimationScore()
        self.position_error_m: float | None = None

    def add_truth(self, sim_ns: int, motion: Kinematics) -> None:
        """After every physics step."""
        self._history.add(sim_ns, motion)

    def add_estimate(self, stamp_ns: int | None, estimate: Estimate, armed: bool) -> None:
        """Of the instant `stamp_ns`; passed over where that is not known, or too long ago."""
        truth = None if stamp_ns is None else self._history.at(stamp_ns)
        if truth is None:
            return
        north, east = (estimate.pos_ned_m - truth.pos_ned_m[0])[:2].tolist()
        self.position_error_m = math.hypot(north, east)
        if armed:
            self.score.add(truth.pos_ned_m[0], truth.quat_ned_frd[0], estimate.pos_ned_m, estimate.quat_ned_frd)
