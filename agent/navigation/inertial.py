"""Inertial integration: one IMU sample propagates the state to the next.

Pure functions on plain floats, on the hot path.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

from agent.navigation.measurements import ImuMeasurement, Quaternion, Vector3

_LENGTH = 256
_RECENT = 41  # 0.2 s at 200 Hz


class InertialState(NamedTuple):
    """Attitude, velocity and position of the IMU at `stamp_ns`, and the values that the next step needs.

    The quaternion rotates body FRD into NED. `sum_north` and `sum_east` integrate the measured acceleration without any
    correction. Their change over an interval is the velocity change that the attitude predicts.
    """

    stamp_ns: int
    w: float
    x: float
    y: float
    z: float
    vel_north_mps: float
    vel_east_mps: float
    vel_down_mps: float
    north_m: float
    east_m: float
    down_m: float
    acc_north_mps2: float
    acc_east_mps2: float
    acc_down_mps2: float
    gyro_x_radps: float
    gyro_y_radps: float
    gyro_z_radps: float
    sum_north_mps: float
    sum_east_mps: float


def propagate(
    state: InertialState,
    sample: ImuMeasurement,
    rate_offset_frd_radps: Vector3,
    bias_ned_mps2: Vector3,
    gravity_mps2: float,
) -> InertialState:
    """Return the state at the stamp of `sample`, by the trapezoidal rule.

    rate_offset_frd_radps: added to the measured rate (minus the gyro bias, plus attitude corrections).
    bias_ned_mps2: subtracted from the measured acceleration.
    """
    stamp0_ns, w0, x0, y0, z0, vn0, ve0, vd0, pn0, pe0, pd0, an0, ae0, ad0, gx0, gy0, gz0, sn0, se0 = state
    stamp_ns, (gx, gy, gz), (fx, fy, fz), _ = sample
    offset_x, offset_y, offset_z = rate_offset_frd_radps
    bias_n, bias_e, bias_d = bias_ned_mps2
    dt_s = (stamp_ns - stamp0_ns) * 1e-9
    half_s = 0.5 * dt_s

    # Half the rotation vector, and the quaternion of that rotation by the first terms of its series.
    hx = (0.5 * (gx + gx0) + offset_x) * half_s
    hy = (0.5 * (gy + gy0) + offset_y) * half_s
    hz = (0.5 * (gz + gz0) + offset_z) * half_s
    h2 = hx * hx + hy * hy + hz * hz
    c = 1.0 - h2 * (0.5 - h2 * (1.0 / 24.0))
    s = 1.0 - h2 * (1.0 / 6.0 - h2 * (1.0 / 120.0))
    hx *= s
    hy *= s
    hz *= s
    w = c * w0 - hx * x0 - hy * y0 - hz * z0
    x = c * x0 + hx * w0 + hz * y0 - hy * z0
    y = c * y0 + hy * w0 + hx * z0 - hz * x0
    z = c * z0 + hz * w0 + hy * x0 - hx * y0
    norm = 1.5 - 0.5 * (w * w + x * x + y * y + z * z)  # one Newton step towards unit length
    w *= norm
    x *= norm
    y *= norm
    z *= norm

    xx, yy, zz = x * x, y * y, z * z
    xy, xz, yz = x * y, x * z, y * z
    wx, wy, wz = w * x, w * y, w * z
    an = fx + 2.0 * ((xy - wz) * fy + (xz + wy) * fz - (yy + zz) * fx)
    ae = fy + 2.0 * ((xy + wz) * fx + (yz - wx) * fz - (xx + zz) * fy)
    ad = fz + 2.0 * ((xz - wy) * fx + (yz + wx) * fy - (xx + yy) * fz) + gravity_mps2

    dvn = (an + an0) * half_s
    dve = (ae + ae0) * half_s
    vn = vn0 + dvn - bias_n * dt_s
    ve = ve0 + dve - bias_e * dt_s
    vd = vd0 + (ad + ad0) * half_s - bias_d * dt_s
    return InertialState(
        stamp_ns, w, x, y, z, vn, ve, vd,
        pn0 + (vn + vn0) * half_s, pe0 + (ve + ve0) * half_s, pd0 + (vd + vd0) * half_s,
        an, ae, ad, gx, gy, gz, sn0 + dvn, se0 + dve,
    )  # fmt: skip


def shift_state(state: InertialState, vel_ned_mps: Vector3, pos_ned_m: Vector3) -> InertialState:
    """Return the state with a velocity and a position correction added."""
    stamp_ns, w, x, y, z, vn, ve, vd, pn, pe, pd, *rest = state  # written out for speed: a late fix shifts many
    dvn, dve, dvd = vel_ned_mps
    dpn, dpe, dpd = pos_ned_m
    return InertialState(stamp_ns, w, x, y, z, vn + dvn, ve + dve, vd + dvd, pn + dpn, pe + dpe, pd + dpd, *rest)


def frd_to_ned(state: InertialState, v_frd: Vector3) -> Vector3:
    """Rotate a body vector to NED."""
    _, w, x, y, z = state[:5]
    vx, vy, vz = v_frd
    tx, ty, tz = 2.0 * (y * vz - z * vy), 2.0 * (z * vx - x * vz), 2.0 * (x * vy - y * vx)
    return (vx + w * tx + y * tz - z * ty, vy + w * ty + z * tx - x * tz, vz + w * tz + x * ty - y * tx)


def ned_to_frd(state: InertialState, v_ned: Vector3) -> Vector3:
    """Rotate a NED vector to body axes."""
    _, w, x, y, z = state[:5]
    vx, vy, vz = v_ned
    tx, ty, tz = 2.0 * (y * vz - z * vy), 2.0 * (z * vx - x * vz), 2.0 * (x * vy - y * vx)
    return (vx - w * tx + y * tz - z * ty, vy - w * ty + z * tx - x * tz, vz - w * tz + x * ty - y * tx)


def cross(a: Vector3, b: Vector3) -> Vector3:
    """Vector product."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def euler(w: float, x: float, y: float, z: float) -> Vector3:
    """Euler angles (roll, pitch, yaw) of a unit quaternion, z-y-x order, in rad."""
    roll_rad = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch_rad = math.asin(max(-1.0, min(1.0, 2.0 * (w * y - x * z))))
    yaw_rad = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return roll_rad, pitch_rad, yaw_rad


