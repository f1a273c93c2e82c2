"""Kalman filter of position, velocity, acceleration bias and GNSS drift from GNSS and barometer, with innovation gates.

There is one filter per axis, driven by a measured acceleration: `p' = v, v' = a - b, b' = 0, d' = -d / T`, discretised
exactly over a step. A receiver's position errors last for minutes, so a fix is `p + d` plus white noise. With white
noise alone, the mean of a hundred fixes would seem ten times as accurate as it is.

This module holds only covariance and drift. The estimator integrates position and velocity at the rate of the IMU.
North and east have the same noise, so they share one covariance.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from agent.navigation.inertial import StateCorrection
from agent.navigation.measurements import BarometerMeasurement, Vector3
from agent.navigation.parameters import EstimatorParameters

_STEP_LIMIT_S = 5.0
_STEP_HZ = 100.0  # ArduPilot's process noises are per step of its filter
_VERTICAL_SHARE = 1.5  # vertical over horizontal GNSS position noise, as in ArduPilot's EKF3
Column = tuple[float, float, float, float]
PRESSURE_RANGE_PA = (30_000.0, 120_000.0)
_AVERAGE_NS = 100_000_000
_OFFSET_S = 60.0
_START_BIAS_MPS2 = 0.3  # for a levelling error of a few degrees
# In a turn, a lasting acceleration is measured with a direction error of about 0.02 rad for about 4 s. As white noise,
# this is 2 σ² T times its square. Heading and tilt have a part in it.
_MANOEUVRE_S = 2.0 * 0.02**2 * 4.0
_MANOEUVRE_TAKES_S = 2.0  # longer than a wave
# Without fixes, a tilt cannot be distinguished from an acceleration: a quarter of a degree, integrated from then on.
_COASTING_S = 1.5
_COASTING_MPS2 = 0.04
_NO_FIX = (2.0, 2.0, 1.0)  # accuracies before the first fix
_NOTHING: Column = (0.0, 0.0, 0.0, 0.0)


class Seen(NamedTuple):
    """Statistics of a scalar measurement: its variance, and its covariance with each state."""

    variance: float
    column: Column


class AxisCovariance(NamedTuple):
    """Upper triangle of the covariance of (position m, velocity m/s, acceleration bias m/s², GNSS drift m)."""

    pp: float
    pv: float
    pb: float
    pd: float
    vv: float
    vb: float
    vd: float
    bb: float
    bd: float
    dd: float

    @property
    def of_fix(self) -> Seen:
        """Statistics of a measurement of position plus drift, as GNSS provides it."""
        column = (self.pp + self.pd, self.pv + self.vd, self.pb + self.bd, self.pd + self.dd)
        return Seen(column[0] + column[3], column)

    @property
    def of_velocity(self) -> Seen:
        """Statistics of a measurement of the velocity."""
        return Seen(self.vv, (self.pv, self.vv, self.vb, self.vd))


class AxisNoise(NamedTuple):
    """Process noise of one axis."""

    acceleration_psd: float
    """Spectral density of white noise on the acceleration, m²/s³."""
    bias_psd: float
    """Spectral density of white noise on the rate of the bias, m²/s⁵."""
    drift_s: float
    """Time constant of the drift."""

    def drift_left(self, dt_s: float) -> float:
        """Remaining part of a drift after `dt_s`."""
        return math.exp(-dt_s / self.drift_s)


def predict_covariance(c: AxisCovariance, dt_s: float, noise: AxisNoise, drift_variance_m2: float) -> AxisCovariance:
    """Return the covariance `dt_s` later. The drift is a Gauss-Markov process with this stationary variance."""
    pp, pv, pb, pd, vv, vb, vd, bb, bd, dd = c
    half = 0.5 * dt_s * dt_s
    keep = noise.drift_left(dt_s)
    # Rows of F P, with F = [1 dt -dt²/2; 0 1 -dt; 0 0 1], and the drift's `keep`.
    fpp = pp + dt_s * pv - half * pb
    fpv = pv + dt_s * vv - half * vb
    fpb = pb + dt_s * vb - half * bb
    fvv = vv - dt_s * vb
    fvb = vb - dt_s * bb
    return AxisCovariance(
        pp=fpp + dt_s * fpv - half * fpb + noise.acceleration_psd * dt_s * dt_s * dt_s / 3.0,
        pv=fpv - dt_s * fpb + noise.acceleration_psd * half,
        pb=fpb,
        pd=keep * (pd + dt_s * vd - half * bd),
        vv=fvv - dt_s * fvb + noise.acceleration_psd * dt_s,
        vb=fvb,
        vd=keep * (vd - dt_s * bd),
        bb=bb + noise.bias_psd * dt_s,
        bd=keep * bd,
        dd=keep * keep * dd + (1.0 - keep * keep) * drift_variance_m2,
    )


def update_covariance(c: AxisCovariance, seen: Column, innovation_variance: float) -> tuple[AxisCovariance, Column]:
    """Return covariance and gain for a scalar measurement. seen: its covariance with each state."""
    pp, pv, pb, pd, vv, vb, vd, bb, bd, dd = c
    sp, sv, sb, sd = seen
    kp, kv, kb, kd = (part / innovation_variance for part in seen)
    updated = AxisCovariance(
        pp - kp * sp, pv - kp * sv, pb - kp * sb, pd - kp * sd,
        vv - kv * sv, vb - kv * sb, vd - kv * sd,
        bb - kb * sb, bd - kb * sd,
        dd - kd * sd,
    )  # fmt: skip
    return updated, (kp, kv, kb, kd)


class FixVariances(NamedTuple):
    """Variances of a fix per axis."""

    white_m2: float
    """White position noise."""
    drift_m2: float
    """Slow position drift."""
    velocity_m2ps2: float
    """Velocity noise."""


def _covariance_from_fix(fix: FixVariances) -> AxisCovariance:
    """Covariance after position and velocity were set to a fix: the position error is minus the drift."""
    pp, dd = fix.white_m2 + fix.drift_m2, fix.drift_m2
    return AxisCovariance(pp, 0.0, 0.0, -dd, fix.velocity_m2ps2, 0.0, 0.0, _START_BIAS_MPS2**2, 0.0, dd)


class Fusion(NamedTuple):
    """Result of a fusion."""

    ratio: float
    """Squared innovation over squared gate, refused above one."""
    covariance: AxisCovariance
    moves: tuple[Column, ...]
    """Corrections of the states, per axis."""


def fuse(c: AxisCovariance, seen: Seen, variance: float, innovations: tuple[float, ...], gate2: float) -> Fusion:
    """Fuse a measurement in each of the axes that share a covariance. variance: of its white noise."""
    innovation_variance = seen.variance + variance
    ratio = sum(part * part for part in innovations) / (gate2 * innovation_variance)
    if not ratio <= 1.0:
        return Fusion(ratio, c, (_NOTHING,) * len(innovations))
    updated, (kp, kv, kb, kd) = update_covariance(c, seen.column, innovation_variance)
    return Fusion(ratio, updated, tuple((kp * part, kv * part, kb * part, kd * part) for part in innovations))


def fuse_position(c: AxisCovariance, fix: FixVariances, innovations: tuple[float, ...], gate2: float) -> Fusion:
    """Fuse the position of a fix.

    A position outside the gate may be a jump of the drift, for example when a satellite sets or a reflection begins.
    Then the drift becomes unknown and absorbs the jump. A position still farther off is refused.
    """
    fusion = fuse(c, c.of_fix, fix.white_m2, innovations, gate2)
    if fusion.ratio <= 1.0:
        return fusion
    jumped = c._replace(dd=c.dd + fix.drift_m2)
    fusion = fuse(jumped, jumped.of_fix, fix.white_m2, innovations, gate2)
    return fusion if fusion.ratio <= 1.0 else fusion._replace(covariance=c)


class InnovationRatios(NamedTuple):
    """Squared innovations over squared gates. Above one, the measurement was refused."""

    position: float = 0.0
    velocity: float = 0.0
    height: float = 0.0
    heading: float = 0.0


class EstimateVariances(NamedTuple):
    """Variances of the estimated position and velocity, per horizontal axis and down (m², m²/s²)."""

    horizontal_m2: float
    vertical_m2: float
    speed_m2ps2: float
    climb_m2ps2: float
    heading_rad2: float = math.nan
    """Variance of the heading, NaN before the first compass sample in use."""


class PositionFilter:
    """Two covariances: one for north and east, which have equal noises, and one for down.

    A receiver reports a two-dimensional position accuracy and a three-dimensional velocity accuracy, as hAcc and sAcc
    of a u-blox receiver. An axis gets its share of the variance.
    """

    def __init__(self, parameters: EstimatorParameters) -> None:
        self.configure(parameters)
        self.ratios = InnovationRatios()
        self._horizontal_ns: int | None = None
        self._vertical_ns: int | None = None
        self._lasting_n = self._lasting_e = 0.0
        self.restart(_NO_FIX)

    def configure(self, parameters: EstimatorParameters) -> None:
        """Apply noises and gates."""
        self._noise = AxisNoise(
            parameters["EK3_ACC_P_NSE"] ** 2 / _STEP_HZ,
            parameters["EK3_ABIAS_P_NSE"] ** 2 / _STEP_HZ,
            parameters["EK3_GPSDRIFT_TC"],
        )
        self._pos_noise_m = parameters["EK3_POSNE_M_NSE"]
        self._vel_noise_mps = parameters["EK3_VELNE_M_NSE"]
        self._vel_down_noise_mps = parameters["EK3_VELD_M_NSE"]
        self._baro_variance_m2 = parameters["EK3_ALT_M_NSE"] ** 2
        self._pos_gate2 = (parameters["EK3_POS_I_GATE"] / 100.0) ** 2
        self._vel_gate2 = (parameters["EK3_VEL_I_GATE"] / 100.0) ** 2
        self._height_gate2 = (parameters["EK3_HGT_I_GATE"] / 100.0) ** 2

    def restart(self, accuracy: Vector3) -> None:
        """Restart after position and velocity were set to a fix of this accuracy (horizontal, vertical, speed)."""
        level, down = self._fix_variances(accuracy)
        self._horizontal, self._vertical = _covariance_from_fix(level), _covariance_from_fix(down)
        self._drift_ned_m: Vector3 = (0.0, 0.0, 0.0)

    def loosen(self, dt_s: float) -> None:
        """Increase the covariances after `dt_s` without measurements: velocity by up to 1 m/s, position by as much all
        along.
        """
        self._horizontal, self._vertical = (
            AxisCovariance(c.pp + dt_s * dt_s, 0.0, 0.0, c.pd, c.vv + 1.0, 0.0, 0.0, _START_BIAS_MPS2**2, 0.0, c.dd)
            for c in (self._horizontal, self._vertical)
        )

    def variances(self, stamp_ns: int) -> EstimateVariances:
        """Variances of the estimate at `stamp_ns`, which is no older than the last fused measurement."""
        level_s, down_s = (
            0.0 if last_ns is None else max((stamp_ns - last_ns) * 1e-9, 0.0)
            for last_ns in (self._horizontal_ns, self._vertical_ns)
        )
        level = predict_covariance(_coasting(self._horizontal, level_s), level_s, self._noise, 0.0)
        down = predict_covariance(self._vertical, down_s, self._noise, 0.0)
        return EstimateVariances(level.pp, down.pp, level.vv, down.vv)

    def fuse_gnss(
        self,
        stamp_ns: int,
        pos_innovation_ned_m: Vector3,
        vel_innovation_ned_mps: Vector3,
        accuracy: Vector3,
        acceleration_ne_mps2: tuple[float, float] = (0.0, 0.0),
    ) -> StateCorrection:
        """Fuse a fix. Innovations are measured minus stored values.

        accuracy: the receiver's own (horizontal, vertical, speed).
        acceleration_ne_mps2: mean since the last fix.
        """
        level, down = self._fix_variances(accuracy)
        self._predict_horizontal(stamp_ns, level.drift_m2, acceleration_ne_mps2)
        self._predict_vertical(stamp_ns, down.drift_m2)
        drift_n, drift_e, drift_d = self._drift_ned_m
        in_n, in_e, in_d = pos_innovation_ned_m
        iv_n, iv_e, iv_d = vel_innovation_ned_mps

        c = self._horizontal
        position = fuse_position(c, level, (in_n - drift_n, in_e - drift_e), self._pos_gate2)
        (pn, vn, bn, dn), (pe, ve, be, de) = position.moves
        c = position.covariance
        velocity = fuse(c, c.of_velocity, level.velocity_m2ps2, (iv_n - vn, iv_e - ve), self._vel_gate2)
        (pn2, vn2, bn2, dn2), (pe2, ve2, be2, de2) = velocity.moves
        if velocity.ratio <= 1.0:
            c = velocity.covariance
        else:  # the attitude error may be as large as at the start
            c = c._replace(bb=max(c.bb, _START_BIAS_MPS2 * _START_BIAS_MPS2))
        self._horizontal = c

        c = self._vertical
        height = fuse_position(c, down, (in_d - drift_d,), self._height_gate2)
        ((pd, vd, bd, dd),) = height.moves
        c = height.covariance
        climb = fuse(c, c.of_velocity, down.velocity_m2ps2, (iv_d - vd,), self._vel_gate2)
        ((pd2, vd2, bd2, dd2),) = climb.moves
        self._vertical = climb.covariance

        self._drift_ned_m = (drift_n + dn + dn2, drift_e + de + de2, drift_d + dd + dd2)
        self.ratios = self.ratios._replace(position=position.ratio, velocity=velocity.ratio, height=height.ratio)
        return StateCorrection(
            (pn + pn2, pe + pe2, pd + pd2), (vn + vn2, ve + ve2, vd + vd2), (bn + bn2, be + be2, bd + bd2)
        )

    def fuse_height(self, stamp_ns: int, innovation_down_m: float) -> StateCorrection:
        """Fuse a barometer's innovation, down. Its offset follows the GNSS, so its error contains the same drift."""
        self._predict_vertical(stamp_ns, self._vertical_drift_m2)
        drift_n, drift_e, drift_d = self._drift_ned_m
        c = self._vertical
        height = fuse(c, c.of_fix, self._baro_variance_m2, (innovation_down_m - drift_d,), self._height_gate2)
        ((pd, vd, bd, dd),) = height.moves
        self._vertical = height.covariance
        self._drift_ned_m = (drift_n, drift_e, drift_d + dd)
        return StateCorrection((0.0, 0.0, pd), (0.0, 0.0, vd), (0.0, 0.0, bd))

    def _fix_variances(self, accuracy: Vector3) -> tuple[FixVariances, FixVariances]:
        """Variances of a horizontal axis, and of the vertical one."""
        horizontal_m, vertical_m, speed_mps = accuracy
        white_m2 = self._pos_noise_m**2
        down_m2 = _VERTICAL_SHARE**2 * white_m2
        speed_m2ps2 = speed_mps * speed_mps / 3.0
        self._vertical_drift_m2 = max(vertical_m * vertical_m - down_m2, 0.0)
        level = FixVariances(
            white_m2, max(0.5 * horizontal_m * horizontal_m - white_m2, 0.0), max(self._vel_noise_mps**2, speed_m2ps2)
        )
        return level, FixVariances(down_m2, self._vertical_drift_m2, max(self._vel_down_noise_mps**2, speed_m2ps2))

    def _predict_horizontal(self, stamp_ns: int, drift_m2: float, acceleration_ne_mps2: tuple[float, float]) -> None:
        dt_s = _step_s(self._horizontal_ns, stamp_ns)
        share = min(dt_s / _MANOEUVRE_TAKES_S, 1.0)
        self._lasting_n += share * (acceleration_ne_mps2[0] - self._lasting_n)
        self._lasting_e += share * (acceleration_ne_mps2[1] - self._lasting_e)
        lasting2 = self._lasting_n * self._lasting_n + self._lasting_e * self._lasting_e
        noise = self._noise._replace(acceleration_psd=self._noise.acceleration_psd + _MANOEUVRE_S * lasting2)
        self._horizontal = predict_covariance(_coasting(self._horizontal, dt_s), dt_s, noise, drift_m2)
        self._horizontal_ns = stamp_ns
        keep = self._noise.drift_left(dt_s)
        north_m, east_m, down_m = self._drift_ned_m
        self._drift_ned_m = (keep * north_m, keep * east_m, down_m)

    def _predict_vertical(self, stamp_ns: int, drift_m2: float) -> None:
        """Predict the vertical axis.

        A fix is older than the barometer samples fused before it, so the time never steps back.
        """
        dt_s = _step_s(self._vertical_ns, stamp_ns)
        self._vertical = predict_covariance(self._vertical, dt_s, self._noise, drift_m2)
        self._vertical_ns = stamp_ns if self._vertical_ns is None else max(stamp_ns, self._vertical_ns)
        north_m, east_m, down_m = self._drift_ned_m
        self._drift_ned_m = (north_m, east_m, self._noise.drift_left(dt_s) * down_m)


