"""Faults of a sensor that change its samples before they are sent: bias, freeze and dropout."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.random import default_rng

from sim_core.geodesy import LocalFrame
from sim_core.sensors.barometer import BarometerSample
from sim_core.sensors.gnss import GnssSample
from sim_core.sensors.imu import ImuSample
from sim_core.sensors.magnetometer import MagnetometerSample
from xitl_cli.profile.schema.faults import (
    BarometerFault,
    FaultSpec,
    GnssFault,
    ImuFault,
    MagnetometerFault,
    SensorFault,
)
from xitl_cli.run.core.faults import span_ns
from xitl_cli.seeds import Seeds

Bias = Callable[[Any, float], Any]
"""Takes a sample and the seconds since the fault began; returns the sample to send."""


class SensorFaults:
    """All faults of one sensor.

    `counts[fault]`: number of samples that each fault has changed, as `<sensor>_dropped`.
    """

    def __init__(self, sensor: str, faults: Mapping[str, FaultSpec], seeds: Seeds, frame: LocalFrame) -> None:
        self.counts: dict[str, dict[str, int]] = {}
        self._sensor, self._seeds, self._frame = sensor, seeds, frame
        self._faults: dict[str, _SensorFault] = {}
        self._kept: Any = None
        for name, fault in faults.items():
            self.set(name, fault)

    def __bool__(self) -> bool:
        return bool(self._faults)

    def set(self, name: str, fault: FaultSpec) -> None:
        """Add a fault, or replace the fault of this name with its times and random draws."""
        if getattr(fault, self._sensor) is not None:
            counts = self.counts.setdefault(name, {})
            self._faults[name] = _SensorFault(name, self._sensor, fault, self._seeds, self._frame, counts)

    def applied(self, stamp_ns: int, sample: Any) -> Any:
        """Return the changed sample of `stamp_ns`, or None when it is lost.

        Biases add up. A frozen sensor repeats the last sample before the fault, or its first sample.
        """
        active = [fault for fault in self._faults.values() if fault.from_ns <= stamp_ns < fault.until_ns]
        for fault in active:
            sample = fault.biased(stamp_ns, sample)
        frozen = [fault for fault in active if fault.freezes]
        for fault in frozen:
            fault.count("frozen")
        if frozen and self._kept is not None:
            sample = self._kept
        self._kept = sample
        lost = [fault.drops() for fault in active]
        return None if any(lost) else sample


class _SensorFault:
    def __init__(
        self, name: str, sensor: str, fault: FaultSpec, seeds: Seeds, frame: LocalFrame, counts: dict[str, int]
    ) -> None:
        sensor_fault: SensorFault = getattr(fault, sensor)
        self.from_ns, self.until_ns = span_ns(fault)
        self.freezes = sensor_fault.freeze
        self._dropout = sensor_fault.dropout
        self._bias = _bias(sensor_fault, frame)
        self._sensor = sensor
        self._counts = counts
        self._rng = default_rng(seeds.sequence(f"faults/{name}/{sensor}"))

    def biased(self, stamp_ns: int, sample: Any) -> Any:
        if self._bias is None:
            return sample
        self.count("biased")
        return self._bias(sample, (stamp_ns - self.from_ns) * 1e-9)

    def drops(self) -> bool:
        if not self._dropout or self._rng.random() >= self._dropout:
            return False
        self.count("dropped")
        return True

    def count(self, effect: str) -> None:
        key = f"{self._sensor}_{effect}"
        self._counts[key] = self._counts.get(key, 0) + 1


def _bias(fault: SensorFault, frame: LocalFrame) -> Bias | None:
    """Return the function that adds the errors of `fault` to a sample, or None without errors."""
    if isinstance(fault, ImuFault):
        gyro, accel = np.array([fault.gyro_bias_frd_radps]), np.array([fault.accel_bias_frd_mps2])

        def imu(sample: ImuSample, since_s: float) -> ImuSample:
            return replace(
                sample, gyro_frd_radps=sample.gyro_frd_radps + gyro, accel_frd_mps2=sample.accel_frd_mps2 + accel
            )

        return imu if gyro.any() or accel.any() else None
    if isinstance(fault, GnssFault):
        position, velocity = np.array([fault.position_bias_ned_m]), np.array([fault.velocity_bias_ned_mps])
        bearing_rad = math.radians(fault.drift_bearing_deg)
        drift_mps = fault.drift_mps * np.array([[math.cos(bearing_rad), math.sin(bearing_rad), 0.0]])

        def gnss(sample: GnssSample, since_s: float) -> GnssSample:
            place = frame.ned(sample.lat_deg, sample.lon_deg, sample.alt_m) + position + drift_mps * since_s
            lat_deg, lon_deg, alt_m = frame.geodetic(place)
            return replace(
                sample, lat_deg=lat_deg, lon_deg=lon_deg, alt_m=alt_m, vel_ned_mps=sample.vel_ned_mps + velocity
            )

        return gnss if position.any() or velocity.any() or fault.drift_mps else None
    if isinstance(fault, MagnetometerFault):
        field = np.array([fault.field_bias_frd_gauss])

        def magnetometer(sample: MagnetometerSample, since_s: float) -> MagnetometerSample:
            return replace(sample, field_frd_gauss=sample.field_frd_gauss + field)

        return magnetometer if field.any() else None
    assert isinstance(fault, BarometerFault)
    pressure_pa = fault.pressure_bias_pa

    def barometer(sample: BarometerSample, since_s: float) -> BarometerSample:
        return replace(sample, pressure_pa=sample.pressure_pa + pressure_pa)

    return barometer if pressure_pa else None
