"""Reports of a vessel about its own motion, from its estimate and from its true motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim_core.frames import euler_to_quat
from tests.unit.sim_core.motion import at_rest
from xitl_cli.record.topics import MotionEstimate
from xitl_cli.run.traffic.self_report import SelfReport, report_from_estimate, report_from_motion

S = 1_000_000_000


@pytest.mark.parametrize(("age_s", "moved_s"), [(0.4, 0.4), (1.0, 1.0), (3.0, 1.0), (-1.0, 0.0)])
def test_a_report_is_extrapolated_for_a_second_at_most(age_s: float, moved_s: float) -> None:
    report = SelfReport(5 * S, (10.0, 20.0), (2.0, -3.0), 0.5)
    now_ns = round((5.0 + age_s) * S)
    later = report.carried_on(now_ns)
    assert later.pos_ne_m == pytest.approx((10.0 + 2.0 * moved_s, 20.0 - 3.0 * moved_s))
    assert later == report._replace(at_ns=now_ns, pos_ne_m=later.pos_ne_m)


@pytest.mark.parametrize(
    ("deviation_m", "accurate"),
    [((4.08, 1.0, 9.0), True), ((1.0, 4.09, 1.0), False), (None, False)],  # 95 % of errors are below 2.448 deviations
)
def test_an_estimate_is_reported_with_heading_turn_and_accuracy(
    deviation_m: tuple[float, float, float] | None, accurate: bool
) -> None:
    estimate = MotionEstimate(
        np.array([1.0, 2.0, 3.0]),
        np.array([0.4, -0.5, 0.6]),
        np.array(euler_to_quat(np.array([[0.2, -0.1, 2.0]])))[0],
        np.array([0.01, 0.02, 0.03]),
        None if deviation_m is None else np.array(deviation_m),
    )
    report = report_from_estimate(7, estimate, True)
    assert report == SelfReport(7, (1.0, 2.0), (0.4, -0.5), pytest.approx(2.0), 0.03, accurate, True)


def test_a_true_motion_is_reported_by_its_row() -> None:
    motion = at_rest(2, [[0.0, 0.0, 1.0], [0.2, -0.1, -2.5]], [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    motion = replace(
        motion,
        vel_ned_mps=np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]]),
        gyro_frd_radps=np.array([[0.0, 0.0, 0.1], [0.0, 0.0, -0.2]]),
    )
    report = report_from_motion(7, motion, 1)
    assert report == SelfReport(7, (4.0, 5.0), (0.4, 0.5), pytest.approx(-2.5), -0.2, True, True)
