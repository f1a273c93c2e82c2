"""The profile's sensors for a block of vessels, each at its own rate and with its own latency."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.random import Generator, default_rng

from sim_core.environment.wind import Air
from sim_core.frames import Array
from sim_core.geodesy import LocalFrame, normal_gravity_mps2
from sim_core.kinematics import Kinematics
from sim_core.rows import Rows, with_rows
from sim_core.sensors.barometer import Barometer, BarometerSample
from sim_core.sensors.gnss import Gnss, GnssSample
from sim_core.sensors.imu import Imu, ImuSample
from sim_core.sensors.magnetometer import Magnetometer, MagnetometerSample
from sim_core.sensors.wind_vane import WindSample, WindVane
from sim_core.simulation import SimulationState
from xitl_cli.errors import UserError
from xitl_cli.profile.schema import RunProfile
from xitl_cli.run.world.world import local_frame, magnetic_field_ned_gauss
from xitl_cli.seeds import Seeds

PA_PER_HPA = 100.0


class BlockSensor:
    """One kind of sensor on all vessels of a block. latest: newest delivered sample, (N, K).

    numbers: returns the (N, K) numbers of a sample.
    """

    def __init__(
        self, sensor: Any, numbers: Callable[[Any], Array], dt_ns: int, rng: Generator, *, needs_air: bool = False
    ) -> None:
        self.latest = np.zeros((0, 0))
        self._sensor = sensor
        self._numbers = numbers
        self._period_ns = round(1e9 / (dt_ns * sensor.spec.rate_hz)) * dt_ns
        self._latency_ns = round(sensor.spec.latency_s * 1e9)
        self._needs_air = needs_air
        self._rng = rng
        self._waiting: deque[tuple[int, Array]] = deque()
        self._state: Any = None

    def begin(self, motion: Kinematics, air_ned_mps: Array) -> None:
        """Switch all sensors on. The first sample has no latency."""
        self._waiting.clear()
        self._state, self.latest = self._fresh(motion, air_ned_mps)

    def restart(self, rows: Rows, motion: Kinematics, air_ned_mps: Array) -> None:
        """Switch the sensors of K rows off and on again. motion, air_ned_mps: of these rows."""
        state, numbers = self._fresh(motion, air_ned_mps)
        self._state = with_rows(self._state, rows, state)
        self.latest = self.latest.copy()
        for values in (self.latest, *(values for _, values in self._waiting)):
            values[rows] = numbers

    def advance(self, time_ns: int, motion: Kinematics, air_ned_mps: Array) -> None:
        """Measure if a sample is due, and deliver the samples whose latency has elapsed."""
        if time_ns % self._period_ns == 0:
            self._state, numbers = self._measured(self._state, motion, air_ned_mps)
            self._waiting.append((time_ns + self._latency_ns, numbers))
        while self._waiting and self._waiting[0][0] <= time_ns:
            self.latest = self._waiting.popleft()[1]

    def _fresh(self, motion: Kinematics, air_ned_mps: Array) -> tuple[Any, Array]:
        return self._measured(self._sensor.initial(len(motion.pos_ned_m), self._rng), motion, air_ned_mps)

    def _measured(self, state: Any, motion: Kinematics, air_ned_mps: Array) -> tuple[Any, Array]:
        air = (air_ned_mps,) if self._needs_air else ()
        state, sample = self._sensor.measure(state, motion, *air, self._rng)
        return state, self._numbers(sample)


class BlockSensors:
    """The observed sensors of a block of vessels. by_name: each sensor by its name."""

    def __init__(self, profile: RunProfile, names: Sequence[str], dt_ns: int, air: Air, seeds: Seeds) -> None:
        self.by_name = {
            name: MAKERS[name](profile, dt_ns, air, default_rng(seeds.sequence(f"sensor {name}"))) for name in names
        }

    def begin(self, state: SimulationState, origin_ned_m: Array) -> None:
        """Switch all sensors on. origin_ned_m: place of the profile's origin for each vessel, (N, 3)."""
        if self.by_name:
            motion = _from_origin(state.vessel.motion, origin_ned_m)
            for sensor in self.by_name.values():
                sensor.begin(motion, state.wind_ned_mps)

    def restart(self, rows: Rows, state: SimulationState, origin_ned_m: Array) -> None:
        """Switch the sensors of these rows off and on again, on vessels that have their new place."""
        if self.by_name:
            motion = state.vessel.motion
            own = Kinematics(*(getattr(motion, field.name)[rows] for field in fields(motion)))
            motion = _from_origin(own, origin_ned_m[rows])
            for sensor in self.by_name.values():
                sensor.restart(rows, motion, state.wind_ned_mps[rows])

    def advance(self, state: SimulationState, origin_ned_m: Array) -> None:
        """Measure after a physics step."""
        if self.by_name:
            motion = _from_origin(state.vessel.motion, origin_ned_m)
            for sensor in self.by_name.values():
                sensor.advance(state.time_ns, motion, state.wind_ned_mps)


