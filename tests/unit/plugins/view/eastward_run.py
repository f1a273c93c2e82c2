"""A recording of a vessel that goes straight ahead, for tests of the view."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from sim_core.frames import euler_to_quat, quat_to_matrix
from sim_core.kinematics import Kinematics
from xitl_cli.record.recorder import Recorder
from xitl_cli.record.topics import MotionEstimate, MotorCommand

HZ, SPEED_MPS, SECONDS = 10, 2.0, 20


def run_file(path: Path, beside_m: float = 0.0, further: Callable[[Recorder], object] | None = None) -> Path:
    """A run that goes east at 2 m/s, its estimate half a metre north of it; armed after 5 s."""
    recorder = Recorder(path, "lz4")
    recorder.metadata("xitl", {"profile": "made"})
    quat = euler_to_quat(np.array([[0.0, 0.0, np.pi / 2]]))
    zero = np.zeros((1, 3))
    for step in range(SECONDS * HZ + 1):
        now_ns = step * 1_000_000_000 // HZ
        place = np.array([[beside_m, SPEED_MPS * step / HZ, 0.0]])
        velocity = np.array([[0.0, SPEED_MPS, 0.0]])
        recorder.truth(
            now_ns, Kinematics(place, velocity, zero, quat, quat_to_matrix(quat), zero, zero), np.zeros((1, 2))
        )
        off = MotionEstimate(place[0] + [0.5, 0.0, 0.0], velocity[0], quat[0], np.zeros(3))
        recorder.estimate(now_ns, off)
        recorder.fix(now_ns, -8.8 + beside_m / 110.6e3, -63.95 + place[0, 1] / 110e3, 70.0)
        recorder.environment(now_ns, np.array([0.25, 0.5, 0.0]), np.array([-3.0, 1.0, 0.0]), 0.0)
        recorder.actuators(now_ns, MotorCommand((0.4, -0.2), armed=now_ns >= 5e9), "propeller 0, propeller 1")
    if further is not None:
        further(recorder)
    recorder.close()
    return path
