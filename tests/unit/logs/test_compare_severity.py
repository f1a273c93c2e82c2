"""Two runs that are far apart are worth a warning."""

import numpy as np
import pytest

from xitl_cli.logs.compare.trajectories import PosePair, Trajectory, trajectory_section
from xitl_cli.logs.model.sections import Severity


@pytest.mark.parametrize(
    ("apart_m", "severity"), [(0.5, Severity.OK), (20.0, Severity.NOTICE), (354.0, Severity.WARNING)]
)
def test_a_distance_is_judged_by_its_size(apart_m: float, severity: Severity) -> None:
    stamps = np.arange(50, dtype=np.int64) * 10**9
    level = np.tile([1.0, 0.0, 0.0, 0.0], (50, 1))
    path = np.stack([np.arange(50.0), np.zeros(50), np.zeros(50)], axis=1)
    a, b = Trajectory(stamps, path, level), Trajectory(stamps, path + np.array([0.0, apart_m, 0.0]), level)
    pair = PosePair(a, b, None, True, True, ("A", "B"), path[:, :2])
    (distance,) = [each for each in trajectory_section(pair, "none").findings if each.key == "trajectory.distance"]
    assert distance.severity == severity
