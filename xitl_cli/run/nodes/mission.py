"""Node of the mission: scores it by the true track, and draws a mission that differs from the profile's."""

from __future__ import annotations

from typing import Any

from xitl_cli.profile.schema import RunProfile
from xitl_cli.run.core.node import ControlNode, RunContext, RunNode, RunStep
from xitl_cli.run.scores.mission import MissionScore, Point
from xitl_cli.run.world.scene import make_mission_scene


class MissionNode(RunNode):
    """Scores the controlling node's mission by the true track, and draws a mission that differs from the profile's.

    others: start and waypoints of such a mission, (north, east) in metres; None without one.
    """

    def __init__(self, profile: RunProfile, control: ControlNode) -> None:
        self.score = MissionScore(profile.mission.course_ned_m)
        self.others: tuple[Point, ...] | None = None
        self._profile = profile
        self._control = control

    def begin(self, context: RunContext) -> None:
        self._recorder = context.recorder

    def exchange(self, step: RunStep) -> None:
        progress, score = self._control.progress, self.score
        if progress.waypoints is not None and score.follow(progress.waypoints) and progress.waypoints:
            north, east, _ = step.motion.pos_ned_m[0].tolist()
            self.others = ((north, east), *progress.waypoints)
            if self._profile.recording.scene:
                self._recorder.scene(make_mission_scene(self._profile, self.others), step.now_ns)
        if progress.target is not None:
            north, east, _ = step.motion.pos_ned_m[0].tolist()
            score.add((north, east), progress.target, progress.reached)
        else:
            score.reached = max(score.reached, progress.reached)
            score.latest_m = None

    def report(self) -> dict[str, Any]:
        return {"mission": self.score.section()}
