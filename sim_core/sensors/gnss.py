"""GNSS receiver: position and velocity of its antenna."""

from __future__ import annotations

import math
from dataclasses import field

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from sim_core.frames import Array
from sim_core.geodesy import LocalFrame
from sim_core.kinematics import Kinematics
from sim_core.noise import SampledGaussMarkov, sampled_gauss_markov
from sim_core.sensors.measurement import cross_matrix
from sim_core.sensors.spec import GnssSpec

FIX_3D = 3
"""GPS_FIX_TYPE of MAVLink."""


@dataclass(frozen=True, slots=True)
class GnssSample:
    """Antenna position and velocity of N receivers, with the receiver's estimate of its errors."""

    lat_deg: Array
    """Latitude, (N,)."""
    lon_deg: Array
    """Longitude, (N,)."""
    alt_m: Array
    """Altitude above the WGS84 ellipsoid, (N,)."""
    vel_ned_mps: Array
    """Velocity, (N, 3)."""
    horizontal_accuracy_m: Array
    """RMS of the whole error of both horizontal axes, (N,)."""
    vertical_accuracy_m: Array
    """RMS of the whole error of the vertical, (N,)."""
    speed_accuracy_mps: Array
    """RMS of the whole error of all three velocity axes, (N,)."""
    fix_type: NDArray[np.int64]
    """GPS_FIX_TYPE of MAVLink, (N,)."""
    satellites: NDArray[np.int64]
    """Number of satellites, (N,)."""


@dataclass(frozen=True, slots=True)
class GnssState:
    """State of N receivers. All but drift_ned_m are the reported quality, (N,), as in the sample."""

    drift_ned_m: Array
    """Slowly varying position error, (N, 3)."""
    horizontal_accuracy_m: Array
    vertical_accuracy_m: Array
    speed_accuracy_mps: Array
    fix_type: NDArray[np.int64]
    satellites: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Gnss:
    """White and Gauss-Markov position errors and white velocity errors, see GnssSpec."""

    spec: GnssSpec
    frame: LocalFrame
    """Position of NED on the Earth. The velocity has the axes of this frame, not of the antenna's horizon (9
    millidegrees at 1 km).
    """
    _scale: Array = field(init=False, repr=False, compare=False)
    _drift: SampledGaussMarkov = field(init=False, repr=False, compare=False)
    _antenna_frd_m: Array | None = field(init=False, repr=False, compare=False)
    _cross: Array = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        horizontal, vertical, velocity = (
            self.spec.horizontal_noise_m,
            self.spec.vertical_noise_m,
            self.spec.velocity_noise_mps,
        )
        drift_m = [self.spec.horizontal_drift_m, self.spec.horizontal_drift_m, self.spec.vertical_drift_m]
        put = object.__setattr__
        drift = sampled_gauss_markov(drift_m, self.spec.drift_correlation_s, self.spec.rate_hz)
        white = np.array([[horizontal, horizontal, vertical, velocity, velocity, velocity]])
        put(self, "_drift", drift)
        put(self, "_scale", np.hstack([white, drift.drive]))
        put(self, "_antenna_frd_m", np.array(self.spec.antenna_frd_m) if any(self.spec.antenna_frd_m) else None)
        put(self, "_cross", cross_matrix(self.spec.antenna_frd_m))

    def initial(self, vessels: int, rng: Generator) -> GnssState:
        """Return the state of `vessels` receivers. The drift has its stationary deviation from the start."""
        return GnssState(
            drift_ned_m=self._drift.initial(rng.standard_normal((vessels, 3))),
            horizontal_accuracy_m=np.full(
                vessels, math.sqrt(2.0) * math.hypot(self.spec.horizontal_noise_m, self.spec.horizontal_drift_m)
            ),
            vertical_accuracy_m=np.full(vessels, math.hypot(self.spec.vertical_noise_m, self.spec.vertical_drift_m)),
            speed_accuracy_mps=np.full(vessels, math.sqrt(3.0) * self.spec.velocity_noise_mps),
            fix_type=np.full(vessels, FIX_3D, dtype=np.int64),
            satellites=np.full(vessels, self.spec.satellites, dtype=np.int64),
        )

    def measure(self, state: GnssState, truth: Kinematics, rng: Generator) -> tuple[GnssState, GnssSample]:
        """Take one fix of the motion `truth`. The returned state is the state of the next fix."""
        noise = self._scale * rng.standard_normal((len(truth.pos_ned_m), 9))
        position = truth.pos_ned_m + state.drift_ned_m + noise[:, :3]
        velocity = truth.vel_ned_mps + noise[:, 3:6]
        if self._antenna_frd_m is not None:
            position += truth.rot_ned_frd.dot(self._antenna_frd_m)
            velocity += (truth.rot_ned_frd @ truth.gyro_frd_radps.dot(self._cross)[:, :, None])[:, :, 0]
        latitude, longitude, altitude = self.frame.geodetic(position)
        accuracy = (state.horizontal_accuracy_m, state.vertical_accuracy_m, state.speed_accuracy_mps)
        quality = (*accuracy, state.fix_type, state.satellites)
        drift_ned_m = self._drift.decay * state.drift_ned_m + noise[:, 6:]
        return GnssState(drift_ned_m, *quality), GnssSample(latitude, longitude, altitude, velocity, *quality)
