"""A vessel's report of its motion: its autopilot's estimate, or the script of a vessel without an autopilot."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from sim_core.kinematics import Kinematics
from xitl_cli.record.topics import MotionEstimate

Point = tuple[float, float]


class SelfReport(NamedTuple):
    """A report in the local frame."""

    at_ns: int
    """Simulation time of the report."""
    pos_ne_m: Point
    vel_ne_mps: Point
    yaw_rad: float
    yaw_rate_radps: float = 0.0
    """Positive to starboard."""
    accurate: bool = True
    """The vessel's own estimate of its position error is below 10 m."""
    armed: bool = True
    """The vessel may move by itself."""

    def carried_on(self, now_ns: int) -> SelfReport:
        """Extrapolate the report to now with constant velocity, for up to a second."""
        age_s = min(max((now_ns - self.at_ns) * 1e-9, 0.0), 1.0)
        (north_m, east_m), (north_mps, east_mps) = self.pos_ne_m, self.vel_ne_mps
        return self._replace(at_ns=now_ns, pos_ne_m=(north_m + age_s * north_mps, east_m + age_s * east_mps))


ReportSource = Callable[[], SelfReport | None]
"""Returns the newest report of a vessel, None before the first."""

ACCURATE_M = 10.0  # AIS's limit for a position of high accuracy
_RADIUS_95 = 2.448  # radius of a circular normal distribution, in standard deviations of one axis


def report_from_estimate(at_ns: int, estimate: MotionEstimate, armed: bool) -> SelfReport:
    """Return an autopilot's report. Without an accuracy estimate, the position counts as low accuracy, as in AIS."""
    north_m, east_m, _ = estimate.pos_ned_m.tolist()
    north_mps, east_mps, _ = estimate.vel_ned_mps.tolist()
    w, x, y, z = estimate.quat_ned_frd.tolist()
    yaw_rad = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    deviation = estimate.pos_deviation_ned_m
    accurate = deviation is not None and float(deviation[:2].max()) * _RADIUS_95 <= ACCURATE_M
    yaw_rate_radps = float(estimate.gyro_frd_radps[2])
    return SelfReport(at_ns, (north_m, east_m), (north_mps, east_mps), yaw_rad, yaw_rate_radps, accurate, armed)


def report_from_motion(at_ns: int, motion: Kinematics, row: int = 0, armed: bool = True) -> SelfReport:
    """Return the true report, for a vessel that follows a script or has no autopilot."""
    north_m, east_m, _ = motion.pos_ned_m[row].tolist()
    north_mps, east_mps, _ = motion.vel_ned_mps[row].tolist()
    rotation = motion.rot_ned_frd[row]
    yaw_rad = math.atan2(rotation[1, 0], rotation[0, 0])
    rate_radps = float(motion.gyro_frd_radps[row, 2])
    return SelfReport(at_ns, (north_m, east_m), (north_mps, east_mps), yaw_rad, rate_radps, True, armed)


SHOWN = 3  # vessel names in a sentence


class VesselVoices:
    """Reports of each vessel of a run, by its name: its motion, whether it is ready and whether it is finished."""

    def __init__(self) -> None:
        self._sources: dict[str, tuple[ReportSource, Callable[[], bool], Callable[[], bool]]] = {}

    def add(
        self, name: str, source: ReportSource, finished: Callable[[], bool], ready: Callable[[], bool] = lambda: True
    ) -> None:
        """Add a vessel."""
        self._sources[name] = source, finished, ready

    def said(self, name: str) -> SelfReport | None:
        """Return the newest report of a vessel; None before the first."""
        return self._sources[name][0]()

    def finished(self, name: str) -> bool:
        """Whether the vessel has nothing more to do."""
        return self._sources[name][1]()

    def waited_for(self, names: Sequence[str]) -> str:
        """Return a text with the vessels that are not ready to set out; empty when all are."""
        late = [name for name in names if name not in self._sources or not self._sources[name][2]()]
        more = f" and {len(late) - SHOWN} more" if len(late) > SHOWN else ""
        return f"{', '.join(late[:SHOWN])}{more} to be ready" if late else ""
