"""Kalman filter of the heading error, the gyro bias about the vertical, and the lasting error of the compass field.

The states are errors: heading (true less estimated), bias, and the field that remains after calibration, forward and
right in body axes. Iron aboard and a tilt of the estimate both act like such a field. A compass then reads

    heading error - (sin(course) forward + cos(course) right) / horizontal field,    course = heading - declination,

so a turn separates the field from the heading. On a straight course they are one, and the variance says so.

An error of the tilt turns the vertical field into the horizontal one. It lasts for seconds and is largest after
levelling.

The process noises follow from AHRS_YAW_P, so that the filter settles to this gain, with a damping ratio of 0.9 of
heading and bias: noise of the rate 0.383 P² r and of the bias (0.309 P²)² r, for a compass noise of density r.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from agent.navigation.parameters import EstimatorParameters

INTERVAL_NS = 200_000_000
"""Time between two corrections; the samples in between are averaged."""
_SHORTEST_S, _LONGEST_S = 0.2, 0.5  # time in which a correction is turned
_BIAS_GAIN = 0.25 / (0.9 * 0.9)
_RATE_NOISE = 1.0 - 2.0 * _BIAS_GAIN
_START_RAD = 0.02  # a levelling error of a few degrees, by the inclination of the field
_START_BIAS_RADPS = 0.01
_TILT_RAD, _START_TILT_RAD, _TILT_SETTLES_S = 0.0015, 0.03, 2.5
_TILT_LASTS_S = 2.0
_GATE2 = 5.0**2
"""Square of the innovation over its variance, above which a compass contradicts the gyroscope and is not used."""
_DOUBT_RAD = 0.01  # of the heading, at each correction that is not used
_UNSEEN_TURN_RADPS = 0.3  # rate of turn of a boat during a gap in the inertial samples
_OFFSET_WANDERS = 1e-6**2  # G²/s, a drift of 0.02 mG in ten minutes


class HeadingCorrection(NamedTuple):
    """Rate that corrects the heading until the next correction, and change of the gyro bias about the vertical."""

    rate_radps: float
    bias_radps: float


class HeadingFilter:
    """`add` each error of a sample; when it returns True, apply what `correct` returns, if anything."""

    def __init__(self, parameters: EstimatorParameters) -> None:
        self.configure(parameters)
        self._stamp_ns = self._start_ns = 0
        self._sum_rad, self._count = 0.0, 0
        self._owed_rad = self._rate_radps = 0.0
        self._forward_gauss = self._right_gauss = 0.0
        self._p: tuple[float, ...] = (0.0,) * 10

    def configure(self, parameters: EstimatorParameters) -> None:
        """Apply changed parameters."""
        gain2 = parameters["AHRS_YAW_P"] ** 2
        self._rate_noise, self._bias_noise = _RATE_NOISE * gain2, (_BIAS_GAIN * gain2) ** 2
        self._noise_gauss = parameters["EK3_MAG_M_NSE"]
        self._offset_gauss = parameters["EK3_MAGB_M_NSE"]

    def restart(self, stamp_ns: int, course_rad: float, horizontal_gauss: float) -> None:
        """Begin after the heading was set to the compass: its error is that of the field."""
        offset2 = self._offset_gauss**2
        along, across = math.sin(course_rad) / horizontal_gauss, math.cos(course_rad) / horizontal_gauss
        px, py = along * offset2, across * offset2
        pp = along * px + across * py + _START_RAD**2 + (self._noise_gauss / horizontal_gauss) ** 2
        self._p = (pp, 0.0, px, py, _START_BIAS_RADPS**2, 0.0, 0.0, offset2, 0.0, offset2)
        self._forward_gauss = self._right_gauss = 0.0
        self._owed_rad = self._rate_radps = 0.0
        self._stamp_ns, self._sum_rad, self._count = stamp_ns, 0.0, 0
        self._start_ns = stamp_ns

    def add(self, stamp_ns: int, error_rad: float) -> bool:
        """Add the error of a sample. Return True when a correction is due."""
        self._sum_rad += error_rad
        self._count += 1
        return stamp_ns - self._stamp_ns >= INTERVAL_NS

    def correct(
        self, stamp_ns: int, course_rad: float, horizontal_gauss: float, vertical_gauss: float
    ) -> HeadingCorrection | None:
        """Fuse the mean of the samples since the last correction. Return None if it contradicts the gyroscope."""
        dt = (stamp_ns - self._stamp_ns) * 1e-9
        count, noise = self._count, self._noise_gauss / horizontal_gauss
        since_s = (stamp_ns - self._start_ns) * 1e-9
        tilted = _TILT_RAD + _START_TILT_RAD * math.exp(-since_s / _TILT_SETTLES_S)
        tilted *= vertical_gauss / horizontal_gauss
        variance = noise * noise / count + 2.0 * _TILT_LASTS_S / dt * tilted * tilted
        pp, pb, px, py, bb, bx, by, xx, xy, yy = self._predicted(dt, variance * dt)
        # The innovation: less what the last correction has still to turn, and with the estimated field.
        along, across = math.sin(course_rad) / horizontal_gauss, math.cos(course_rad) / horizontal_gauss
        turned = self._rate_radps * dt
        innovation = self._sum_rad / count - (self._owed_rad - 0.5 * turned)
        innovation += along * self._forward_gauss + across * self._right_gauss
        # Gain and covariance for z = heading - along forward - across right
        ph, bh = pp - along * px - across * py, pb - along * bx - across * by
        xh, yh = px - along * xx - across * xy, py - along * xy - across * yy
        total = ph - along * xh - across * yh + variance
        if innovation * innovation > _GATE2 * total:
            self.stop(stamp_ns)
            self._doubt(_DOUBT_RAD)
            return None
        kp, kb, kx, ky = ph / total, bh / total, xh / total, yh / total
        self._p = (
            pp - kp * ph, pb - kp * bh, px - kp * xh, py - kp * yh,
            bb - kb * bh, bx - kb * xh, by - kb * yh,
            xx - kx * xh, xy - kx * yh,
            yy - ky * yh,
        )  # fmt: skip
        self._forward_gauss += kx * innovation
        self._right_gauss += ky * innovation
        self._owed_rad += kp * innovation - turned
        self._rate_radps = self._owed_rad / min(max(dt, _SHORTEST_S), _LONGEST_S)
        self._stamp_ns, self._sum_rad, self._count = stamp_ns, 0.0, 0
        return HeadingCorrection(self._rate_radps, kb * innovation)

    def loosen(self, gap_s: float) -> None:
        """Lose the heading by a turn that no inertial sample has shown."""
        self._doubt(_UNSEEN_TURN_RADPS * gap_s)

    def _doubt(self, heading_rad: float) -> None:
        self._p = (self._p[0] + heading_rad * heading_rad, *self._p[1:])

    def stop(self, stamp_ns: int) -> None:
        """End the last correction, because the compass has no data."""
        dt = max((stamp_ns - self._stamp_ns) * 1e-9, 0.0)
        self._p = self._predicted(dt, 0.0)
        self._owed_rad -= self._rate_radps * dt
        self._rate_radps = 0.0
        self._stamp_ns, self._sum_rad, self._count = max(stamp_ns, self._stamp_ns), 0.0, 0

    def variance_rad2(self, stamp_ns: int) -> float:
        """Return the variance of the estimated heading, which grows without samples."""
        dt = max((stamp_ns - self._stamp_ns) * 1e-9, 0.0)
        pp, pb, _, _, bb = self._p[:5]
        owed = self._owed_rad - self._rate_radps * dt
        return pp - 2.0 * dt * pb + dt * dt * bb + owed * owed

    def _predicted(self, dt: float, density: float) -> tuple[float, ...]:
        """Return the covariance `dt` later, for a compass noise of this density (rad² s)."""
        pp, pb, px, py, bb, bx, by, xx, xy, yy = self._p
        wander = _OFFSET_WANDERS * dt
        return (
            pp - 2.0 * dt * pb + dt * dt * bb + self._rate_noise * density * dt,
            pb - dt * bb,
            px - dt * bx,
            py - dt * by,
            bb + self._bias_noise * density * dt,
            bx,
            by,
            xx + wander,
            xy,
            yy + wander,
        )
