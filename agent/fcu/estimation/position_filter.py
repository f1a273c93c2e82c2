"""Kalman filter of position, velocity and acceleration bias by GNSS and barometer, with innovation gates.

One filter an axis: position, velocity and acceleration bias, driven by a measured acceleration. Only the covariance
lives here; the state itself is integrated at the rate of the IMU by the estimator. North and east have the same noise,
so one covariance serves both. `p' = v, v' = a - b, b' = 0`, discretised exactly over a step.
"""

from __future__ import annotations

from typing import NamedTuple

from agent.fcu.estimation.inertial import StateCorrection
from agent.fcu.parameters import Parameters
from agent.fcu.vehicle_state import BarometerMeasurement, Vector3

_STEP_LIMIT_S = 5.0
_STEP_HZ = 100.0  # ArduPilot's process noises are per step of its filter
Gain = tuple[float, float, float]
PRESSURE_RANGE_PA = (30_000.0, 120_000.0)
_AVERAGE_NS = 100_000_000
_OFFSET_S = 60.0


class AxisCovariance(NamedTuple):
    """Upper triangle of the covariance of (position m, velocity m/s, acceleration bias m/s²)."""

    pp: float
    pv: float
    pb: float
    vv: float
    vb: float
    bb: float


def predict_covariance(c: AxisCovariance, dt_s: float, acceleration_psd: float, bias_psd: float) -> AxisCovariance:
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


_START = AxisCovariance(pp=4.0, pv=0.0, pb=0.0, vv=1.0, vb=0.0, bb=0.01)


class InnovationRatios(NamedTuple):
    """Squared innovations over squared gates; above one the measurement was refused."""

    position: float = 0.0
    velocity: float = 0.0
    height: float = 0.0
    heading: float = 0.0