def check_sensors(profile: RunProfile, names: Sequence[str]) -> None:
    """Raises UserError for sensors that the profile does not have, or replays from a recording."""
    for name in names:
        if profile.sensors is None or getattr(profile.sensors, name) is None:
            raise UserError(f"{profile.name}: has no sensors.{name}; add the group, or do not observe {name!r}")
    if names and profile.sensors is not None and profile.sensors.recorded is not None:
        raise UserError(f"{profile.name}: sensors.recorded cannot be observed by a batch; remove the group")


def _from_origin(motion: Kinematics, origin_ned_m: Array) -> Kinematics:
    return replace(motion, pos_ned_m=motion.pos_ned_m - origin_ned_m)


def _imu(profile: RunProfile, dt_ns: int, air: Air, rng: Generator) -> BlockSensor:
    assert profile.sensors is not None
    gravity_mps2 = normal_gravity_mps2(profile.site.latitude_deg, profile.site.altitude_m)
    return BlockSensor(Imu(profile.sensors.imu, gravity_mps2), _of_imu, dt_ns, rng)


def _of_imu(sample: ImuSample) -> Array:
    return np.concatenate([sample.gyro_frd_radps, sample.accel_frd_mps2], axis=1)


def _gnss(profile: RunProfile, dt_ns: int, air: Air, rng: Generator) -> BlockSensor:
    assert profile.sensors is not None
    frame = local_frame(profile.site)
    return BlockSensor(Gnss(profile.sensors.gnss, frame), partial(_of_gnss, frame), dt_ns, rng)


def _of_gnss(frame: LocalFrame, sample: GnssSample) -> Array:
    return np.concatenate([frame.ned(sample.lat_deg, sample.lon_deg, sample.alt_m), sample.vel_ned_mps], axis=1)


def _magnetometer(profile: RunProfile, dt_ns: int, air: Air, rng: Generator) -> BlockSensor:
    assert profile.sensors is not None
    magnetometer = Magnetometer(profile.sensors.magnetometer, magnetic_field_ned_gauss(profile.site))
    return BlockSensor(magnetometer, _of_magnetometer, dt_ns, rng)


def _of_magnetometer(sample: MagnetometerSample) -> Array:
    return sample.field_frd_gauss


def _barometer(profile: RunProfile, dt_ns: int, air: Air, rng: Generator) -> BlockSensor:
    assert profile.sensors is not None
    return BlockSensor(Barometer(profile.sensors.barometer, profile.site.altitude_m), _of_barometer, dt_ns, rng)


def _of_barometer(sample: BarometerSample) -> Array:
    return sample.pressure_pa[:, None] / PA_PER_HPA


def _wind_vane(profile: RunProfile, dt_ns: int, air: Air, rng: Generator) -> BlockSensor:
    assert profile.sensors is not None
    assert profile.sensors.wind_vane is not None
    areas_m = profile.vehicle.wind.centre_height_m

    def against_areas(height_m: Array) -> Array:
        return air.share(height_m) / air.share(areas_m)

    vane = WindVane(profile.sensors.wind_vane, against_areas, profile.environment.water.level_m)
    return BlockSensor(vane, _of_wind_vane, dt_ns, rng, needs_air=True)


def _of_wind_vane(sample: WindSample) -> Array:
    return np.stack([sample.speed_mps, sample.direction_rad], axis=1)


MAKERS: dict[str, Callable[[RunProfile, int, Air, Generator], BlockSensor]] = {
    "imu": _imu,
    "gnss": _gnss,
    "magnetometer": _magnetometer,
    "barometer": _barometer,
    "wind_vane": _wind_vane,
}
