"""Position, velocity and acceleration-bias corrections from GNSS and barometer, with innovation gates."""

from __future__ import annotations

from typing import NamedTuple

from agent.fcu.parameters import Parameters
from agent.fcu.samples import Vector3
from agent.fcu.sensing.axis_filter import AxisCovariance, position_update, predicted, velocity_update

_START = AxisCovariance(pp=4.0, pv=0.0, pb=0.0, vv=1.0, vb=0.0, bb=0.01)
_STEP_LIMIT_S = 5.0
_STEP_HZ = 100.0  # ArduPilot's process noises are per step of its filter


class Correction(NamedTuple):
    """What to add to position, velocity and acceleration bias at the instant of the measurement, NED."""

    pos_ned_m: Vector3
    vel_ned_mps: Vector3
    bias_ned_mps2: Vector3


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
    ) -> Correction:
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
        return Correction((pn, pe, pd), (vn, ve, vd), (bn, be, bd))

    def fuse_height(self, stamp_ns: int, innovation_down_m: float) -> Correction:
        """A barometer's innovation, down."""
        self._predict_vertical(stamp_ns)
        ratio = innovation_down_m**2 / (self._height_gate2 * (self._vertical.pp + self._baro_variance_m2))
        kp = kv = kb = 0.0
        if ratio <= 1.0:
            self._vertical, (kp, kv, kb) = position_update(self._vertical, self._baro_variance_m2)
        return Correction(
            (0.0, 0.0, kp * innovation_down_m), (0.0, 0.0, kv * innovation_down_m), (0.0, 0.0, kb * innovation_down_m)
        )

    def _predict_horizontal(self, stamp_ns: int) -> None:
        dt_s = _step_s(self._horizontal_ns, stamp_ns)
        self._horizontal = predicted(self._horizontal, dt_s, self._acceleration_psd, self._bias_psd)
        self._horizontal_ns = stamp_ns

    def _predict_vertical(self, stamp_ns: int) -> None:
        """A fix is older than the barometer samples fused before it: no step back is taken."""
        dt_s = _step_s(self._vertical_ns, stamp_ns)
        self._vertical = predicted(self._vertical, dt_s, self._acceleration_psd, self._bias_psd)
        self._vertical_ns = stamp_ns if self._vertical_ns is None else max(stamp_ns, self._vertical_ns)


def _step_s(last_ns: int | None, stamp_ns: int) -> float:
    return 0.0 if last_ns is None else min(max((stamp_ns - last_ns) * 1e-9, 0.0), _STEP_LIMIT_S)