class PositionFilter:
    """Two covariances: one for north and east, whose noises are equal, one for down."""

    def __init__(self, parameters: Parameters) -> None:
        self.configure(parameters)
        self.ratios = InnovationRatios()
        self._horizontal_ns: int | None = None
        self._vertical_ns: int | None = None
        self.restart()

    def configure(self, parameters: Parameters) -> None:
        """Take noises and gates over."""
        self._acceleration_psd = parameters["EK3_ACC_P_NSE"] ** 2 / _STEP_HZ
        self._bias_psd = parameters["EK3_ABIAS_P_NSE"] ** 2 / _STEP_HZ
        self._pos_noise_m = parameters["EK3_POSNE_M_NSE"]
        self._vel_noise_mps = parameters["EK3_VELNE_M_NSE"]
        self._vel_down_noise_mps = parameters["EK3_VELD_M_NSE"]
        self._baro_variance_m2 = parameters["EK3_ALT_M_NSE"] ** 2
        self._pos_gate2 = (parameters["EK3_POS_I_GATE"] / 100.0) ** 2
        self._vel_gate2 = (parameters["EK3_VEL_I_GATE"] / 100.0) ** 2
        self._height_gate2 = (parameters["EK3_HGT_I_GATE"] / 100.0) ** 2

    def restart(self) -> None:
        """Forget the covariances: position and velocity have just been set."""
        self._horizontal = _START
        self._vertical = _START

    def loosen(self, dt_s: float) -> None:
        """Nothing was measured for `dt_s`: velocity may have changed by up to 1 m/s, position by the same all along."""
        wider = AxisCovariance(pp=4.0 + dt_s * dt_s, pv=0.0, pb=0.0, vv=1.0, vb=0.0, bb=0.01)
        self._horizontal = self._vertical = wider

    def fuse_gnss(
        self, stamp_ns: int, pos_innovation_ned_m: Vector3, vel_innovation_ned_mps: Vector3, accuracy: Vector3
    ) -> StateCorrection:
        """Innovations are measured minus remembered; `accuracy` is the receiver's own (horizontal, vertical, speed)."""
        self._predict_horizontal(stamp_ns)
        self._predict_vertical(stamp_ns)
        pos_variance = max(self._pos_noise_m, accuracy[0]) ** 2
        vel_variance = max(self._vel_noise_mps, accuracy[2]) ** 2
        in_n, in_e, in_d = pos_innovation_ned_m
        iv_n, iv_e, iv_d = vel_innovation_ned_mps
        pn = pe = pd = vn = ve = vd = bn = be = bd = 0.0

        position_ratio = (in_n * in_n + in_e * in_e) / (self._pos_gate2 * (self._horizontal.pp + pos_variance))
        if position_ratio <= 1.0:
            self._horizontal, (kp, kv, kb) = position_update(self._horizontal, pos_variance)
            pn, vn, bn = kp * in_n, kv * in_n, kb * in_n
            pe, ve, be = kp * in_e, kv * in_e, kb * in_e
        iv_n -= vn
        iv_e -= ve
        velocity_ratio = (iv_n * iv_n + iv_e * iv_e) / (self._vel_gate2 * (self._horizontal.vv + vel_variance))
        if velocity_ratio <= 1.0:
            self._horizontal, (kp, kv, kb) = velocity_update(self._horizontal, vel_variance)
            pn, vn, bn = pn + kp * iv_n, vn + kv * iv_n, bn + kb * iv_n
            pe, ve, be = pe + kp * iv_e, ve + kv * iv_e, be + kb * iv_e

        height_variance = max(1.5 * self._pos_noise_m, accuracy[1]) ** 2
        down_variance = max(self._vel_down_noise_mps, accuracy[2]) ** 2
        height_ratio = in_d * in_d / (self._height_gate2 * (self._vertical.pp + height_variance))
        if height_ratio <= 1.0:
            self._vertical, (kp, kv, kb) = position_update(self._vertical, height_variance)
            pd, vd, bd = kp * in_d, kv * in_d, kb * in_d
        iv_d -= vd
        if iv_d * iv_d <= self._vel_gate2 * (self._vertical.vv + down_variance):
            self._vertical, (kp, kv, kb) = velocity_update(self._vertical, down_variance)
            pd, vd, bd = pd + kp * iv_d, vd + kv * iv_d, bd + kb * iv_d

        self.ratios = self.ratios._replace(position=position_ratio, velocity=velocity_ratio, height=height_ratio)
        return StateCorrection((pn, pe, pd), (vn, ve, vd), (bn, be, bd))

    def fuse_height(self, stamp_ns: int, innovation_down_m: float) -> StateCorrection:
        """A barometer's innovation, down."""
        self._predict_vertical(stamp_ns)
        ratio = innovation_down_m**2 / (self._height_gate2 * (self._vertical.pp + self._baro_variance_m2))
        kp = kv = kb = 0.0
        if ratio <= 1.0:
            self._vertical, (kp, kv, kb) = position_update(self._vertical, self._baro_variance_m2)
        return StateCorrection(
            (0.0, 0.0, kp * innovation_down_m), (0.0, 0.0, kv * innovation_down_m), (0.0, 0.0, kb * innovation_down_m)
        )

    def _predict_horizontal(self, stamp_ns: int) -> None:
        dt_s = _step_s(self._horizontal_ns, stamp_ns)
        self._horizontal = predict_covariance(self._horizontal, dt_s, self._acceleration_psd, self._bias_psd)
        self._horizontal_ns = stamp_ns

    def _predict_vertical(self, stamp_ns: int) -> None:
        """A fix is older than the barometer samples fused before it: no step back is taken."""
        dt_s = _step_s(self._vertical_ns, stamp_ns)
        self._vertical = predict_covariance(self._vertical, dt_s, self._acceleration_psd, self._bias_psd)
        self._vertical_ns = stamp_ns if self._vertical_ns is None else max(stamp_ns, self._vertical_ns)


def _step_s(last_ns: int | None, stamp_ns: int) -> float:
    return 0.0 if last_ns is None else min(max((stamp_ns - last_ns) * 1e-9, 0.0), _STEP_LIMIT_S)


class BarometerHeight:
    """Weather and the standard atmosphere's error go into the offset, which follows the GNSS over a minute."""

    def __init__(self) -> None:
        self.stamp_ns: int | None = None
        self._average_ns = 0
        self._sum_pa = 0.0
        self._count = 0
        self._height_m: float | None = None
        self._offset_m: float | None = None
        self._offset_ns = 0

    def add(self, sample: BarometerMeasurement) -> float | None:
        """Altitude above mean sea level ten times a second, once there is an offset; None in between."""
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
        """The GNSS says that the altitude is `alt_m`."""
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
    """Height in the ICAO standard atmosphere below 11 km."""
    return float(44_330.769 * (1.0 - (pressure_pa / 101_325.0) ** 0.190263))
