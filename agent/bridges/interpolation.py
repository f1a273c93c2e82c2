"""The true motion between the instants at which the host tells it."""

from __future__ import annotations

from math import isfinite, sqrt
from typing import NamedTuple

from agent.wire.codec import Message

GRAVITY_MPS2 = 9.80665

Motion = tuple[float, float, float, float, float, float, float, float, float, float]
"""Position NED in m, quaternion body FRD to NED (w first), velocity NED in m/s."""


class Truth(NamedTuple):
    """The motion of the body origin at an instant of the sensor clock."""

    stamp_us: int
    pos_ned_m: tuple[float, float, float]
    vel_ned_mps: tuple[float, float, float]
    quat_ned_frd: tuple[float, float, float, float]
    gyro_frd_radps: tuple[float, float, float]


def truth_of(message: Message) -> Truth | None:
    """An XITL_TRUTH; None when not all of it are numbers, or the attitude is none."""
    w, x, y, z = message.quat
    length = sqrt(w * w + x * x + y * y + z * z)
    if not isfinite(sum(message.pos_ned) + sum(message.vel_ned) + sum(message.gyro) + length) or length < 0.5:
        return None
    quat = (w / length, x / length, y / length, z / length)
    return Truth(message.time_usec, tuple(message.pos_ned), tuple(message.vel_ned), quat, tuple(message.gyro))


class Path:
    """The motion from one truth to the next, and on from there at constant velocity.

    Position is the cubic with the positions and velocities of both ends (Hermite), velocity goes straight from one to
    the other, attitude too, normalised.
    """

    def __init__(self, start: Truth, end: Truth) -> None:
        self._end = end
        self._start_us = start.stamp_us
        self._length_us = end.stamp_us - start.stamp_us
        if self._length_us <= 0:
            return
        span_s = self._length_us * 1e-6
        self._pos = [
            (p0, v0 * span_s, 3.0 * (p1 - p0) - (2.0 * v0 + v1) * span_s, 2.0 * (p0 - p1) + (v0 + v1) * span_s)
            for p0, p1, v0, v1 in zip(start.pos_ned_m, end.pos_ned_m, start.vel_ned_mps, end.vel_ned_mps)
        ]
        self._vel = start.vel_ned_mps
        self._more = tuple(v1 - v0 for v0, v1 in zip(start.vel_ned_mps, end.vel_ned_mps))
        self._quat = start.quat_ned_frd
        same = sum(a * b for a, b in zip(start.quat_ned_frd, end.quat_ned_frd)) >= 0.0
        sign = 1.0 if same else -1.0
        self._turn = tuple(sign * b - a for a, b in zip(start.quat_ned_frd, end.quat_ned_frd))

    def at(self, stamp_us: int) -> Motion:
        """Motion at an instant; before the start it is that of the start."""
        length_us = self._length_us
        if length_us <= 0 or stamp_us >= self._start_us + length_us:
            return self._beyond(stamp_us)
        u = max(stamp_us - self._start_us, 0) / length_us
        (n0, n1, n2, n3), (e0, e1, e2, e3), (d0, d1, d2, d3) = self._pos
        a, b, c, d = self._quat
        da, db, dc, dd = self._turn
        a, b, c, d = a + u * da, b + u * db, c + u * dc, d + u * dd
        norm = 1.0 / sqrt(a * a + b * b + c * c + d * d)
        (vn, ve, vd), (wn, we, wd) = self._vel, self._more
        return (
            n0 + u * (n1 + u * (n2 + u * n3)),
            e0 + u * (e1 + u * (e2 + u * e3)),
            d0 + u * (d1 + u * (d2 + u * d3)),
            a * norm,
            b * norm,
            c * norm,
            d * norm,
            vn + u * wn,
            ve + u * we,
            vd + u * wd,
        )

    def _beyond(self, stamp_us: int) -> Motion:
        end = self._end
        after_s = max(stamp_us - end.stamp_us, 0) * 1e-6
        (n, e, d), (vn, ve, vd) = end.pos_ned_m, end.vel_ned_mps
        return (n + vn * after_s, e + ve * after_s, d + vd * after_s, *end.quat_ned_frd, vn, ve, vd)

    def specific_force_frd_mps2(self) -> tuple[float, float, float]:
        """What an accelerometer at the body origin would measure on the way, at the attitude of the end."""
        span_s = self._length_us * 1e-6
        north, east, down = (more / span_s for more in self._more) if span_s > 0.0 else (0.0, 0.0, 0.0)
        return _to_body(self._end.quat_ned_frd, (north, east, down - GRAVITY_MPS2))


def _to_body(quat: tuple[float, float, float, float], ned: tuple[float, float, float]) -> tuple[float, float, float]:
    w, x, y, z = quat
    n, e, d = ned
    return (
        (1 - 2 * (y * y + z * z)) * n + 2 * (x * y + w * z) * e + 2 * (x * z - w * y) * d,
        2 * (x * y - w * z) * n + (1 - 2 * (x * x + z * z)) * e + 2 * (y * z + w * x) * d,
        2 * (x * z + w * y) * n + 2 * (y * z - w * x) * e + (1 - 2 * (x * x + y * y)) * d,
    )
