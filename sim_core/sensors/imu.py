"""Inertial measurement unit: three gyroscopes and three accelerometers at one point of the body."""

from __future__ import annotations

from dataclasses import field

import numpy as np
from numpy.random import Generator

from sim_core.dataclass import dataclass
from sim_core.frames import Array
from sim_core.keys import check_values
from sim_core.kinematics import Kinematics
from sim_core.noise import SampledGaussMarkov, bias_deviation, sampled_gauss_markov, white_deviation
from sim_core.sensors.measurement import (
    Digitiser,
    centripetal_matrix,
    cross_matrix,
    joined_digitiser,
    pair_products,
)
from sim_core.sensors.spec import ImuSpec
from sim_core.state_class import state_class

TEMPERATURE_DEGC = 25.0
"""Temperature of the unit."""


@state_class
class ImuSample:
    """Sample of N units."""

    gyro_frd_radps: Array
    """Angular velocity, (N, 3), body axes."""
    accel_frd_mps2: Array
    """Specific force, (N, 3), body axes."""
    temperature_degc: Array
    """Temperature of the unit, (N,)."""


@state_class
class ImuState:
    """Errors that outlast a sample: (N, 6) as gyro x, y, z in rad/s, then accelerometer x, y, z in m/s^2."""

    turn_on_bias: Array
    """Bias at switch-on, drawn once."""
    drifting_bias: Array
    """Gauss-Markov bias."""
    temperature_degc: Array
    """Temperature of the unit, (N,)."""


@dataclass(frozen=True, slots=True)
class Imu:
    """White noise, drifting and turn-on bias, quantisation and range, see ImuSpec."""

    spec: ImuSpec
    gravity_mps2: float = 9.80665
    """Local gravity, see `geodesy.normal_gravity_mps2`."""
    _scale: Array = field(init=False, repr=False, compare=False)
    _turn_on: Array = field(init=False, repr=False, compare=False)
    _drift: SampledGaussMarkov = field(init=False, repr=False, compare=False)
    _gravity_ned_mps2: Array = field(init=False, repr=False, compare=False)
    _cross: Array | None = field(init=False, repr=False, compare=False)
    _output: Digitiser = field(init=False, repr=False, compare=False)
    _centripetal: Array = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        check_values(self)
        spec = self.spec
        gyro_white = white_deviation(spec.gyro_noise_density_radpsprthz, spec.rate_hz)
        accel_white = white_deviation(spec.accel_noise_density_mps2prthz, spec.rate_hz)
        drift = sampled_gauss_markov(
            _six(
                bias_deviation(spec.gyro_bias_instability_radps),
                bias_deviation(spec.accel_bias_instability_mps2),
            ),
            _six(spec.gyro_bias_correlation_s, spec.accel_bias_correlation_s),
            spec.rate_hz,
        )
        put = object.__setattr__
        put(self, "_scale", np.hstack([_six(gyro_white, accel_white), drift.drive]))
        put(self, "_turn_on", _six(spec.gyro_turn_on_bias_radps, spec.accel_turn_on_bias_mps2))
        put(self, "_drift", drift)
        put(self, "_gravity_ned_mps2", np.array([[0.0, 0.0, self.gravity_mps2]]))
        put(self, "_cross", cross_matrix(spec.position_frd_m) if any(spec.position_frd_m) else None)
        gyro_output = (3, spec.gyro_resolution_radps, spec.gyro_range_radps)
        put(self, "_output", joined_digitiser(gyro_output, (3, spec.accel_resolution_mps2, spec.accel_range_mps2)))
        put(self, "_centripetal", centripetal_matrix(spec.position_frd_m))

    def initial(self, vessels: int, rng: Generator) -> ImuState:
        """Draw the biases of `vessels` units at switch-on."""
        normals = rng.standard_normal((vessels, 12))
        return ImuState(
            turn_on_bias=self._turn_on * normals[:, :6],
            drifting_bias=self._drift.initial(normals[:, 6:]),
            temperature_degc=np.full(vessels, TEMPERATURE_DEGC),
        )

    def measure(self, state: ImuState, truth: Kinematics, rng: Generator) -> tuple[ImuState, ImuSample]:
        """Take one sample of the motion `truth`. The returned state is the state of the next sample."""
        noise = self._scale * rng.standard_normal((len(truth.acc_ned_mps2), 12))
        # Specific force at the sensor's position: R^T (a - g) + alpha x r + w x (w x r)
        force: Array = ((truth.acc_ned_mps2 - self._gravity_ned_mps2)[:, None, :] @ truth.rot_ned_frd)[:, 0, :]
        if self._cross is not None:
            swing: Array = truth.angular_acc_frd_radps2.dot(self._cross)
            # Row by row: a product of all rows together rounds otherwise than that of one.
            pull: Array = (pair_products(truth.gyro_frd_radps)[:, None, :] @ self._centripetal)[:, 0]
            force = force + swing + pull
        error = state.turn_on_bias + state.drifting_bias + noise[:, :6]
        output = self._output.read(np.concatenate((truth.gyro_frd_radps, force), axis=1) + error)
        sample = ImuSample(output[:, :3], output[:, 3:], state.temperature_degc)
        drifting_bias = self._drift.decay * state.drifting_bias + noise[:, 6:]
        return ImuState(state.turn_on_bias, drifting_bias, state.temperature_degc), sample


def _six(gyro: float, accel: float) -> Array:
    """Return (1, 6), a shape that multiplies the row of a single vessel without broadcasting."""
    return np.array([[gyro, gyro, gyro, accel, accel, accel]])
