"""What a single GNSS fix is good for: whether it can be true, and the tilt that two of them reveal."""

from __future__ import annotations

from typing import NamedTuple

from agent.fcu.samples import GnssSample, Vector3
from agent.fcu.sensing.inertial import InertialState

_SPEED_LIMIT2 = 100.0**2
_INTERVAL_S = (0.02, 2.0)


def is_plausible(sample: GnssSample) -> bool:
    """Whether the numbers can be those of a boat; written so that NaN and infinity fail."""
    vn, ve, vd = sample.vel_ned_mps
    return (
        abs(sample.lat_deg) <= 90.0
        and abs(sample.lon_deg) <= 180.0
        and abs(sample.alt_m) < 10_000.0
        and vn * vn + ve * ve + vd * vd < _SPEED_LIMIT2
        and 0.0 <= sample.horizontal_accuracy_m < 1e6
        and 0.0 <= sample.vertical_accuracy_m < 1e6
        and 0.0 <= sample.speed_accuracy_mps < 1e6
    )


class TiltReference(NamedTuple):
    """A fix's velocity beside what the accelerometer had summed up to then."""

    stamp_ns: int
    vel_north_mps: float
    vel_east_mps: float
    sum_north_mps: float
    sum_east_mps: float

    @classmethod
    def of(cls, then: InertialState, stamp_ns: int, vel_ned_mps: Vector3) -> TiltReference:
        """`then` is the last state not newer than the fix."""
        late_s = (stamp_ns - then.stamp_ns) * 1e-9
        return cls(
            stamp_ns,
            vel_ned_mps[0],
            vel_ned_mps[1],
            then.sum_north_mps + late_s * then.acc_north_mps2,
            then.sum_east_mps + late_s * then.acc_east_mps2,
        )

    def unexplained(self, last: TiltReference) -> tuple[float, float, float] | None:
        """(north, east) acceleration that was summed but did not happen, and its duration; None when too far apart."""
        dt_s = (self.stamp_ns - last.stamp_ns) * 1e-9
        if not _INTERVAL_S[0] < dt_s < _INTERVAL_S[1]:
            return None
        north_mps2 = (self.sum_north_mps - last.sum_north_mps - self.vel_north_mps + last.vel_north_mps) / dt_s
        east_mps2 = (self.sum_east_mps - last.sum_east_mps - self.vel_east_mps + last.vel_east_mps) / dt_s
        return north_mps2, east_mps2, dt_s
