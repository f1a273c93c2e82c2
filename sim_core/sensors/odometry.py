"""Odometry: pose and velocity from an independent estimator, for example a camera, that starts at zero and drifts."""

from __future__ import annotations

import math
from dataclasses import field, replace

import numpy as np
from numpy.random import Generator

from sim_core.dataclass import dataclass
from sim_core.frames import Array, euler_to_quat, quat_conjugate, quat_multiply, quat_to_matrix
from sim_core.kinematics import Kinematics
from sim_core.sensors.spec import OdometrySpec


@dataclass(frozen=True, slots=True)
class OdometrySample:
    """Sample of N units. The local frame is level, with the position and heading of the first sample."""

    pos_local_m: Array
    """Position from the first sample, (N, 3)."""
    quat_local_frd: Array
    """Attitude relative to the local frame, (N, 4)."""
    vel_frd_mps: Array
    """Velocity in body axes, (N, 3)."""
    gyro_frd_radps: Array
    """Angular rate in body axes, (N, 3)."""
    position_deviation_m: Array
    """Present deviation of the position, (N,), without the effect of the heading error."""
    yaw_deviation_rad: Array
    """Present deviation of the heading, (N,)."""


@dataclass(frozen=True, slots=True)
class OdometryState:
    """State at the latest sample of N units."""

    pos_ned_m: Array
    """True position, (N, 3)."""
    pos_local_m: Array
    """Estimated position, (N, 3)."""
    start_quat: Array
    """Initial heading as a level attitude, (N, 4)."""
    drift_yaw_rad: Array
    """Drift of the heading so far, (N,)."""
    samples: int = 0
    """Number of samples so far. Before the first sample, the other fields have no meaning."""


@dataclass(frozen=True, slots=True)
class Odometry:
    """Random walks of position and heading, and white noise, see OdometrySpec.

    Each step of the path uses the heading of its instant. A heading error bends the path and does not move earlier
    positions.
    """

    spec: OdometrySpec
    _drift_m: float = field(init=False, repr=False, compare=False)
    _drift_rad: float = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        per_sample = math.sqrt(1.0 / self.spec.rate_hz)
        object.__setattr__(self, "_drift_m", self.spec.drift_mprts * per_sample)
        object.__setattr__(self, "_drift_rad", math.radians(self.spec.yaw_drift_degprts) * per_sample)

    def initial(self, vessels: int, rng: Generator) -> OdometryState:
        """Return the state before the first sample, which sets the origin."""
        place = np.zeros((vessels, 3))
        return OdometryState(place, place, np.zeros((vessels, 4)), np.zeros(vessels))

    def measure(self, state: OdometryState, truth: Kinematics, rng: Generator) -> tuple[OdometryState, OdometrySample]:
        """Take one sample of `truth`. Drift continues between samples."""
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
