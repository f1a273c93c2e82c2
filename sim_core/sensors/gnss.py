"""GNSS receiver: position and velocity of its antenna."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from sim_core.frames import Array
from sim_core.geodesy import LocalFrame
from sim_core.kinematics import Kinematics
from sim_core.noise import SampledGaussMarkov, sampled_gauss_markov
from sim_core.sensors.measurement import cross_matrix, require_non_negative, require_positive, require_vector


@dataclass(frozen=True, slots=True)
class GnssSample:
    """Antenna position and velocity, all (N,) but vel_ned_mps (N, 3), with the receiver's own estimate of its errors.

    alt_m is above the WGS84 ellipsoid. The accuracies are the RMS of the whole error: of both horizontal axes, of the
    vertical, of all three velocity axes. fix_type as in MAVLink's GPS_FIX_TYPE (3 is a 3D fix).
    """

    lat_deg: Array
    lon_deg: Array
    alt_m: Array
    vel_ned_mps: Array
    horizontal_accuracy_m: Array
    vertical_accuracy_m: Array
    speed_accuracy_mps: Array
    fix_type: NDArray[np.int64]
    satellites: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class GnssState:
    """drift_ned_m (N, 3): slowly varying position error. The rest (N,): the quality it reports, as in the sample."""

    drift_ned_m: Array
    horizontal_accuracy_m: Array
    vertical_accuracy_m: Array
    speed_accuracy_mps: Array
    fix_type: NDArray[np.int64]
    satellites: NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Gnss:
    """Receiver with white and Gauss-Markov position errors and white velocity errors.

    Deviations are per axis. horizontal_noise_m, vertical_noise_m: from one fix to the next; horizontal_drift_m,
    vertical_drift_m: correlated over drift_correlation_s. antenna_frd_m: from the body origin. frame: where NED is on
    the Earth. The velocity is in the axes of that frame, not of the antenna's own horizon (9 millidegrees at 1 km).
    Raises ValueError naming the field that cannot be.
    """

    frame: LocalFrame
    rate_hz: float = 5.0
    latency_s: float = 0.12
    horizontal_noise_m: float = 0.0
    vertical_noise_m: float = 0.0
    horizontal_drift_m: float = 0.0
    vertical_drift_m: float = 0.0
    drift_correlation_s: float = 60.0
    velocity_noise_mps: float = 0.0
    fix_type: int = 3
    satellites: int = 12
    antenna_frd_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    _scale: Array = field(init=False, repr=False, compare=False)
    _drift: SampledGaussMarkov = field(init=False, repr=False, compare=False)
    _antenna_frd_m: Array | None = field(init=False, repr=False, compare=False)
    _cross: Array = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        self._check()
        horizontal, vertical, velocity = self.horizontal_noise_m, self.vertical_noise_m, self.velocity_noise_mps
        drift_m = [self.horizontal_drift_m, self.horizontal_drift_m, self.vertical_drift_m]
        put = object.__setattr__
        drift = sampled_gauss_markov(drift_m, self.drift_correlation_s, self.rate_hz)
        white = np.array([[horizontal, horizontal, vertical, velocity, velocity, velocity]])
        put(self, "_drift", drift)
        put(self, "_scale", np.hstack([white, drift.drive]))
        put(self, "_antenna_frd_m", np.array(self.antenna_frd_m) if any(self.antenna_frd_m) else None)
        put(self, "_cross", cross_matrix(self.antenna_frd_m))

    def _check(self) -> None:
        require_positive("gnss", rate_hz=self.rate_hz, drift_correlation_s=self.drift_correlation_s)
        require_non_negative(
            "gnss",
            latency_s=self.latency_s,
            horizontal_noise_m=self.horizontal_noise_m,
            vertical_noise_m=self.vertical_noise_m,
            horizontal_drift_m=self.horizontal_drift_m,
            vertical_drift_m=self.vertical_drift_m,
            velocity_noise_mps=self.velocity_noise_mps,
        )
        require_vector("gnss", antenna_frd_m=self.antenna_frd_m)
        for name, value, most in (("fix_type", self.fix_type, 8), ("satellites", self.satellites, 254)):
            if not 0 <= value <= most:
                raise ValueError(f"gnss.{name} = {value} is out of range; give an integer from 0 to {most}")

    def initial(self, vessels: int, rng: Generator) -> GnssState:
        """`vessels` receivers whose drift is already at its stationary deviation."""
        return GnssState(
            drift_ned_m=self._drift.initial(rng.standard_normal((vessels, 3))),
            horizontal_accuracy_m=np.full(
                vessels, math.sqrt(2.0) * math.hypot(self.horizontal_noise_m, self.horizontal_drift_m)
            ),
            vertical_accuracy_m=np.full(vessels, math.hypot(self.vertical_noise_m, self.vertical_drift_m)),
            speed_accuracy_mps=np.full(vessels, math.sqrt(3.0) * self.velocity_noise_mps),
            fix_type=np.full(vessels, self.fix_type, dtype=np.int64),
            satellites=np.full(vessels, self.satellites, dtype=np.int64),
        )

    def measure(self, state: GnssState, truth: Kinematics, rng: Generator) -> tuple[GnssState, GnssSample]:
        """One fix of the motion `truth`; the returned state is that of the next fix."""
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