def _coasting(c: AxisCovariance, dt_s: float) -> AxisCovariance:
    """Covariance at the last fix, adapted for the prediction over the next `dt_s`."""
    return c._replace(bb=c.bb + _COASTING_MPS2 * _COASTING_MPS2) if dt_s > _COASTING_S else c


def _step_s(last_ns: int | None, stamp_ns: int) -> float:
    return 0.0 if last_ns is None else min(max((stamp_ns - last_ns) * 1e-9, 0.0), _STEP_LIMIT_S)


class BarometerHeight:
    """Height from a barometer. Its offset absorbs weather and atmosphere errors, and follows the GNSS over a minute."""

    def __init__(self) -> None:
        self.stamp_ns: int | None = None
        self._average_ns = 0
        self._sum_pa = 0.0
        self._count = 0
        self._height_m: float | None = None
        self._offset_m: float | None = None
        self._offset_ns = 0

    def add(self, sample: BarometerMeasurement) -> float | None:
        """Return the altitude above mean sea level ten times a second once the offset is known. None in between."""
        if self.stamp_ns is None:
            self._average_ns = sample.stamp_ns
        self.stamp_ns = sample.stamp_ns
        self._sum_pa += sample.pressure_pa
        self._count += 1
        if sample.stamp_ns - self._average_ns < _AVERAGE_NS:
            return None
        self._height_m = standard_height_m(self._sum_pa / self._count)
        self._sum_pa, self._count, self._average_ns = 0.0, 0, sample.stamp_ns
        return None if self._offset_m is None else self._height_m + self._offset_m

    def calibrate(self, alt_m: float, stamp_ns: int) -> None:
        """Update the offset by the GNSS altitude `alt_m`."""
        if self._height_m is None:
            return
        offset_m = alt_m - self._height_m
        if self._offset_m is None:
            self._offset_m = offset_m
        else:
            share = min(max((stamp_ns - self._offset_ns) * 1e-9, 0.0) / _OFFSET_S, 1.0)
            self._offset_m += share * (offset_m - self._offset_m)
        self._offset_ns = stamp_ns


def standard_height_m(pressure_pa: float) -> float:
    """Height in m in the ICAO standard atmosphere below 11 km."""
    return float(44_330.769 * (1.0 - (pressure_pa / 101_325.0) ** 0.190263))
