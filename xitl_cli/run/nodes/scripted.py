"""Records the scripted vessels of a fleet, and draws them."""

from __future__ import annotations

import numpy as np

from sim_core.fleet import Fleet
from sim_core.kinematics import Kinematics
from sim_core.world.traffic import scripted_motion
from xitl_cli.record.recorder import Recorder
from xitl_cli.run.core.node import RunContext, RunNode, RunStep
from xitl_cli.run.world.scene import make_scripted_scene

NO_ROTORS = np.empty((1, 0))


class ScriptedRecorder(RunNode):
    """Records state, odometry and pose of each scripted vessel on topics with its name."""

    def __init__(self, fleet: Fleet, physics_rate_hz: float, truth_rate_hz: float, drawn: bool) -> None:
        self._vessels, self._tide = fleet.traffic, fleet.environment.tide
        self._every = round(physics_rate_hz / truth_rate_hz)
        self._drawn = drawn
        self._recorders: list[Recorder] = []

    def begin(self, context: RunContext) -> None:
        self._recorders = [context.recorder.of_vessel(vessel.name) for vessel in self._vessels]
        if self._drawn:
            context.recorder.scene(make_scripted_scene(self._vessels))

    def record(self, step: RunStep) -> None:
        if step.number % self._every:
            return
        now_s = step.now_ns * 1e-9
        motion = scripted_motion(self._vessels, now_s, self._tide.height_m(now_s))
        for row, recorder in enumerate(self._recorders):
            recorder.truth(step.now_ns, _row(motion, row), NO_ROTORS)


def _row(motion: Kinematics, row: int) -> Kinematics:
    one = slice(row, row + 1)
    return Kinematics(
        motion.pos_ned_m[one],
        motion.vel_ned_mps[one],
        motion.acc_ned_mps2[one],
        motion.quat_ned_frd[one],
        motion.rot_ned_frd[one],
        motion.gyro_frd_radps[one],
        motion.angular_acc_frd_radps2[one],
    )
