"""What turns the integrated attitude toward its references: the correcting rate and the gyro bias.

Mahony, Hamel and Pflimlin 2008, eq 32: the correcting rate is proportional to the error, the bias is its integral.
"""

from __future__ import annotations

import math

from agent.fcu.samples import Vector3
from agent.fcu.sensing.inertial import InertialState, ned_to_frd

_ZERO: Vector3 = (0.0, 0.0, 0.0)
_BIAS_LIMIT_RADPS = math.radians(3.0)
_ERROR_LIMIT_RAD = 0.3
_BOOST = 4.0
_BOOST_DECAY_S = 6.0
_BIAS_DAMPING = 0.9  # damping ratio of attitude and bias error together
_BIAS_WAIT_S = 2.0  # the error of levelling is not to be learnt as a bias


class AttitudeAid:
    """Correcting rates in body FRD. Gains start high, so that the turn-on bias is learnt in seconds, and settle."""

    def __init__(self, tilt_gain_per_s: float, yaw_gain_per_s: float) -> None:
        self.configure(tilt_gain_per_s, yaw_gain_per_s)
        self.bias_frd_radps = _ZERO
        self.rate_offset_frd_radps = _ZERO  # to be added to the measured rate
        self._tilt_rate = _ZERO
        self._yaw_rate = _ZERO
        self._boost = 1.0 + _BOOST
        self._learns = False

    def configure(self, tilt_gain_per_s: float, yaw_gain_per_s: float) -> None:
        """Take new gains over."""
        self._tilt_gain = tilt_gain_per_s
        self._yaw_gain = yaw_gain_per_s

    def settle(self, since_levelled_s: float) -> None:
        """Set the gains for the time since levelling."""
        self._boost = 1.0 + _BOOST * math.exp(-since_levelled_s / _BOOST_DECAY_S)
        self._learns = since_levelled_s >= _BIAS_WAIT_S

    def tilt(self, state: InertialState, north_rad: float, east_rad: float, dt_s: float, trust: float = 1.0) -> None:
        """The estimate is tilted too far by a rotation about north and east; found over the last `dt_s`."""
        north_rad, east_rad = _limited(north_rad), _limited(east_rad)
        gain = min(self._tilt_gain * self._boost, 0.5 / dt_s) * trust
        self._tilt_rate = ned_to_frd(state, (-gain * north_rad, -gain * east_rad, 0.0))
        self._learn(gain, self._tilt_rate, dt_s)

    def heading(self, state: InertialState, error_rad: float, dt_s: float) -> None:
        """The true heading exceeds the estimated one by `error_rad`; found over the last `dt_s`."""
        gain = min(self._yaw_gain * self._boost, 0.5 / dt_s)
        self._yaw_rate = ned_to_frd(state, (0.0, 0.0, gain * _limited(error_rad)))
        self._learn(gain, self._yaw_rate, dt_s)

    def drop_heading(self) -> None:
        """No compass: stop turning toward it."""
        self._yaw_rate = _ZERO
        self._sum_up()

    def _learn(self, gain: float, rate: Vector3, dt_s: float) -> None:
        """Integral gain P²/4/damping²; `rate` already holds one P."""
        if not self._learns:
            self._sum_up()
            return
        share = 0.25 / (_BIAS_DAMPING * _BIAS_DAMPING) * gain * dt_s
        bx, by, bz = self.bias_frd_radps
        self.bias_frd_radps = (
            _clamped(bx - share * rate[0], _BIAS_LIMIT_RADPS),
            _clamped(by - share * rate[1], _BIAS_LIMIT_RADPS),
            _clamped(bz - share * rate[2], _BIAS_LIMIT_RADPS),
        )
        self._sum_up()

    def _sum_up(self) -> None:
        (tx, ty, tz), (yx, yy, yz), (bx, by, bz) = self._tilt_rate, self._yaw_rate, self.bias_frd_radps
        self.rate_offset_frd_radps = (tx + yx - bx, ty + yy - by, tz + yz - bz)


def _limited(error_rad: float) -> float:
    return _clamped(error_rad, _ERROR_LIMIT_RAD)


def _clamped(value: float, limit: float) -> float:
    return limit if value > limit else -limit if value < -limit else value
