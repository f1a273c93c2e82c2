"""The course of a vessel by the truth: the score of its mission, and its distance and speed in a fleet."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from xitl_cli.profile.schema import RunProfile
from xitl_cli.run.core.node import ControlNode, RunContext, RunNode, RunStep
from xitl_cli.run.core.scores import MissionScore, Point
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
            north, east, _ = step.motion.pos_ned_m.tolist()[0]
            self.others = ((north, east), *progress.waypoints)
            if self._profile.recording.scene:
                self._recorder.scene(make_mission_scene(self._profile, self.others), step.now_ns)
        if progress.target is not None:
            north, east, _ = step.motion.pos_ned_m.tolist()[0]
            score.add((north, east), progress.target, progress.reached)
        else:
            score.reached = max(score.reached, progress.reached)
            score.latest_m = None

    def report(self) -> dict[str, Any]:
        return {"mission": self.score.section()}


class TrackNode(RunNode):
    """Adds up the distance over ground at each exchange, while the vessel is not held."""

    def __init__(self, control: ControlNode) -> None:
        self._control = control
        self._place: tuple[float, float] | None = None
        self._path_m = 0.0
        self._speed_mps = self._most_mps = 0.0
        self._rot_ned_frd = np.eye(3)
        self._first_ns = self._now_ns = 0

    def exchange(self, step: RunStep) -> None:
        motion = step.motion
        north_m, east_m, _ = motion.pos_ned_m.tolist()[0]
        north_mps, east_mps, _ = motion.vel_ned_mps.tolist()[0]
        self._rot_ned_frd = motion.rot_ned_frd[0]
        if self._place is None or step.held:
            self._first_ns = step.now_ns
        else:
            self._path_m += math.dist(self._place, (north_m, east_m))
        self._place, self._now_ns = (north_m, east_m), step.now_ns
        self._speed_mps = math.hypot(north_mps, east_mps)
        self._most_mps = max(self._most_mps, self._speed_mps)

    def report(self) -> dict[str, Any]:
        """Return `track`: mode, place, heading and speed at the end; path and speeds over ground of the whole run."""
        progress, length_s = self._control.progress, (self._now_ns - self._first_ns) * 1e-9
        north_m, east_m = self._place or (None, None)
        forward_ned = self._rot_ned_frd[:, 0]
        return {
            "track": {
                "mode": progress.mode,
                "armed": progress.armed,
                "north_m": north_m,
                "east_m": east_m,
                "heading_deg": math.degrees(math.atan2(forward_ned[1], forward_ned[0])) % 360.0,
                "speed_mps": self._speed_mps,
                "path_m": self._path_m,
                "speed_mean_mps": self._path_m / length_s if length_s > 0.0 else None,
                "speed_max_mps": self._most_mps,
            }
        }
