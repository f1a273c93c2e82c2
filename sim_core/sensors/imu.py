"""Inertial measurement unit: three gyroscopes and three accelerometers at one point of the body."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.random import Generator

from sim_core.frames import Array
from sim_core.kinematics import Kinematics
from sim_core.noise import SampledGaussMarkov, bias_deviation, sampled_gauss_markov, white_deviation
from sim_core.sensors.measurement import (
    Digitiser,
    centripetal_matrix,
    cross_matrix,
    digitiser,
    pair_products,
    require_finite,
    require_non_negative,
    require_positive,
    require_vector,
)


@dataclass(frozen=True, slots=True)
class ImuSample:
    """gyro_frd_radps (N, 3), accel_frd_mps2 (N, 3) specific force, temperature_degc (N,)."""

    gyro_frd_radps: Array
    accel_frd_mps2: Array
    temperature_degc: Array


@dataclass(frozen=True, slots=True)
class ImuState:
    """Errors that outlive a sample, (N, 6) as gyro x, y, z in rad/s, then accelerometer x, y, z in m/s^2.

    turn_on_bias: drawn once; drifting_bias: Gauss-Markov. temperature_degc: (N,).
    """

    turn_on_bias: Array
    drifting_bias: Array
    temperature_degc: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Imu:
    """Gyroscopes and accelerometers with white noise, drifting and turn-on bias, quantisation and range.

    *_noise_density_*: white noise; the Allan deviation at 1 s. *_bias_instability_*: the maximum of the Allan deviation
    of the drifting bias, reached at 1.89 times *_bias_correlation_s. *_turn_on_bias_*: deviation of the constant bias.
    *_resolution_*: step of the output, 0 for none; *_range_*: full scale, None for unlimited.
    position_frd_m: of the sensor, from the body origin. gravity_mps2: local, see `geodesy.normal_gravity_mps2`.
    Raises ValueError naming the field that cannot be.
    """

    rate_hz: float = 200.0
    latency_s: float = 0.0
    gyro_noise_density_radpsprthz: float = 0.0
    gyro_bias_instability_radps: float = 0.0
    gyro_bias_correlation_s: float = 100.0
    gyro_turn_on_bias_radps: float = 0.0
    gyro_resolution_radps: float = 0.0
    gyro_range_radps: float | None = None
    accel_noise_density_mps2prthz: float = 0.0
    accel_bias_instability_mps2: float = 0.0
    accel_bias_correlation_s: float = 100.0
    accel_turn_on_bias_mps2: float = 0.0
    accel_resolution_mps2: float = 0.0
    accel_range_mps2: float | None = None
    position_frd_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    temperature_degc: float = 25.0
    gravity_mps2: float = 9.80665
    _scale: Array = field(init=False, repr=False, compare=False)
    _turn_on: Array = field(init=False, repr=False, compare=False)
    _drift: SampledGaussMarkov = field(init=False, repr=False, compare=False)
    _gravity_ned_mps2: Array = field(init=False, repr=False, compare=False)
    _cross: Array | None = field(init=False, repr=False, compare=False)
    _gyro_output: Digitiser = field(init=False, repr=False, compare=False)
    _accel_output: Digitiser = field(init=False, repr=False, compare=False)
    _centripetal: Array = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        self._check()
        gyro_white = white_deviation(self.gyro_noise_density_radpsprthz, self.rate_hz)
        accel_white = white_deviation(self.accel_noise_density_mps2prthz, self.rate_hz)
        drift = sampled_gauss_markov(
            _six(bias_deviation(self.gyro_bias_instability_radps), bias_deviation(self.accel_bias_instability_mps2)),
            _six(self.gyro_bias_correlation_s, self.accel_bias_correlation_s),
            self.rate_hz,
        )
        put = object.__setattr__
        put(self, "_scale", np.hstack([_six(gyro_white, accel_white), drift.drive]))
        put(self, "_turn_on", _six(self.gyro_turn_on_bias_radps, self.accel_turn_on_bias_mps2))
        put(self, "_drift", drift)
        put(self, "_gravity_ned_mps2", np.array([[0.0, 0.0, self.gravity_mps2]]))
        put(self, "_cross", cross_matrix(self.position_frd_m) if any(self.position_frd_m) else None)
        put(self, "_gyro_output", digitiser(self.gyro_resolution_radps, self.gyro_range_radps))
        put(self, "_accel_output", digitiser(self.accel_resolution_mps2, self.accel_range_mps2))
        put(self, "_centripetal", centripetal_matrix(self.position_frd_m))

    def _check(self) -> None:
        require_positive(
            "imu",
            rate_hz=self.rate_hz,
            gyro_bias_correlation_s=self.gyro_bias_correlation_s,
            accel_bias_correlation_s=self.accel_bias_correlation_s,
        )
        require_non_negative(
            "imu",
            latency_s=self.latency_s,
            gyro_noise_density_radpsprthz=self.gyro_noise_density_radpsprthz,
            gyro_bias_instability_radps=self.gyro_bias_instability_radps,
            gyro_turn_on_bias_radps=self.gyro_turn_on_bias_radps,
            gyro_resolution_radps=self.gyro_resolution_radps,
            accel_noise_density_mps2prthz=self.accel_noise_density_mps2prthz,
            accel_bias_instability_mps2=self.accel_bias_instability_mps2,
            accel_turn_on_bias_mps2=self.accel_turn_on_bias_mps2,
            accel_resolution_mps2=self.accel_resolution_mps2,
        )
        if self.gyro_range_radps is not None:
            require_positive("imu", gyro_range_radps=self.gyro_range_radps)
        if self.accel_range_mps2 is not None:
            require_positive("imu", accel_range_mps2=self.accel_range_mps2)
        require_vector("imu", position_frd_m=self.position_frd_m)
        require_finite("imu", temperature_degc=self.temperature_degc, gravity_mps2=self.gravity_mps2)

    def initial(self, vessels: int, rng: Generator) -> ImuState:
        """Biases of `vessels` units as they are switched on."""
        normals = rng.standard_normal((vessels, 12))
        return ImuState(
            turn_on_bias=self._turn_on * normals[:, :6],
            drifting_bias=self._drift.initial(normals[:, 6:]),
            temperature_degc=np.full(vessels, self.temperature_degc),
        )

    def measure(self, state: ImuState, truth: Kinematics, rng: Generator) -> tuple[ImuState, ImuSample]:
        """One sample of the motion `truth`; the returned state is that of the next sample."""
        noise = self._scale * rng.standard_normal((len(truth.acc_ned_mps2), 12))
        error = state.turn_on_bias + state.drifting_bias + noise[:, :6]
        gyro = truth.gyro_frd_radps + error[:, :3]
        accel = self._specific_force_frd_mps2(truth) + error[:, 3:]
        sample = ImuSample(
            gyro_frd_radps=self._gyro_output.read(gyro),
            accel_frd_mps2=self._accel_output.read(accel),
            temperature_degc=state.temperature_degc,
        )
        drifting_bias = self._drift.decay * state.drifting_bias + noise[:, 6:]
        return ImuState(state.turn_on_bias, drifting_bias, state.temperature_degc), sample

    def _specific_force_frd_mps2(self, truth: Kinematics) -> Array:
        """(N, 3) `R^T (a - g) + alpha x r + w x (w x r)`, the acceleration of the sensor's own point less gravity."""
        force: Array = ((truth.acc_ned_mps2 - self._gravity_ned_mps2)[:, None, :] @ truth.rot_ned_frd)[:, 0, :]
        if self._cross is None:
            return force
        swing: Array = truth.angular_acc_frd_radps2.dot(self._cross)
        pull: Array = pair_products(truth.gyro_frd_radps).dot(self._centripetal)
        return force + swing + pull


def _six(gyro: float, accel: float) -> Array:
    """(1, 6), the shape that a single vessel's row multiplies without broadcasting."""
    return np.array([[gyro, gyro, gyro, accel, accel, accel]])
