"""When another autopilot got how far, on simulation time."""

from __future__ import annotations

import math
from dataclasses import dataclass

from sim_core.kinematics import Kinematics
from xitl_cli.record.records import MotorCommand
from xitl_cli.run.links.agent_view import AgentView

MOVES_MPS = 0.2
DRIVES = 0.02


@dataclass(slots=True)
class Milestones:
    """Seconds from the start of the run; None until then.

    heartbeat: first heard. origin: its estimator has an origin. ready: its pre-arm checks pass. armed. motion: after
    arming, the motors turn and the vessel makes more than `MOVES_MPS` over ground.
    """

    heartbeat_s: float | None = None
    origin_s: float | None = None
    ready_s: float | None = None
    armed_s: float | None = None
    motion_s: float | None = None

    def update(self, sim_ns: int, view: AgentView, command: MotorCommand, motion: Kinematics) -> None:
        """Look at every exchange."""
        now_s = sim_ns * 1e-9
        if self.heartbeat_s is None and view.heard:
            self.heartbeat_s = now_s
        if self.origin_s is None and view.has_origin:
            self.origin_s = now_s
        if self.ready_s is None and view.ready_to_arm:
            self.ready_s = now_s
        if self.armed_s is None and view.armed:
            self.armed_s = now_s
        if self.motion_s is None and self.armed_s is not None and max(map(abs, command.motors)) > DRIVES:
            north_mps, east_mps, _ = motion.vel_ned_mps[0].tolist()
            if math.hypot(north_mps, east_mps) > MOVES_MPS:
                self.motion_s = now_s
