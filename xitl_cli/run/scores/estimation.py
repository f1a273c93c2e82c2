"""The autopilot's estimate against the truth of the same instant."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim_core.kinematics import Kinematics
from xitl_cli.record.topics import MotionEstimate
from xitl_cli.run.scores.mission import RootMeanSquare

KEPT_S = 1.0


class TruePose(NamedTuple):
    """True position (3,) and attitude (4,) at an instant."""

    pos_ned_m: NDArray[np.float64]
    quat_ned_frd: NDArray[np.float64]


class TruthHistory:
    """Pose at regular instants. The rest of the motion is not kept, so that its memory is reused."""

    def __init__(self, rate_hz: float) -> None:
        self._period_ns = 1e9 / rate_hz
        self._poses: deque[tuple[NDArray[np.float64], NDArray[np.float64]]] = deque(
            maxlen=max(round(KEPT_S * rate_hz), 1)
        )
        self._newest_ns = 0

    def add(self, stamp_ns: int, motion: Kinematics) -> None:
        """Add the motion at `stamp_ns`."""
        self._newest_ns = stamp_ns
        self._poses.append((motion.pos_ned_m, motion.quat_ned_frd))

    def at(self, stamp_ns: int) -> TruePose | None:
        """Return the pose nearest to an instant.

        Too old an instant gives None, and a future one the newest pose.
        """
        back = max(round((self._newest_ns - stamp_ns) / self._period_ns), 0)
        if back >= len(self._poses):
            return None
        pos_ned_m, quat_ned_frd = self._poses[-1 - back]
        return TruePose(pos_ned_m[0], quat_ned_frd[0])


class EstimationScore:
    """Horizontal position error and heading error of the autopilot's estimate against the truth."""

    def __init__(self) -> None:
        self._position = RootMeanSquare()
        self._normalised = RootMeanSquare()
        self._heading = RootMeanSquare()
        self._normalised_heading = RootMeanSquare()

    def add(
        self,
        true_pos_ned_m: NDArray[np.float64],
        true_quat_ned_frd: NDArray[np.float64],
        pos_ned_m: NDArray[np.float64],
        quat_ned_frd: NDArray[np.float64],
        pos_deviation_ned_m: NDArray[np.float64] | None = None,
        yaw_deviation_rad: float | None = None,
    ) -> None:
        """Add an estimate and the truth of the same instant; positions (3,), quaternions (4,)."""
        north, east = (pos_ned_m - true_pos_ned_m)[:2].tolist()
        self._position.add(north * north + east * east)
        if pos_deviation_ned_m is not None and pos_deviation_ned_m[:2].all():
            north, east = ((pos_ned_m - true_pos_ned_m) / pos_deviation_ned_m)[:2].tolist()
            self._normalised.add(north * north + east * east)
        error = math.remainder(_yaw_rad(quat_ned_frd) - _yaw_rad(true_quat_ned_frd), math.tau)
        self._heading.add(math.degrees(error) ** 2)
        if yaw_deviation_rad:
            self._normalised_heading.add((error / yaw_deviation_rad) ** 2)

    @property
    def position_rms_m(self) -> float | None:
        """Root mean square of the position error; None without an estimate."""
        return self._position.value()

    @property
    def position_nees(self) -> float | None:
        """Mean of the squared horizontal error over its variance (Bar-Shalom, Li and Kirubarajan 2001, 5.4).

        It is 2 for a consistent estimator, and None when the estimator gives no position accuracy.
        """
        rms = self._normalised.value()
        return None if rms is None else rms * rms

    @property
    def heading_rms_deg(self) -> float | None:
        """Root mean square of the heading error; None without an estimate."""
        return self._heading.value()

    @property
    def heading_nees(self) -> float | None:
        """Mean of the squared heading error over its variance: 1 if it is consistent, None without a variance."""
        rms = self._normalised_heading.value()
        return None if rms is None else rms * rms


def _yaw_rad(quat: NDArray[np.float64]) -> float:
    w, x, y, z = quat.tolist()
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


class EstimateCheck:
    """Compares estimates with the truth.

    rate_hz: of the truth. score: of the estimates while armed. position_error_m: of the newest estimate.
    """

    def __init__(self, rate_hz: float) -> None:
        self._history = TruthHistory(rate_hz)
        self.score = EstimationScore()
        self.position_error_m: float | None = None

    def add_truth(self, sim_ns: int, motion: Kinematics) -> None:
        """Add the truth. Call this `rate_hz` times a second."""
        self._history.add(sim_ns, motion)

    def add_estimate(self, stamp_ns: int | None, estimate: MotionEstimate, armed: bool) -> None:
        """Add an estimate of the instant `stamp_ns`. Ignore it if the instant is unknown or too old."""
        truth = None if stamp_ns is None else self._history.at(stamp_ns)
        if truth is None:
            return
        north, east = (estimate.pos_ned_m - truth.pos_ned_m)[:2].tolist()
        self.position_error_m = math.hypot(north, east)
        if armed:
            self.score.add(
                truth.pos_ned_m,
                truth.quat_ned_frd,
                estimate.pos_ned_m,
                estimate.quat_ned_frd,
                estimate.pos_deviation_ned_m,
                estimate.yaw_deviation_rad,
            )
