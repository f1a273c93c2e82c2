"""Odometry: pose and velocity from an estimator of its own, a camera's say, that starts at zero and wanders off."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.random import Generator

from sim_core.frames import Array, euler_to_quat, quat_conjugate, quat_multiply, quat_to_matrix
from sim_core.kinematics import Kinematics
from sim_core.sensors.spec import OdometrySpec


@dataclass(frozen=True, slots=True)
class OdometrySample:
    """Position (N, 3) from the first sample, in axes level and turned to the heading of then; attitude (N, 4) against
    the same; velocity and angular rate (N, 3) in the body. Deviations of position and heading by now, (N,): that of
    position without what the error of heading makes of the way.
    """

    pos_local_m: Array
    quat_local_frd: Array
    vel_frd_mps: Array
    gyro_frd_radps: Array
    position_deviation_m: Array
    yaw_deviation_rad: Array


@dataclass(frozen=True, slots=True)
class OdometryState:
    """Of the latest sample: where it truly was and where it reckons (N, 3), and how far its heading has drifted (N,).

    start_quat: (N, 4) the heading that it started with, level. samples: so far; before the first nothing else counts.
    """

    pos_ned_m: Array
    pos_local_m: Array
    start_quat: Array
    drift_yaw_rad: Array
    samples: int = 0


@dataclass(frozen=True, slots=True)
class Odometry:
    """Random walks of position and heading, and white noise: see OdometrySpec.

    Each step of the way is reckoned by the heading of then: an error of heading bends the way and moves nothing behind.
    """

    spec: OdometrySpec
    _drift_m: float = field(init=False, repr=False, compare=False)
    _drift_rad: float = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        per_sample = math.sqrt(1.0 / self.spec.rate_hz)
        object.__setattr__(self, "_drift_m", self.spec.drift_mprts * per_sample)
        object.__setattr__(self, "_drift_rad", math.radians(self.spec.yaw_drift_degprts) * per_sample)

    def initial(self, vessels: int, rng: Generator) -> OdometryState:
        """It starts with its first sample."""
        place = np.zeros((vessels, 3))
        return OdometryState(place, place, np.zeros((vessels, 4)), np.zeros(vessels))

    def measure(self, state: OdometryState, truth: Kinematics, rng: Generator) -> tuple[OdometryState, OdometrySample]:
        """One sample of `truth`; drift goes on between samples."""
        vessels = len(truth.pos_ned_m)
        if not state.samples:
            heading = np.zeros((vessels, 3))
            heading[:, 2] = np.arctan2(truth.rot_ned_frd[:, 1, 0], truth.rot_ned_frd[:, 0, 0])
            state = replace(state, pos_ned_m=truth.pos_ned_m, start_quat=euler_to_quat(heading))
        noise = rng.standard_normal((vessels, 16))
        walks = noise[:, :4] * (state.samples > 0)
        drift_yaw = state.drift_yaw_rad + self._drift_rad * walks[:, 3]
        turn = np.zeros((vessels, 3))
        turn[:, 2] = drift_yaw
        to_local = quat_multiply(euler_to_quat(turn), quat_conjugate(state.start_quat))
        step_m = (quat_to_matrix(to_local) @ (truth.pos_ned_m - state.pos_ned_m)[:, :, None])[:, :, 0]
        pos_local_m = state.pos_local_m + step_m + self._drift_m * walks[:, :3]
        shake = euler_to_quat(math.radians(self.spec.attitude_noise_deg) * noise[:, 4:7])
        walked = math.sqrt(state.samples)
        sample = OdometrySample(
            pos_local_m=pos_local_m + self.spec.position_noise_m * noise[:, 7:10],
            quat_local_frd=quat_multiply(quat_multiply(to_local, truth.quat_ned_frd), shake),
            vel_frd_mps=(truth.vel_ned_mps[:, None] @ truth.rot_ned_frd)[:, 0]
            + self.spec.velocity_noise_mps * noise[:, 10:13],
            gyro_frd_radps=truth.gyro_frd_radps + self.spec.rate_noise_radps * noise[:, 13:16],
            position_deviation_m=np.full(vessels, math.hypot(self.spec.position_noise_m, self._drift_m * walked)),
            yaw_deviation_rad=np.full(
                vessels, math.hypot(math.radians(self.spec.attitude_noise_deg), self._drift_rad * walked)
            ),
        )
        return OdometryState(truth.pos_ned_m, pos_local_m, state.start_quat, drift_yaw, state.samples + 1), sample
