"""A Kalman filter of one axis: position, velocity and acceleration bias, driven by a measured acceleration.

Only the covariance lives here; the state itself is integrated at the rate of the IMU by the estimator. North and east
have the same noise, so one covariance serves both. `p' = v, v' = a - b, b' = 0`, discretised exactly over a step.
"""

from __future__ import annotations

from typing import NamedTuple

Gain = tuple[float, float, float]


class AxisCovariance(NamedTuple):
    """Upper triangle of the covariance of (position m, velocity m/s, acceleration bias m/s²)."""

    pp: float
    pv: float
    pb: float
    vv: float
    vb: float
    bb: float


def predicted(c: AxisCovariance, dt_s: float, acceleration_psd: float, bias_psd: float) -> AxisCovariance:
    """The covariance `dt_s` later, with white noise on acceleration (m²/s³) and on the bias's rate (m²/s⁵)."""
    pp, pv, pb, vv, vb, bb = c
    half = 0.5 * dt_s * dt_s
    # Rows of F P, with F = [1 dt -dt²/2; 0 1 -dt; 0 0 1].
    fpp = pp + dt_s * pv - half * pb
    fpv = pv + dt_s * vv - half * vb
    fpb = pb + dt_s * vb - half * bb
    fvv = vv - dt_s * vb
    fvb = vb - dt_s * bb
    return AxisCovariance(
        pp=fpp + dt_s * fpv - half * fpb + acceleration_psd * dt_s * dt_s * dt_s / 3.0,
        pv=fpv - dt_s * fpb + acceleration_psd * half,
        pb=fpb,
        vv=fvv - dt_s * fvb + acceleration_psd * dt_s,
        vb=fvb,
        bb=bb + bias_psd * dt_s,
    )


def position_update(c: AxisCovariance, variance_m2: float) -> tuple[AxisCovariance, Gain]:
    """Covariance and gain of a position measurement."""
    pp, pv, pb, vv, vb, bb = c
    k0, k1, k2 = pp / (pp + variance_m2), pv / (pp + variance_m2), pb / (pp + variance_m2)
    updated = AxisCovariance(pp - k0 * pp, pv - k0 * pv, pb - k0 * pb, vv - k1 * pv, vb - k1 * pb, bb - k2 * pb)
    return updated, (k0, k1, k2)


def velocity_update(c: AxisCovariance, variance_m2ps2: float) -> tuple[AxisCovariance, Gain]:
    """Covariance and gain of a velocity measurement."""
    pp, pv, pb, vv, vb, bb = c
    k0, k1, k2 = pv / (vv + variance_m2ps2), vv / (vv + variance_m2ps2), vb / (vv + variance_m2ps2)
    updated = AxisCovariance(pp - k0 * pv, pv - k0 * vv, pb - k0 * vb, vv - k1 * vv, vb - k1 * vb, bb - k2 * vb)
    return updated, (k0, k1, k2)