def quaternion(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Quaternion:
    """Unit quaternion of (roll, pitch, yaw)."""
    cr, sr = math.cos(0.5 * roll_rad), math.sin(0.5 * roll_rad)
    cp, sp = math.cos(0.5 * pitch_rad), math.sin(0.5 * pitch_rad)
    cy, sy = math.cos(0.5 * yaw_rad), math.sin(0.5 * yaw_rad)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


class StateCorrection(NamedTuple):
    """Correction of position, velocity and acceleration bias at the instant of the measurement, NED."""

    pos_ned_m: Vector3
    vel_ned_mps: Vector3
    bias_ned_mps2: Vector3


class InertialHistory:
    """Stored states, newest last. Never read before the first `restart`."""

    def __init__(self) -> None:
        self._states: deque[InertialState] = deque(maxlen=_LENGTH)
        self.append = self._states.append

    def restart(self, state: InertialState) -> None:
        """Drop all states except this one."""
        self._states.clear()
        self._states.append(state)

    def state_at(self, stamp_ns: int) -> InertialState | None:
        """Return the last state not newer than `stamp_ns`, None when it was dropped."""
        for state in reversed(self._states):
            if state.stamp_ns <= stamp_ns:
                return state
        return None

    def recent(self) -> InertialState:
        """Return a state a few tenths of a second old, or the oldest one."""
        return self._states[max(0, len(self._states) - _RECENT)]

    def correct(self, correction: StateCorrection, stamp_ns: int) -> InertialState:
        """Propagate a correction at `stamp_ns` to every later state by the filter's model. Return the newest state."""
        (pn, pe, pd), (vn, ve, vd), (bn, be, bd) = correction
        states = self._states
        newest = len(states) - 1
        for index in range(newest, -1, -1):
            lag_s = (states[index].stamp_ns - stamp_ns) * 1e-9
            if lag_s < 0.0 and index < newest:
                break
            half = 0.5 * lag_s * lag_s
            vel = (vn - bn * lag_s, ve - be * lag_s, vd - bd * lag_s)
            pos = (pn + vn * lag_s - bn * half, pe + ve * lag_s - be * half, pd + vd * lag_s - bd * half)
            states[index] = shift_state(states[index], vel, pos)
        return states[newest]
